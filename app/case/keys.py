"""The table of all keys of a file, from the schema: for `mantle explain` and the manual."""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from app.case.case import Case
from app.case.study import StudyFile
from app.case.sweep import Sweep
from app.schema.expressions import Varying
from app.schema.section import Scalar, docstrings
from app.schema.units import Dimension, Plain

NUMBERS = {2: "two", 3: "three", 6: "six"}
# Number of equal rows of two kinds that are written once; larger bounds only avoid overflow.
SHARED, HUGE = 8, 1e9
CASE = """# Keys of a case file

A case is a YAML file. A value with a dimension is text with its unit: `110 GPa`, `4 mm`. Any unit
of the right dimension is accepted. The column *unit* names the unit in which mantle keeps and
reports the value. A list of values of one unit may be written once with the unit, in quotes:
`"[0, 0, -1800] N"`. Unknown keys are errors.

An *expression* is arithmetic in the coordinates x, y, z in mm, for example
`"-0.02 * (1 - z / 50)"`; its result is in the unit of the column. It may use `sqrt`, `sin`, `cos`,
`tan`, `exp`, `log`, `abs`, `min`, `max`, `atan2`, `hypot` and `pi`.

`<name>` stands for a name that you choose or that the geometry gives. A key without a default is
required; *none* means that it may be left out. `mantle explain --schema` prints the same as a JSON
schema, for completion in editors.
"""
CAMPAIGNS = """# Keys of sweep and study files

How to use them: [Many runs](../howto/many-runs.md). Keys of overrides are written as after
`--set`: `interfaces.stem_cement.friction_coefficient`. The key `ranks` sets the number of MPI
ranks of a run.
"""


@dataclass(frozen=True)
class Key:
    """A key of a file, with texts in Markdown.

    Attributes:
        section: Path of its section, ``interfaces.<name>``; empty at the top.
        kind: Kind of the section, or "".
        value: Type and bounds.
        unit: Internal unit, or "".
        default: "" if it is required.
        inner: Sections that its value may be.
    """

    section: str
    kind: str
    name: str
    value: str
    unit: str
    default: str
    meaning: str
    inner: tuple[type[BaseModel], ...]

    @property
    def path(self) -> str:
        """The whole key."""
        return f"{self.section}.{self.name}" if self.section else self.name

    @property
    def row(self) -> str:
        """Its row in the manual."""
        cells = (f"`{self.name}`", self.value, self.unit, self.default, self.meaning)
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


@cache
def table(root: type[BaseModel] = Case) -> dict[type[BaseModel], list[Key]]:
    """All keys of a `Case`, `StudyFile` or `Sweep` by section, in the order of the file."""
    places = dict((model, path) for path, model in _places("", root, set()))
    return {model: list(_keys(model, path, places)) for model, path in places.items()}


def case_page() -> str:
    """Every key of a case file, in Markdown."""
    return "\n".join([CASE, *_page(Case, "Sections of a case")])


def campaigns_page() -> str:
    """Every key of sweep and study files, in Markdown."""
    sweep = _page(Sweep, "Sections of a sweep file")
    study = _page(StudyFile, "Sections of a study file")
    return "\n".join([CAMPAIGNS, *sweep, *study])


def _page(root: type[BaseModel], title: str) -> Iterator[str]:
    written: dict[str, tuple[str, list[str]]] = {}
    for model, keys in table(root).items():
        path = keys[0].section
        yield f"## {_heading(path, model) if path else title}\n"
        if path:
            yield f"{prose(inspect.cleandoc(model.__doc__ or ''))}\n"
        rows = [key.row for key in keys]
        kind, others = written.get(path, ("", []))
        own = [row for row in rows if row not in others]
        if len(rows) - len(own) > SHARED:
            rows = own
            yield f"All keys of kind `{kind}`, and:\n"
        else:
            written[path] = kind_of(model), rows
        yield "| key | value | unit | default | meaning |\n|---|---|---|---|---|"
        yield from rows
        yield ""


def _places(
    path: str, model: type[BaseModel], seen: set[type[BaseModel]]
) -> Iterator[tuple[str, type[BaseModel]]]:
    """Each section below a section, at its first place, in the order of the file."""
    seen.add(model)
    yield path, model
    for key, field in model.model_fields.items():
        for place, other in _models(_annotation(field), f"{path}.{key}" if path else key):
            if other not in seen:
                yield from _places(place, other, seen)


def _keys(model: type[BaseModel], path: str, places: dict[type[BaseModel], str]) -> Iterator[Key]:
    links = {m: _slug(_heading(place, m)) for m, place in places.items()}
    texts = docstrings(model)
    for name, field in model.model_fields.items():
        annotation = _annotation(field)
        value, unit = _value(annotation, links)
        meaning = prose(texts.get(name, ""))
        if name == "kind":
            value, unit, meaning = f"`{kind_of(model)}`", "", "Says that it is of this kind."
        inner = tuple(m for _, m in _models(annotation, ""))
        kind = kind_of(model) if path else ""
        yield Key(path, kind, name, value, unit, _default(name, field), meaning, inner)


def _heading(path: str, model: type[BaseModel]) -> str:
    kind = kind_of(model)
    return f"`{path}`" + (f" of kind `{kind}`" if kind else "")


