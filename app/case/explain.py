"""The meaning of one key of a case file, as text: ``mantle explain``."""

from __future__ import annotations

import difflib
import re
import textwrap
from collections.abc import Iterator
from functools import cache

from app.case import keys, library
from app.case.case import Case
from app.case.keys import Key
from app.errors import InputError

WIDTH = 96
# Keys explained by the text of another.
WITHIN = {"loads.library": "loads"}


def explained(key: str) -> str:
    """Meaning, value, unit, default and an example of a key; or an entry of the library.

    Args:
        key: As after ``--set``, without names or with the last word alone. Else a name of the
            library, or ``materials`` or ``loads`` for all of them.

    Raises:
        InputError: There is no such key.
    """
    every = _every()
    asked = key.strip().strip(".")
    asked = WITHIN.get(asked, asked)
    found = [k for k in every if _matches(k, asked)] or [k for k in every if k.name == asked]
    listed = library.listed(key).replace("`", "") if key in library.KINDS else ""
    if not found and (listed or key in library.names()):
        return listed or library.described(key)
    if not found:
        names = {re.sub(r"\.<name>|\[\]", "", k.path): None for k in every}
        ends = {name.rpartition(".")[2]: name for name in reversed(names)}
        near = difflib.get_close_matches(asked, [*names, *library.names()], 3)
        near += [ends[w] for w in difflib.get_close_matches(asked.rpartition(".")[2], ends, 3)]
        nearest = ", ".join(dict.fromkeys(near)) or ", ".join(Case.model_fields)
        raise InputError(f"{key}: no key of a case; nearest: {nearest}")
    heads: dict[str, list[str]] = {}
    for k in found:
        kind = f"  (kind {k.kind})" if k.kind else ""
        heads.setdefault("\n".join(_body(k)), []).append(k.path + kind)
    parts = ["\n".join([*own, body]) for body, own in heads.items()]
    return "\n\n".join([*parts, *([listed] if listed else [])])


@cache
def unit(key: str) -> str:
    """Internal unit of a key as after ``--set``; empty if it has none or is unknown."""
    units = {k.unit for k in _every() if _matches(k, key)} - {""}
    return units.pop() if len(units) == 1 else ""


def _every() -> list[Key]:
    return [key for section in keys.table() for key in section.keys]


def _matches(key: Key, asked: str) -> bool:
    """Whether a key matches; names and numbers may be any or be left out."""
    pattern = re.escape(key.path)
    pattern = pattern.replace(r"\.<name>", r"(\.[^.]+)?")
    pattern = pattern.replace(r"\[\]", r"(\[\d*\]|\.\d+)?")
    return re.fullmatch(pattern, asked) is not None


def _body(key: Key) -> Iterator[str]:
    """Lines of an explanation below its heading."""
    said = f"{key.value} such as {key.default} {key.meaning}"
    example = re.search(r"(?:e\.g\.|such as) `([^`]*)`", said)
    rows = {
        "value": key.value,
        "unit": key.unit,
        "default": key.default or "none: it is required",
        "keys": "; ".join(f"{kind}: {', '.join(names)}" for kind, names in key.inner),
        "example": f"{key.name}: {example[1]}" if example else "",
    }
    yield from _wrapped(key.meaning, "  ", "  ")
    for name, text in rows.items():
        if text:
            yield from _wrapped(text.removeprefix(": "), f"  {name:<9}", " " * 11)


def _wrapped(text: str, start: str, further: str) -> list[str]:
    """Wrap Markdown without its marks, with indents of the first and further lines."""
    plain = re.sub(r"\[([^\]]*)\]\(#[^)]*\)", r"\1", text).replace("`", "")
    return textwrap.wrap(
        plain, WIDTH, initial_indent=start, subsequent_indent=further, break_on_hyphens=False
    )
