"""The report as one self-contained HTML page.

The template `page.html` escapes the plain text that is put into it.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from app.report.curves import Figure

# Parts of a section: kind, as the template names it, and content.
Blocks = list[tuple[str, dict[str, Any]]]
T = TypeVar("T")
MOST = 400  # rows of a table, points of a curve

CLASSES = {
    **dict.fromkeys(("confirmed", "converged"), "good"),
    **dict.fromkeys(("not confirmed", "failed", "not converged", "do not use"), "bad"),
    **dict.fromkeys(("undecided", "stopped", "note"), "open"),
}


def page(title: str, sections: Sequence[tuple[str, str, Blocks]], **head: Any) -> str:
    """The page.

    Args:
        title: Its title.
        sections: Anchor, title and content of each; empty ones are left out.
        head: Below the title: facts, a leading sentence, summary, a note and a view (markup).
    """
    from jinja2 import Environment, FileSystemLoader

    folder = FileSystemLoader(Path(__file__).parent)
    environment = Environment(loader=folder, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.tests["number_text"] = re.compile(r"[-−]?\d").match
    shown = [s for s in sections if s[2]]
    template = environment.get_template("page.html")
    return template.render(title=title, sections=shown, classes=CLASSES, **head)


def paragraph(text: str, kind: str = "") -> Blocks:
    """A paragraph."""
    return [("paragraph", {"text": text, "kind": kind})]


def titled(title: str, content: Blocks) -> Blocks:
    """Blocks below a heading; nothing if there are none."""
    return [("heading", {"text": title}), *content] if content else []


def bullets(texts: Sequence[str]) -> Blocks:
    """A list; nothing if it is empty."""
    return [("bullets", {"texts": texts})] if texts else []


def table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> Blocks:
    """A table of texts, lists and links; nothing if there are no rows."""
    return [("table", {"head": head, "rows": rows})] if rows else []


def figure(f: Figure, folder: Path) -> Blocks:
    """A picture with its caption, inside the page."""
    data = base64.b64encode(_smaller((folder / f.name).read_bytes())).decode("ascii")
    return [("figure", {"figure": f, "data": data})]


def _smaller(png: bytes) -> bytes:
    """Reduce a picture to 256 colours: a third of the bytes, hardly a visible change."""
    from PIL import Image  # comes with matplotlib

    into = io.BytesIO()
    with Image.open(io.BytesIO(png)) as picture:
        picture.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(
            into, "PNG", optimize=True
        )
    return into.getvalue()


def drawings(svgs: Sequence[str]) -> Blocks:
    """Drawings beside each other, as markup."""
    return [("drawings", {"drawings": svgs})] if svgs else []


def verbatim(text: str) -> Blocks:
    """Preformatted text."""
    return [("verbatim", {"text": text})] if text else []


def folded(title: str, content: Blocks) -> Blocks:
    """Blocks that open on a click; nothing if there are none."""
    return [("folded", {"title": title, "blocks": content})] if content else []


def link(text: str, to: str) -> dict[str, str]:
    """A table cell that links to another page, if there is one."""
    return {"text": text, "to": to}


def sparse(items: Sequence[T]) -> Sequence[T]:
    """The first, the last and every n-th item between, so that a page stays small."""
    n = -(-len(items) // MOST)
    return items if n < 2 else [*items[:-1:n], items[-1]]
