"""The report as one self-contained HTML page.

The template `page.html` escapes the plain text that is put into it.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.plots.figures import SUFFIXES

# Parts of a section: kind, as the template names it, and content.
Blocks = list[tuple[str, dict[str, Any]]]
CLASSES = {
    **{"converged": "good", "stopped": "open", "note": "open"},
    **dict.fromkeys(("failed", "not converged", "do not use"), "bad"),
}


@dataclass(frozen=True)
class Figure:
    """A figure of the report: file, title, caption and alternative text."""

    name: str
    title: str
    caption: str
    text: str


def page(title: str, sections: Sequence[tuple[str, str, Blocks]], **head: Any) -> str:
    """The page of sections (anchor, title and content); empty ones are left out.

    Below its title stand facts, a leading sentence, summary, a note and a view (markup).
    """
    shown = [s for s in sections if s[2]]
    return render("page.html", title=title, sections=shown, classes=CLASSES, **head)


def render(name: str, **values: Any) -> str:
    """A template of this folder with values, whose text it escapes."""
    from jinja2 import Environment, FileSystemLoader

    folder = FileSystemLoader(Path(__file__).parent)
    environment = Environment(loader=folder, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.tests["number_text"] = re.compile(r"[-−+]?\d[\d.,]*(e[-+]\d+)?([\s%]|$)").match
    # Text that cannot end the script around it.
    environment.filters["inert"] = lambda t: t.replace("</", "<\\/").replace("<!--", "<\\!--")
    return environment.get_template(name).render(values)


def titled(title: str, content: Blocks) -> Blocks:
    """Blocks below a heading, if it has words; nothing if there are none."""
    return [("heading", {"text": title}), *content] if title and content else content


def bullets(texts: Sequence[str]) -> Blocks:
    """A list; nothing if it is empty."""
    return [("bullets", {"texts": texts})] if texts else []


def table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> Blocks:
    """A table of texts, lists and links; nothing if there are no rows."""
    return [("table", {"head": head, "rows": rows})] if rows else []


def figures(found: Sequence[Figure], folder: Path) -> Blocks:
    """Pictures of a folder with their captions, inside the page."""
    return [("figure", {"figure": f, "data": _smaller(folder / f.name)}) for f in found]


def files(found: Sequence[Figure], folder: Path) -> list[Path]:
    """The files of pictures in a folder, in all formats that were written."""
    every = ((folder / f.name).with_suffix(suffix) for f in found for suffix in SUFFIXES)
    return [file for file in every if file.exists()]


def _smaller(path: Path) -> str:
    """Reduce a picture to 256 colours: a third of the bytes, hardly a visible change."""
    from PIL import Image  # comes with matplotlib

    into = io.BytesIO()
    with Image.open(path) as picture:
        few = picture.convert("RGB").quantize(256, dither=Image.Dither.NONE)
        few.save(into, "PNG")
    return base64.b64encode(into.getvalue()).decode("ascii")


def folded(title: str, content: Blocks) -> Blocks:
    """Blocks that open on a click; nothing if there are none."""
    return [("folded", {"title": title, "blocks": content})] if content else []
