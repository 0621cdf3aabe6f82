"""The ``variations`` section of a case: runs on one mesh with changed loads and laws.

Only changes that keep mesh and bonded stiffness, which the runs share
(`app/simulation/session.py`).
"""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import BeforeValidator

from app.case.points import short_keys
from app.foundation.layout import plain_text
from app.schema.section import MAPPING, Name, did_you_mean, fail, show
from app.schema.yaml_file import CaseFile, YamlMapping, key_parts

OF_LOADS = ("force", "at", "pressure", "density", "history", "status", "source")
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
# Sections whose changes a title leaves out.
UNTITLED = ("output", "solver", "variations")
# Between a title and the changes.
CHANGED = "; changed: "


def _section(value: dict[str, object]) -> dict[str, object]:
    for name, changed_values in value.items():
        if name == "grid":
            fail(NO_GRID, at=(name,))
        if not isinstance(changed_values, dict):
            fail(f"{show(changed_values)} is not a mapping of keys to values", at=(name,))
        for key in changed_values:
            if not MAY_VARY.fullmatch(key):
                path = key.split(".")
                known_keys = {"loads": OF_LOADS, "solver": OF_SOLVER}.get(path[0], ())
                message = (
                    "cannot vary between runs that share a mesh (it may change mesh or stiffness)"
                )
                fail(f"{message}; {ALLOWED}{did_you_mean(path[-1], known_keys)}", at=(name, key))
    return value


# Pydantic applies these from right to left: MAPPING, then `_section`.
Variations = Annotated[dict[Name, dict[str, object]], BeforeValidator(_section), MAPPING]


def shared_and_varied(data: YamlMapping) -> tuple[dict[str, object], dict[str, object]]:
    """Split a resolved case into the data that variations share and those that may vary, by key."""
    shared_data = {key: value for key, value in data.items() if key not in ("title", "interfaces")}
    varied: dict[str, object] = {
        f"interfaces.{name}": law for name, law in data.get("interfaces", {}).items()
    }
    varied["title"] = data.get("title", "")
    loads: dict[str, object] = {}
    for name, load in data.get("loads", {}).items():
        loads[name] = {key: value for key, value in load.items() if key not in OF_LOADS}
        varied |= {f"loads.{name}.{key}": load[key] for key in OF_LOADS if key in load}
    solver = dict(data.get("solver", {}))
    varied |= {f"solver.{key}": solver.pop(key) for key in OF_SOLVER if key in solver}
    return shared_data | {"loads": loads, "solver": solver}, varied


def expand(key: str, data: YamlMapping) -> list[str]:
    """Expand ``*`` in a key to every name of its section in the data."""
    section, _, ending = key.partition(".*")
    return [f"{section}.{name}{ending}" for name in data.get(section, {})] if ending else [key]


def title_with_changes(title: str, file: CaseFile) -> str:
    """Append the changes by options, a sweep or a variation to the title of a case.

    An empty or overridden title is returned as it is.
    """
    keys = {place: key_parts(place) for place in file.places.values() if isinstance(place, str)}
    if not title or ["title"] in keys.values():
        return title
    changed_keys = {key: path for key, path in keys.items() if path[0] not in UNTITLED}
    short_names = short_keys(list(changed_keys))
    given_values = {name: file.given[key] for key, name in short_names.items()}
    values = (
        f"without {k}" if v is None else f"{k} {plain_text(v)}" for k, v in given_values.items()
    )
    return f"{title}{CHANGED}{', '.join(values)}" if changed_keys else title
