"""The ``variations`` section of a case: what changes from one run of it to the next on one mesh.

Only changes that leave mesh and bonded stiffness alone: these, and all that is made of them, are
shared by the runs (`app/simulation/variations.py`).
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import BeforeValidator

from app.schema.section import MAPPING, Name, did_you_mean, fail, show
from app.schema.yaml_file import CaseFile, Path, key_parts
from app.system.layout import plain

# The name of the entry whose lists multiply.
GRID = "grid"
MOST = 20_000
OF_LOADS = ("force", "at", "pressure", "density", "history")
OF_SOLVER = ("augmentation_factor",)
MAY_VARY = re.compile(
    rf"(interfaces\.[^.\[]+(\..+)?|loads\.[^.\[]+\.({'|'.join(OF_LOADS)})([.\[].*)?"
    rf"|solver\.({'|'.join(OF_SOLVER)})|title)"
)
ALLOWED = (
    "allowed: interfaces.<name> and all of its keys, "
    f"loads.<name>.{'|'.join(OF_LOADS)} (* for every name), solver.{'|'.join(OF_SOLVER)}, title"
)
# A value that can be part of the name of a folder.
LABEL = re.compile(r"[A-Za-z0-9_.+-]{1,24}")
# Sections that a title does not tell of.
UNTITLED = ("output", "solver", "study", "variations")
# What stands between a title and what is changed.
CHANGED = "; changed: "


@dataclass(frozen=True)
class Variation:
    """One run, or a value of an axis that several runs have.

    Attributes:
        name: Its folder, or part of its name.
        changes: Override keys with values.
        places: Where each of them stands in the file.
    """

    name: str
    changes: dict[str, Any] = field(default_factory=dict)
    places: dict[str, Path] = field(default_factory=dict)


def _section(value: dict[str, Any]) -> dict[str, Any]:
    """Names with changes that may vary; lists in the grid."""
    for name, changes in value.items():
        if not isinstance(changes, dict):
            fail(f"{show(changes)} is not a mapping of keys to values", at=(name,))
        for key, entry in changes.items():
            if not MAY_VARY.fullmatch(key):
                fail(_refusal(key), at=(name, key))
            if name == GRID and not (isinstance(entry, list) and entry):
                text = f"{show(entry)} is not a list of values; expected e.g. [0.2, 0.4]"
                fail(text, at=(name, key))
    if GRID in value and not value[GRID]:
        fail("varies nothing", at=(GRID,))
    if (number := math.prod(len(entry) for entry in value.get(GRID, {}).values())) > MOST:
        fail(f"{number} combinations; at most {MOST} are allowed", at=(GRID,))
    for key, names in labels(value.get(GRID, {})).items():
        for i, label in enumerate(names):
            if label in names[:i]:
                fail(f"{label} stands here twice", at=(GRID, key, i))
    return value


def _refusal(key: str) -> str:
    """Why a key may not vary, and what may."""
    words = key.split(".")
    known = {"loads": OF_LOADS, "solver": OF_SOLVER}.get(words[0], ())
    hint = did_you_mean(words[-1], known) if known else ""
    return f"may not vary in one run (it may change mesh or stiffness); {ALLOWED}{hint}"


# What stands last is checked first.
Variations = Annotated[dict[Name, dict[str, Any]], BeforeValidator(_section), MAPPING]


def expand(section: Mapping[str, Mapping[str, Any]]) -> list[Variation]:
    """Every run of a section, in the order of the file: a grid's last key changes fastest."""
    return [v for name in section for v in (_grid if name == GRID else _single)(name, section)]


