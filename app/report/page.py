"""The report as one HTML page that needs nothing else: pictures are inside it, scripts are not."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from mantle.report.paper.figures import Figure

STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; color: #1d2429;
  max-width: 1120px; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin-bottom: .2rem; }
h2 { font-size: 1.25rem; margin-top: 2.4rem; border-bottom: 1px solid #cfd6db; }
h3 { font-size: 1.02rem; margin: 1.6rem 0 .3rem; }
nav a { margin-right: 1.1em; white-space: nowrap; }
a { color: #1f5fa8; }
.quiet, figcaption { color: #5a666f; font-size: .87rem; }
figure { margin: 1.2rem 0 1.8rem; }
img { max-width: 100%; height: auto; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .82rem; margin: .6rem 0 1rem; }
th, td { padding: .22rem .55rem; border-bottom: 1px solid #dde3e7; text-align: left;
  vertical-align: top; white-space: pre-line; }
th { background: #f1f4f6; font-weight: 600; }
td.n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
td ul { margin: 0; padding-left: 1.1em; }
.good { color: #1c6b34; font-weight: 600; }
.bad { color: #a8321f; font-weight: 600; }
.open { color: #8a5a00; font-weight: 600; }
.summary { background: #f1f4f6; padding: .6rem 1.2rem; border-radius: 6px; }
@media print {
  body { max-width: none; margin: 0; font-size: 10pt; }
  nav { display: none; }
  figure, tr { break-inside: avoid; }
  h2, h3 { break-after: avoid; }
  .scroll { overflow: visible; }
  table { font-size: 7.5pt; }
}
"""
CLASSES = {
    **dict.fromkeys(("confirmed", "converged"), "good"),
    **dict.fromkeys(("not confirmed", "failed", "not converged"), "bad"),
    **dict.fromkeys(("undecided", "stopped"), "open"),
}


def page(title: str, sections: Sequence[tuple[str, str, str]], head: str) -> str:
    """The page.

    Args:
        title: Its title, plain text.
        sections: Anchor, title (plain text) and HTML of each; those without HTML are left out.
        head: HTML below the title.
    """
    shown = [s for s in sections if s[2]]
    links = "".join(f'<a href="#{anchor}">{escape(name)}</a>' for anchor, name, _ in shown)
    body = "".join(
        f'<section id="{anchor}"><h2>{escape(name)}</h2>\n{html}</section>\n'
        for anchor, name, html in shown
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style></head>\n"
        f"<body><h1>{escape(title)}</h1>\n{head}\n<nav>{links}</nav>\n{body}</body></html>\n"
    )


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    attribute = f' class="{kind}"' if kind else ""
    return f"<p{attribute}>{escape(text)}</p>\n"


def heading(text: str) -> str:
    """A heading below that of a section."""
    return f"<h3>{escape(text)}</h3>\n"


def bullets(texts: Iterable[str]) -> str:
    """A list of plain texts; nothing if there are none."""
    items = "".join(f"<li>{marked(t)}</li>" for t in texts)
    return f"<ul>{items}</ul>\n" if items else ""


def marked(text: str) -> str:
    """Plain text as HTML; a verdict or status at its start, before a colon or alone, coloured."""
    word, colon, rest = text.partition(": ")
    if kind := CLASSES.get(word):
        return f'<span class="{kind}">{escape(word)}</span>{colon}{escape(rest)}'
    return escape(text)


def table(head: Sequence[str], rows: Sequence[Sequence[str | Sequence[str]]]) -> str:
    """A table of plain texts; a list in a cell becomes a list; nothing if there are no rows."""
    if not rows:
        return ""
    titles = "".join(f"<th>{escape(t)}</th>" for t in head)
    lines = "".join(f"<tr>{''.join(map(_cell, row))}</tr>\n" for row in rows)
    return (
        f'<div class="scroll"><table><thead><tr>{titles}</tr></thead>\n'
        f"<tbody>{lines}</tbody></table></div>\n"
    )


def _cell(content: str | Sequence[str]) -> str:
    if not isinstance(content, str):
        return f"<td>{bullets(content)}</td>"
    number = content[:1].isdigit() or (content[:1] in ("-", "−") and content[1:2].isdigit())
    return f'<td class="n">{escape(content)}</td>' if number else f"<td>{marked(content)}</td>"


def figure(f: Figure, folder: Path) -> str:
    """A picture with its caption, inside the page."""
    data = base64.b64encode((folder / f.name).read_bytes()).decode("ascii")
    return (
        f"<figure><h3>{escape(f.title)}</h3>"
        f'<img alt="{escape(f.text)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(f.caption)}</figcaption></figure>\n"
    )
