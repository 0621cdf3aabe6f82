"""What one key of a case file means, as text: what ``mantle explain`` prints."""

from __future__ import annotations

import difflib
import json
import re
import textwrap
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import BaseModel

import configs
from app.case import keys, library
from app.case.case import Case
from app.errors import InputError
from app.schema import yaml_file
from app.schema.section import docstrings

WIDTH = 96
# Keys that the text of another tells of.
WITHIN = {"loads.library": "loads"}


@dataclass(frozen=True)
class Explained:
    """A key of a case file.

    Attributes:
        path: Where its section stands, ``interfaces.<name>``.
        model: The section.
        key: The key.
    """

    path: str
    model: type[BaseModel]
    key: str

    @property
    def full(self) -> str:
        """The whole key."""
        return f"{self.path}.{self.key}" if self.path else self.key

    @property
    def short(self) -> str:
        """The whole key without what stands for a name or a number."""
        return self.full.replace(".<name>", "").replace("[]", "")

    def matches(self, asked: str) -> bool:
        """Whether it is meant: names and numbers may be anything, or left out."""
        pattern = re.escape(self.full)
        pattern = pattern.replace(r"\.<name>", r"(\.[^.]+)?")
        pattern = pattern.replace(r"\[\]", r"(\[\d*\]|\.\d+)?")
        return re.fullmatch(pattern, asked) is not None


def explained(key: str) -> str:
    """Meaning, value, unit, default and an example of a key; or an entry of the library.

    Args:
        key: As after ``--set``; names may be left out, and all before the last word. Else a name of
            the library, or ``materials`` or ``loads`` for all of them.

    Raises:
        InputError: There is no such key.
    """
    every = _every()
    asked = key.strip().strip(".")
    asked = WITHIN.get(asked, asked)
    found = [e for e in every if e.matches(asked)] or [e for e in every if e.key == asked]
    listed = _plain(library.listed(key)) if key in library.KINDS else ""
    if not found and (listed or key in library.names()):
        return listed or library.described(key)
    if not found:
        last = asked.rpartition(".")[2]
        names = {e.short: None for e in every}
        ends = {e.key: e.short for e in reversed(every)}
        near = difflib.get_close_matches(asked, [*names, *library.names()], 3)
        near += [ends[w] for w in difflib.get_close_matches(last, list(ends), 3)]
        nearest = ", ".join(dict.fromkeys(near)) or ", ".join(Case.model_fields)
        raise InputError(f"{key}: no key of a case; nearest: {nearest}")
    texts: dict[str, list[str]] = {}
    for e in found:
        texts.setdefault("\n".join(_body(e)), []).append(_head(e))
    parts = ["\n".join([*heads, body]) for body, heads in texts.items()]
    return "\n\n".join([*parts, *([listed] if listed else [])])


@cache
def unit(key: str) -> str:
    """The unit in which the value of a key is kept; empty if it has none or there is no such key.

    Args:
        key: As after ``--set``.
    """
    annotations = [
        keys.annotation_of(e.model.model_fields[e.key]) for e in _every() if e.matches(key)
    ]
    units = {keys.value_of(a, defaultdict(str))[1] for a in annotations} - {""}
    return units.pop() if len(units) == 1 else ""


@cache
def _every() -> list[Explained]:
    """All keys, in the order of the reference."""
    return [
        Explained(path, model, name)
        for path, model in keys.places("", Case, set())
        for name in model.model_fields
    ]


def _head(e: Explained) -> str:
    """The first line of an explanation."""
    kind = keys.kind_of(e.model) if e.path else ""
    return e.full + (f"  (kind {kind})" if kind else "")


def _body(e: Explained) -> Iterator[str]:
    """The other lines."""
    field = e.model.model_fields[e.key]
    annotation = keys.annotation_of(field)
    value, unit = keys.value_of(annotation, defaultdict(str))
    default = keys.default_of(e.key, field)
    meaning = _texts(e.model).get(e.key, "")
    if e.key == "kind":
        value, meaning = keys.kind_of(e.model), "Says that it is of this kind."
    yield from _wrapped(keys.prose(meaning), "  ", "  ")
    rows = {"value": value, "unit": unit, "default": default or "none: it is required"}
    rows["keys"] = "; ".join(k for _, m in keys.models(annotation, "") for k in _keys(m))
    rows["example"] = _example(e, f"such as {value} such as {default} {meaning}")
    for name, text in rows.items():
        if text:
            yield from _wrapped(text, f"  {name:<9}", " " * 11)


# The texts below the keys of a section.
_texts = cache(docstrings)


def _wrapped(text: str, start: str, further: str) -> list[str]:
    """Text without marks in lines that begin in a way."""
    plain = _plain(text)
    return textwrap.wrap(
        plain, WIDTH, initial_indent=start, subsequent_indent=further, break_on_hyphens=False
    )


def _keys(model: type[BaseModel]) -> Iterator[str]:
    """The keys of a section, after its kind."""
    kind = keys.kind_of(model)
    own = ", ".join(key for key in model.model_fields if key != "kind")
    yield f"{kind}: {own}" if kind else own


def _plain(text: str) -> str:
    """Markdown without its marks."""
    return re.sub(r"\[([^\]]*)\]\(#[^)]*\)", r"\1", text).replace("`", "")


def _example(e: Explained, words: str) -> str:
    """The shortest use in a shipped case, best of this kind; else what its description names."""
    for kind in (keys.kind_of(e.model) if e.path else "", ""):
        uses = [(t, name) for name, data in _shipped() for t in _uses(data, (), data, e, kind)]
        if uses:
            text, name = min(uses, key=lambda use: len(use[0]))
            return f"{text}  # {name}"
    found = re.search(r"(?:e\.g\.|such as) `([^`]*)`", words)
    return f"{e.key}: {found[1]}" if found else ""


@cache
def _shipped() -> list[tuple[str, dict[str, Any]]]:
    """The shipped cases and their names."""
    files = [p for folder in ("", "start") for p in (configs.FOLDER / folder).glob("*.yaml")]
    return [(str(p.relative_to(configs.FOLDER)), yaml_file.read(p).data) for p in sorted(files)]


def _uses(value: Any, path: yaml_file.Path, holder: Any, e: Explained, kind: str) -> Iterator[str]:
    """Where a case has the key, in a section of a kind if it is to be of one; each as text."""
    of_kind = not (kind and isinstance(holder, dict)) or holder.get("kind", kind) == kind
    own = path and path[-1] == e.key and value is not None
    if own and of_kind and e.matches(yaml_file.path_text(path)):
        text = _flow(value)
        for n, step in reversed(list(enumerate(path))):
            text = f"[{text}]" if isinstance(step, int) else f"{step}: {text}"
            text = f"{{{text}}}" if n and isinstance(step, str) else text
        yield text
    if not isinstance(value, dict | list):
        return
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        yield from _uses(inner, (*path, key), value, e, kind)


def _flow(value: Any) -> str:
    """A value on one line of YAML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(v)}" for key, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, str) and not re.search(r"[\[\]{},:#'\"]", value):
        return value
    return json.dumps(value, ensure_ascii=False)
