"""A compiled form in a cache."""

from __future__ import annotations

from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

FORM = "libffcx_forms_" + "0" * 40


def write_form(folder: Path, mark: str = "") -> Path:
    """A module in the form that the compiler writes."""
    module = folder / f"{FORM}{EXTENSION_SUFFIXES[0]}"
    folder.mkdir(parents=True, exist_ok=True)
    for path, text in ((module, "code"), (module.parent / f"{FORM}.c", "source")):
        path.write_text(text)
    (folder / f"{FORM}.c.cached").write_text(mark)
    return module
