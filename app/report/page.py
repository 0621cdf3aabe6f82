"""The report as one self-contained HTML page.

The template `page.html` escapes the plain text that is put into it.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

from app.foundation.layout import plain_text
from app.plots.curves import Drawing
from app.plots.figures import SUFFIXES

# CSS class, which sets the colour, of a word at the beginning of a text.
CLASSES = {
    "converged": "good",
    "stopped": "open",
    "note": "open",
    "failed": "bad",
    "not converged": "bad",
    "do not use": "bad",
    "reached": "good",
    "below": "bad",
}
# Names of percentiles and maxima in labels of numbers, with their spelling in titles.
SPELLED = {r"\bp(\d\d)\b": r"\1th percentile", r"\bmax\b": "maximum", r"\bmin\b": "minimum"}


class Link(NamedTuple):
    """Text with the address of a page; plain text if the address is empty."""

    text: str
    to: str


# Content of a table's cell: a text, a link, or a list of them.
Cell = str | Link | Sequence[str | Link]


@dataclass(frozen=True)
class Figure:
    """A figure of the report.

    Attributes:
        name: Name of its file.
        title: Title above it.
        caption: Caption below it.
        text: Alternative text for readers who cannot see it.
        halves: True if a narrow screen may show its right half below its left half.
    """

    name: str
    title: str
    caption: str
    text: str
    halves: bool = False


@dataclass(frozen=True)
class Heading:
    """A heading within a section."""

    kind: ClassVar = "heading"
    text: str


@dataclass(frozen=True)
class Bullets:
    """A list of texts."""

    kind: ClassVar = "bullets"
    texts: Sequence[str]


@dataclass(frozen=True)
class Table:
    """A table: titles of the columns, and rows of as many cells."""

    kind: ClassVar = "table"
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]


@dataclass(frozen=True)
class Picture:
    """A figure with its PNG in base 64, and its width and height [pixels]."""

    kind: ClassVar = "figure"
    figure: Figure
    data: str
    size: tuple[int, int]


@dataclass(frozen=True)
class Drawings:
    """Panels of curves, drawn as SVG."""

    kind: ClassVar = "drawings"
    drawings: Sequence[Drawing]
    caption: str = ""


@dataclass(frozen=True)
class Verbatim:
    """Text with its line breaks and spaces."""

    kind: ClassVar = "verbatim"
    text: str


@dataclass(frozen=True)
class Folded:
    """Blocks that open on a click; in print they are open."""

    kind: ClassVar = "folded"
    title: str
    blocks: Blocks


Block = Heading | Bullets | Table | Picture | Drawings | Verbatim | Folded
Blocks = Sequence[Block]


@dataclass(frozen=True)
class LargeNumber:
    """A large number of a page.

    Attributes:
        value: The number as text, without its error.
        unit: Its unit as printed.
        caption: A title in words.
        error: Its error, with ``±`` and unit; empty if it was not estimated.
        detail: A sentence on its meaning.
    """

    value: str
    unit: str
    caption: str
    error: str = ""
    detail: str = ""


class PageSection(NamedTuple):
    """A section of a page: its anchor, its title and its content."""

    anchor: str
    title: str
    blocks: Blocks


def page(
    title: str,
    sections: Sequence[PageSection],
    summary: Blocks,
    *,
    facts: str = "",
    lead: str = "",
    large: Sequence[LargeNumber] = (),
    view: str = "",
    note: str = "",
) -> str:
    """Return the page of sections; empty ones are left out.

    Args:
        title: Title of the page.
        sections: Sections in their order.
        summary: Content of the box below the lead: status, warnings, notes.
        facts: Line below the title: name, time, version.
        lead: Sentences above the large numbers.
        large: Large numbers with captions.
        view: Markup of the view in three dimensions.
        note: Sentence below the view.
    """
    return render(
        "page.html",
        {
            "title": title,
            "sections": [section for section in sections if section.blocks],
            "summary": summary,
            "facts": facts,
            "lead": lead,
            "large": large,
            "view": view,
            "note": note,
            "classes": CLASSES,
        },
    )


def render(name: str, values: Mapping[str, object]) -> str:
    """Fill in a template of this folder with values, whose text it escapes."""
    from jinja2 import Environment, FileSystemLoader

    folder = FileSystemLoader(Path(__file__).parent)
    environment = Environment(loader=folder, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.tests["number_text"] = re.compile(r"[-−+]?\d[\d.,]*(e[-+]\d+)?([\s%]|$)|-$").match
    # Text that cannot end the script around it.
    environment.filters["inert"] = lambda t: t.replace("</", "<\\/").replace("<!--", "<\\!--")
    return environment.get_template(name).render(values)


def spelled_out(label: str) -> str:
    """Return the label of a number as a title: ``slip, 99th percentile`` for ``slip, p99``."""
    for pattern, words in SPELLED.items():
        label = re.sub(pattern, words, label)
    return label


def titled(title: str, content: Blocks) -> list[Block]:
    """Return blocks below a heading, if it has words; nothing if there are no blocks."""
    return [Heading(title), *content] if title and content else [*content]


def bullets(texts: Sequence[str]) -> list[Block]:
    """Return a list; nothing if it is empty."""
    return [Bullets(texts)] if texts else []


def table(head: Sequence[str], rows: Sequence[Sequence[Cell]]) -> list[Block]:
    """Return a table of texts, lists and links; nothing if there are no rows."""
    return [Table(head, rows)] if rows else []


def pairs(values: Mapping[str, object]) -> list[Block]:
    """Return a table of names and values."""
    return table(["", ""], [[str(k).replace("_", " "), plain_text(v)] for k, v in values.items()])


def drawings(panels: Sequence[Drawing], caption: str = "") -> list[Block]:
    """Return panels of curves; nothing if there are none."""
    return [Drawings(panels, caption)] if panels else []


def folded(title: str, content: Blocks) -> list[Block]:
    """Return blocks that open on a click; nothing if there are none."""
    return [Folded(title, content)] if content else []


def figures(pictures: Sequence[Figure], folder: Path) -> list[Block]:
    """Return pictures of a folder with their captions, inside the page."""
    return [_picture(figure, folder / figure.name) for figure in pictures]


def files(pictures: Sequence[Figure], folder: Path) -> list[Path]:
    """Return the files of pictures in a folder, in all formats that were written."""
    existing = []
    for picture in pictures:
        for suffix in SUFFIXES:
            file = (folder / picture.name).with_suffix(suffix)
            if file.exists():
                existing.append(file)
    return existing


def _picture(figure: Figure, path: Path) -> Picture:
    """Reduce a picture to 256 colours: a third of the bytes, hardly a visible change."""
    from PIL import Image  # comes with matplotlib

    into = io.BytesIO()
    with Image.open(path) as picture:
        reduced = picture.convert("RGB").quantize(
            256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
        )
        reduced.save(into, "PNG")
    return Picture(figure, base64.b64encode(into.getvalue()).decode("ascii"), reduced.size)
