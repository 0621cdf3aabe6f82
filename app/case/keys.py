"""The keys of case, sweep and study files as pages of the manual, from the schema."""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from app.case.case import Case
from app.case.study import StudyFile
from app.case.sweep import Sweep
from app.schema.expressions import Varying
from app.schema.section import Scalar, docstrings
from app.schema.units import ConductancePerArea, Dimension, Plain

NUMBERS = {2: "two", 3: "three", 6: "six"}
# So many equal rows of two kinds are written once; bounds beyond this keep overflows out.
SHARED, HUGE = 8, 1e9
# The anchor of the section of each model.
Links = dict[type[BaseModel], str]


def case_page() -> str:
    """Every key of a case file."""
    intro = """# Keys of a case file

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
    return "\n".join([intro, *_tables(Case, "Sections of a case", "##")])


def campaigns_page() -> str:
    """Every key of sweep and study files."""
    intro = """# Keys of sweep and study files

How to use them: [Many runs](../howto/many-runs.md). Keys of overrides are written as after
`--set`: `interfaces.stem_cement.friction_coefficient`. The key `ranks` sets the number of MPI
ranks of a run.
"""
    sweep = _tables(Sweep, "Sections of a sweep file", "##")
    study = _tables(StudyFile, "Sections of a study file", "##")
    return "\n".join([intro, *sweep, *study])


Place = tuple[str, type[BaseModel]]


def _tables(root: type[BaseModel], title: str, level: str) -> Iterator[str]:
    """A heading, a sentence and a table for a model and for each model within it, once."""
    every = list(places("", root, set()))
    heads = {model: _heading(path, model) if path else title for path, model in every}
    links = {model: _slug(head) for model, head in heads.items()}
    written: dict[str, tuple[str, dict[str, str]]] = {}
    for path, model in every:
        yield f"{level} {heads[model]}\n"
        if path:
            yield f"{prose(inspect.cleandoc(model.__doc__ or ''))}\n"
        own = rows = dict(_rows(model, links))
        kind, others = written.get(path, ("", {}))
        same = {key for key in rows if others.get(key) == rows[key]}
        if len(same) > SHARED:
            own = {key: row for key, row in rows.items() if key not in same}
            yield f"All keys of kind `{kind}`, and:\n"
        else:
            written[path] = kind_of(model), rows
        yield "| key | value | unit | default | meaning |\n|---|---|---|---|---|"
        yield from own.values()
        yield ""


def places(path: str, model: type[BaseModel], seen: set[type[BaseModel]]) -> Iterator[Place]:
    """Where each model within a model stands first, in the order of the file."""
    seen.add(model)
    yield path, model
    for key, field in model.model_fields.items():
        for place, other in models(annotation_of(field), f"{path}.{key}" if path else key):
            if other not in seen:
                yield from places(place, other, seen)


def _heading(path: str, model: type[BaseModel]) -> str:
    kind = kind_of(model)
    return f"`{path}`" + (f" of kind `{kind}`" if kind else "")


def _slug(heading: str) -> str:
    """The anchor that forges and MyST make of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def kind_of(model: type[BaseModel]) -> str:
    """What a file calls a model; empty if it has no kind."""
    if "kind" in model.model_fields:
        return str(get_args(model.model_fields["kind"].annotation)[0])
    return "rigid" if "rigid" in model.model_fields else ""


def _rows(model: type[BaseModel], links: Links) -> Iterator[tuple[str, str]]:
    """The row of each key of a model."""
    texts = docstrings(model)
    for key, field in model.model_fields.items():
        value, unit = value_of(annotation_of(field), links)
        meaning = texts.get(key, "")
        if key == "kind":
            value, unit, meaning = f"`{kind_of(model)}`", "", "Says that it is of this kind."
        cells = (f"`{key}`", value, unit, default_of(key, field), prose(meaning))
        yield key, "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def prose(text: str) -> str:
    """A docstring as Markdown of one paragraph or more."""
    text = re.sub(r"``([^`]*)``", r"`\1`", text)
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


def annotation_of(field: FieldInfo) -> Any:
    """The annotation of a field with the marks that pydantic has taken off it."""
    annotation: Any = field.annotation
    for mark in field.metadata:
        annotation = Annotated[annotation, mark]
    return annotation


