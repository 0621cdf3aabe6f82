"""The report as one HTML page that needs nothing else: pictures are inside it, scripts are not.

`page.html` is its template; whatever is put into it is plain text, and escaped.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader

from mantle.report.curves import Figure

# Parts of a section: their kind, as the template names it, and what is in them.
Blocks = list[tuple[str, dict[str, Any]]]

CLASSES = {
    **dict.fromkeys(("confirmed", "converged"), "good"),
    **dict.fromkeys(("not confirmed", "failed", "not converged"), "bad"),
    **dict.fromkeys(("undecided", "stopped"), "open"),
}


def page(title: str, sections: Sequence[tuple[str, str, Blocks]], **head: Any) -> str:
    """The page.

    Args:
        title: Its title.
        sections: Anchor, title and content of each; those without content are left out.
        head: What stands below the title: facts, summary and a note.
    """
    folder = FileSystemLoader(Path(__file__).parent)
    environment = Environment(loader=folder, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.tests["number_text"] = re.compile(r"[-−]?\d").match
    shown = [s for s in sections if s[2]]
    template = environment.get_template("page.html")
    return template.render(title=title, sections=shown, classes=CLASSES, **head)


def paragraph(text: str, kind: str = "") -> Blocks:
    """A paragraph."""
    return [("paragraph", {"text": text, "kind": kind})]


def heading(text: str) -> Blocks:
    """A heading below that of a section."""
    return [("heading", {"text": text})]


def bullets(texts: Sequence[str]) -> Blocks:
    """A list; nothing if it is empty."""
    return [("bullets", {"texts": texts})] if texts else []


def table(head: Sequence[str], rows: Sequence[Sequence[str | Sequence[str]]]) -> Blocks:
    """A table; a list in a cell becomes a list; nothing if there are no rows."""
    return [("table", {"head": head, "rows": rows})] if rows else []


def figure(f: Figure, folder: Path) -> Blocks:
    """A picture with its caption, inside the page."""
    data = base64.b64encode((folder / f.name).read_bytes()).decode("ascii")
    return [("figure", {"figure": f, "data": data})]