def split(data: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A case in two: what all its variations share, and what may vary by override key.

    Args:
        data: A resolved case as plain data.
    """
    shared = {key: value for key, value in data.items() if key not in ("title", "interfaces")}
    own = {f"interfaces.{name}": law for name, law in data.get("interfaces", {}).items()}
    own["title"] = data.get("title", "")
    loads: dict[str, Any] = {}
    for name, load in data.get("loads", {}).items():
        loads[name] = {key: value for key, value in load.items() if key not in OF_LOADS}
        own |= {f"loads.{name}.{key}": load[key] for key in OF_LOADS if key in load}
    solver = dict(data.get("solver", {}))
    own |= {f"solver.{key}": solver.pop(key) for key in OF_SOLVER if key in solver}
    return shared | {"loads": loads, "solver": solver}, own


def every(key: str, data: Mapping[str, Any]) -> list[str]:
    """The keys that one with ``*`` for a name stands for.

    Args:
        key: A key.
        data: The content of the file.
    """
    section, _, rest = key.partition(".*")
    return [f"{section}.{name}{rest}" for name in data.get(section, {})] if rest else [key]


def _single(name: str, section: Mapping[str, Mapping[str, Any]]) -> Iterator[Variation]:
    changes = dict(section[name])
    yield Variation(name, changes, {key: ("variations", name, key) for key in changes})


def _grid(name: str, section: Mapping[str, Mapping[str, Any]]) -> Iterator[Variation]:
    grid = section[name]
    for point in itertools.product(*axes(grid, short_keys(list(grid)), ("variations", name))):
        yield Variation(
            "_".join(v.name for v in point),
            {key: value for v in point for key, value in v.changes.items()},
            {key: place for v in point for key, place in v.places.items()},
        )


def axes(
    grid: Mapping[str, Sequence[Any]], short: Mapping[str, str], path: Path
) -> Iterator[list[Variation]]:
    """The values of each key of a grid, as changes of their own.

    Args:
        grid: Lists of values by key.
        short: What each key is called.
        path: Where the grid stands in the file.
    """
    for key, names in labels(grid).items():
        yield [
            Variation(f"{short[key]}={name}", {key: value}, {key: (*path, key, i)})
            for i, (name, value) in enumerate(zip(names, grid[key], strict=True))
        ]


def labels(grid: Mapping[str, Sequence[Any]]) -> dict[str, list[str]]:
    """How values are called: as they are, by number, by kind, or by their place in the list."""
    return {key: _called(values) for key, values in grid.items()}


def _called(values: Sequence[Any]) -> list[str]:
    singles = [v[0] if isinstance(v, list) and len(v) == 1 else v for v in values]
    singles = [v.get("kind") if isinstance(v, dict) else v for v in singles]
    texts = [str(v) if isinstance(v, str | int | float) else "" for v in singles]
    whole = [text.replace(" ", "") for text in texts]
    numbers = [text.partition(" ")[0] for text in texts]
    if all(map(LABEL.fullmatch, whole)) and (
        len(set(whole)) == len(whole) or not any(isinstance(v, dict) for v in values)
    ):
        return whole
    if all(map(LABEL.fullmatch, numbers)) and len(set(numbers)) == len(numbers):
        return numbers
    return [f"#{i + 1}" for i in range(len(values))]


def short_keys(keys: Sequence[str]) -> dict[str, str]:
    """Each key by as many of its last words as tell it from the others."""
    words = {key: re.sub(r"\[(\d+)\]", r".\1", key).split(".") for key in keys}

    def shortened(key: str) -> str:
        own = words[key]
        for n in range(1, len(own)):
            if sum(w[-n:] == own[-n:] for w in words.values()) == 1:
                return ".".join(own[-n:])
        return ".".join(own)

    return {key: shortened(key) for key in keys}


def titled(title: str, file: CaseFile) -> str:
    """The title of a case with what options, a sweep or a variation have changed in it.

    Args:
        title: The title; nothing is added to none, nor to one that is changed itself.
        file: The case.
    """
    keys = {place: key_parts(place) for place in file.places.values() if isinstance(place, str)}
    if not title or ["title"] in keys.values():
        return title
    told = {key: path for key, path in keys.items() if path[0] not in UNTITLED}
    short = short_keys(list(told))
    given = {name: file.given[key] for key, name in short.items()}
    values = (f"without {k}" if v is None else f"{k} {plain(v)}" for k, v in given.items())
    return f"{title}{CHANGED}{', '.join(values)}" if told else title
