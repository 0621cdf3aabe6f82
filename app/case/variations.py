"""The ``variations`` section of a case: what changes from one run of it to the next on one mesh.

Only changes that leave mesh and bonded stiffness alone: these, and all that is made of them, are
shared by the runs (`app/simulation/variations.py`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator

from app.case.points import short_keys
from app.schema.section import MAPPING, Name, did_you_mean, fail, show
from app.schema.yaml_file import CaseFile, key_parts
from app.system.layout import plain

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
NO_GRID = (
    "a grid stands in a sweep file: base: CASE and grid; mantle sweep shares mesh and matrices too"
)
# Sections that a title does not tell of.
UNTITLED = ("output", "solver", "variations")
# What stands between a title and what is changed.
CHANGED = "; changed: "


def _section(value: dict[str, Any]) -> dict[str, Any]:
    """Names with changes that may vary."""
    for name, changes in value.items():
        if name == "grid":
            fail(NO_GRID, at=(name,))
        if not isinstance(changes, dict):
            fail(f"{show(changes)} is not a mapping of keys to values", at=(name,))
        for key in changes:
            if not MAY_VARY.fullmatch(key):
                fail(_refusal(key), at=(name, key))
    return value


def _refusal(key: str) -> str:
    """Why a key may not vary, and what may."""
    path = key.split(".")
    known = {"loads": OF_LOADS, "solver": OF_SOLVER}.get(path[0], ())
    hint = did_you_mean(path[-1], known) if known else ""
    return f"may not vary in one run (it may change mesh or stiffness); {ALLOWED}{hint}"


# What stands last is checked first.
Variations = Annotated[dict[Name, dict[str, Any]], BeforeValidator(_section), MAPPING]


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


def expand(key: str, data: Mapping[str, Any]) -> list[str]:
    """The keys that one with ``*`` for a name stands for.

    Args:
        key: A key.
        data: The content of the file.
    """
    section, _, rest = key.partition(".*")
    return [f"{section}.{name}{rest}" for name in data.get(section, {})] if rest else [key]


def title_with_changes(title: str, file: CaseFile) -> str:
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