def models(annotation: Any, path: str) -> Iterator[tuple[str, type[BaseModel]]]:
    """The models in an annotation, and where each stands."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield from ((path, model) for model in variants(annotation))
        return
    place = path
    if get_origin(annotation) is dict:
        place = f"{path}.<name>"
    elif get_origin(annotation) is tuple:
        place = f"{path}[]"
    for argument in get_args(annotation):
        yield from models(argument, place)


def variants(model: type[BaseModel]) -> list[type[BaseModel]]:
    """A model, or the kinds that derive from one that is of no kind itself."""
    kind = model.model_fields.get("kind")
    if kind is None or get_args(kind.annotation):
        return [model]
    # Kinds that somebody has added from outside are not the program's.
    below = [c for c in model.__subclasses__() if c.__module__.startswith("app.")]
    return list(dict.fromkeys(v for c in below for v in variants(c)))


def value_of(annotation: Any, links: Links) -> tuple[str, str]:
    """Type of a value, in words, and the unit in which it is kept."""
    marks, bare = marks_of(annotation)
    for mark in marks:
        if isinstance(mark, Scalar):
            return _scalar(mark)
    least = [mark.ge for mark in marks if hasattr(mark, "ge")]
    most = [mark.le for mark in marks if hasattr(mark, "le")]
    if bare is int and least:
        return f"whole number{_bounds(None, least[0], next(iter(most), None), None)}", ""
    if any(type(mark).__name__ == "_Conductance" for mark in marks):
        constant, unit = value_of(ConductancePerArea, links)
        return f"`perfect`, {constant}, or {value_of(get_args(bare)[1], links)[0]}", unit
    origin, arguments = get_origin(bare), get_args(bare)
    if origin is Literal:
        return ", ".join(f"`{_yaml(a)}`" for a in arguments), ""
    if origin in (Union, types.UnionType):
        return _union([a for a in arguments if a is not type(None)], links)
    if origin is dict:
        inner, unit = value_of(arguments[1], links)
        return ("mapping of keys to values" if arguments[1] is Any else f"by name: {inner}"), unit
    if origin is tuple:
        return _sequence(arguments, links)
    if isinstance(bare, type) and issubclass(bare, BaseModel):
        kinds = [f"[`{kind_of(m)}`](#{links[m]})" for m in variants(bare) if kind_of(m)]
        return f"kind {', '.join(kinds)}" if kinds else f"[section](#{links[bare]})", ""
    words = {bool: "`true`, `false`", str: "text", int: "whole number", Path: "path"}
    return words.get(bare, "number" if bare is float else "any value"), ""


def marks_of(annotation: Any) -> tuple[list[Any], Any]:
    """The marks of an annotation, and the annotation without them."""
    marks: list[Any] = []
    while get_origin(annotation) is Annotated:
        annotation, *more = get_args(annotation)
        marks = [*more, *marks]
    return marks, annotation


def _union(arguments: list[Any], links: Links) -> tuple[str, str]:
    found = [value_of(a, links) for a in arguments]
    kinds = [text.removeprefix("kind ") for text, _ in found if text.startswith("kind ")]
    others = list(dict.fromkeys(text for text, _ in found if not text.startswith("kind ")))
    if {"text", "whole number", "number"} <= set(others):
        others = ["number, text" + (", `true`, `false`" if len(others) > 3 else "")]
    parts = [*others, *([f"kind {', '.join(kinds)}"] if kinds else [])]
    return " or ".join(parts), next((unit for _, unit in found if unit), "")


def _sequence(arguments: tuple[Any, ...], links: Links) -> tuple[str, str]:
    found = [value_of(a, links) for a in arguments if a is not Ellipsis]
    units = list(dict.fromkeys(unit for _, unit in found if unit))
    if Ellipsis in arguments:
        return f"list of: {found[0][0]}", found[0][1]
    if len(set(found)) == 1:
        return f"list of {NUMBERS[len(found)]}: {found[0][0]}", found[0][1]
    return f"pair of {' and '.join(text for text, _ in found)}", ", ".join(units)


def _scalar(mark: Scalar) -> tuple[str, str]:
    """A value of a dimension, a plain number, or either an expression."""
    match mark:
        case Varying():
            text, unit = _scalar(mark.constant)
            return f"{text}, or an expression", unit
        case Dimension():
            bounds = _bounds(mark.above, mark.at_least, mark.at_most, None)
            what = mark.what.removeprefix("a ").removeprefix("an ")
            return f"{what}{bounds}, e.g. `{mark.example}`", mark.unit
        case Plain():
            bounds = _bounds(mark.above, mark.at_least, mark.at_most, mark.below)
            return f"{'whole number' if mark.integer else 'number'}{bounds}", ""
    return "`effusivity`, or a number from 0 to 1", ""


def _bounds(
    above: float | None, at_least: float | None, at_most: float | None, below: float | None
) -> str:
    pairs = {"above": above, "at least": at_least, "at most": at_most, "below": below}
    parts = [
        f"{word} {value:g}" for word, value in pairs.items() if value is not None and value < HUGE
    ]
    return f", {' and '.join(parts)}" if parts else ""


def default_of(key: str, field: FieldInfo) -> str:
    """The default of a key, in Markdown; empty if it is required."""
    if field.is_required() or (key == "kind" and field.default != "isotropic"):
        return ""
    default = field.get_default(call_default_factory=True)
    marks, _ = marks_of(annotation_of(field))
    for mark in marks:
        if isinstance(mark, Scalar) and default is not None:
            return f"`{_yaml(mark.write(default))}`"
    if default is None:
        return "none"
    if isinstance(default, BaseModel):
        return "its defaults"
    if default in ("", (), {}):
        return "empty"
    if isinstance(default, tuple):
        if isinstance(default[0], BaseModel):
            return "`[{name: load}]`"
        return "`[" + ", ".join(f"{value:g}" for value in default) + "]`"
    return f"`{_yaml(default)}`"


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else f"{value:g}"
