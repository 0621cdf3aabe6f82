"""Sphinx with MyST: ``sphinx-build docs out/site`` makes a site with search of these pages."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

project = "mantle"
author = "The mantle developers"
extensions = ["myst_parser"]
myst_enable_extensions = ["dollarmath"]
# As forges make them.
myst_heading_anchors = 4
root_doc = "index"
html_theme = "alabaster"
html_theme_options = {
    "description": "Thermomechanics of cemented joint replacements",
    "page_width": "1100px",
}
html_sidebars = {"**": ["about.html", "searchbox.html", "navigation.html"]}
html_show_copyright = False

# The table of contents: Sphinx needs one, and a forge would show it as code.
CONTENTS = {
    "index": """
tutorial
howto/README
reference/README
gallery
demos
faq
theory
sources
verification
validation/README
notebook
paper
joss/paper
mesh
glossary
""",
    "howto/README": """
install
case
geometry
patient
place
cementless
your_hip
ct
loads
bench_test
head_cup
heat
error
many-runs
fit
cluster
administrators
restart
evidence
motion
paths
gauges
paraview
python
trouble
""",
    "validation/README": """
predictions
bending_creep
simulator_torque
rocking_torque
wear_size
push_out
plugs
sections
resurfacing
composite_strain
composite_bond
disc
rods
mantle
slab
cementless
""",
    "reference/README": """
case
former_keys
campaigns
results
commands
python
""",
}


ROOT = Path(__file__).resolve().parents[1]
DEMOS = ROOT / "docs" / "demos"


def _read(app: Any, page: str, source: list[str]) -> None:
    """Put the README before the index, demos on their page, and add its contents to a page."""
    if page == "index":
        readme = re.sub(r"\]\((?!docs/|#)", "](../", (ROOT / "README.md").read_text("utf-8"))
        source[0] = readme.replace("](docs/", "](") + source[0].partition("\n")[2]
    # Pages that are no part of the manual are named, not linked.
    text = re.sub(
        r"\[([^\]]*)\]\([./]*(CONTRIBUTING|CHANGELOG|SECURITY|configs[\w/]*|app/README)(\.md)?(#[\w-]*)?\)",
        r"\1",
        source[0],
    )
    source[0] = re.sub(r"\]\(([./]*)\.\./README\.md", r"](\1index.md", text)
    if page == "demos":
        for path in sorted(DEMOS.glob("*.py")):
            title = path.stem.replace("_", " ").capitalize()
            source[0] += f"\n## {title}\n\n```{{literalinclude}} demos/{path.name}\n```\n"
    if page in CONTENTS:
        source[0] += f"\n```{{toctree}}\n:hidden:\n{CONTENTS[page]}```\n"


def setup(app: Any) -> None:
    """Register what is done to pages before they are read."""
    app.connect("source-read", _read)