def _slug(heading: str) -> str:
    """Anchor of a heading, as GitHub and MyST make it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def kind_of(model: type[BaseModel]) -> str:
    """Kind of a section as written in a file; empty if it has none."""
    if "kind" in model.model_fields:
        return str(get_args(model.model_fields["kind"].annotation)[0])
    return "rigid" if "rigid" in model.model_fields else ""


def prose(text: str) -> str:
    """A docstring as Markdown of one paragraph or more."""
    text = re.sub(r"``([^`]*)``", r"`\1`", text)
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


def _annotation(field: FieldInfo) -> Any:
    """Annotation of a field with the marks that pydantic has removed."""
    annotation: Any = field.annotation
    for mark in field.metadata:
        annotation = Annotated[annotation, mark]
    return annotation


def _models(annotation: Any, path: str) -> Iterator[tuple[str, type[BaseModel]]]:
    """Sections in an annotation, with their paths."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield from ((path, model) for model in _variants(annotation))
        return
    ends = {dict: ".<name>", tuple: "[]"}
    for argument in get_args(annotation):
        yield from _models(argument, path + ends.get(get_origin(annotation), ""))


def _variants(model: type[BaseModel]) -> list[type[BaseModel]]:
    """A section, or the kinds derived from a base without kind."""
    kind = model.model_fields.get("kind")
    if kind is None or get_args(kind.annotation):
        return [model]
    # Kinds added from outside the program are left out.
    below = [c for c in model.__subclasses__() if c.__module__.startswith("app.")]
    return list(dict.fromkeys(v for c in below for v in _variants(c)))


def _marks(annotation: Any) -> tuple[list[Any], Any]:
    """Marks of an annotation, and the bare annotation."""
    marks: list[Any] = []
    while get_origin(annotation) is Annotated:
        annotation, *more = get_args(annotation)
        marks = [*more, *marks]
    return marks, annotation


def _value(annotation: Any, links: dict[type[BaseModel], str]) -> tuple[str, str]:
    """Type of a value, in words, and the unit in which it is kept."""
    marks, bare = _marks(annotation)
    for mark in marks:
        if isinstance(mark, Scalar):
            return _scalar(mark)
    least = [mark.ge for mark in marks if hasattr(mark, "ge")]
    most = [mark.le for mark in marks if hasattr(mark, "le")]
    if bare is int and least:
        return _scalar(Plain(integer=True, at_least=least[0], at_most=next(iter(most), None)))
    origin, arguments = get_origin(bare), get_args(bare)
    if origin is Literal:
        return ", ".join(f"`{_yaml(a)}`" for a in arguments), ""
    if origin in (Union, types.UnionType):
        return _union([_value(a, links) for a in arguments if a is not type(None)])
    if origin is dict:
        inner, unit = _value(arguments[1], links)
        return ("mapping of keys to values" if arguments[1] is Any else f"by name: {inner}"), unit
    if origin is tuple:
        found = [_value(a, links) for a in arguments if a is not Ellipsis]
        return _sequence(found, Ellipsis in arguments)
    if isinstance(bare, type) and issubclass(bare, BaseModel):
        kinds = [f"[`{kind_of(m)}`](#{links[m]})" for m in _variants(bare) if kind_of(m)]
        return f"kind {', '.join(kinds)}" if kinds else f"[section](#{links[bare]})", ""
    words = {bool: "`true`, `false`", str: "text", int: "whole number", Path: "path"}
    return words.get(bare, "number" if bare is float else "any value"), ""


def _union(found: list[tuple[str, str]]) -> tuple[str, str]:
    kinds = [text.removeprefix("kind ") for text, _ in found if text.startswith("kind ")]
    others = list(dict.fromkeys(text for text, _ in found if not text.startswith("kind ")))
    if {"text", "whole number", "number"} <= set(others):
        others = ["number, text" + (", `true`, `false`" if len(others) > 3 else "")]
    parts = [*others, *([f"kind {', '.join(kinds)}"] if kinds else [])]
    return " or ".join(parts), next((unit for _, unit in found if unit), "")


def _sequence(found: list[tuple[str, str]], endless: bool) -> tuple[str, str]:
    text, unit = found[0]
    if endless:
        return f"list of: {text}", unit
    if len(set(found)) == 1:
        return f"list of {NUMBERS[len(found)]}: {text}", unit
    units = dict.fromkeys(unit for _, unit in found if unit)
    return f"pair of {' and '.join(text for text, _ in found)}", ", ".join(units)


def _scalar(mark: Scalar) -> tuple[str, str]:
    match mark:
        case Varying():
            text, unit = _scalar(mark.constant)
            return f"{text}, or an expression", unit
        case Dimension():
            what = mark.what.removeprefix("a ").removeprefix("an ")
            return f"{what}{_bounds(mark)}, e.g. `{mark.example}`", mark.unit
        case Plain():
            return f"{'whole number' if mark.integer else 'number'}{_bounds(mark)}", ""
    return "`effusivity`, or a number from 0 to 1", ""


def _bounds(mark: Any) -> str:
    words = {"above": "above", "at_least": "at least", "at_most": "at most", "below": "below"}
    found = {word: getattr(mark, key, None) for key, word in words.items()}
    parts = [f"{word} {v:g}" for word, v in found.items() if v is not None and v < HUGE]
    return f", {' and '.join(parts)}" if parts else ""


def _default(key: str, field: FieldInfo) -> str:
    """Default of a key, in Markdown; empty if required."""
    if field.is_required() or (key == "kind" and field.default != "isotropic"):
        return ""
    default = field.get_default(call_default_factory=True)
    for mark in _marks(_annotation(field))[0]:
        if isinstance(mark, Scalar) and default is not None:
            return f"`{_yaml(mark.write(default))}`"
    match default:
        case None:
            return "none"
        case BaseModel():
            return "its defaults"
        case "" | () | {} if not default:
            return "empty"
        case (BaseModel(), *_):
            return "`[{name: load}]`"
        case tuple():
            return "`[" + ", ".join(f"{value:g}" for value in default) + "]`"
    return f"`{_yaml(default)}`"


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else f"{value:g}"
