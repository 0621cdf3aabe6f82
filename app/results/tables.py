"""The closing tables: results of a run, for people."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from app.case.quantities import NECROSIS, TABLE, numbers_of
from app.system import layout

Rows = Mapping[str, Mapping[str, Any]]

# By section of the summary: titles of columns, that of the names first, and their quantities.
TABLES: dict[str, dict[str, str]] = {
    "interfaces": {
        "interface": "",
        "gap max/p99": "gap_max / gap_p99",
        "slip max/p99": "slip_max / slip_p99",
        "motion max/p99": "motion_max / motion_p99",
        "pressure max/p95": "pressure_max / pressure_p95",
        "shear max/p95": "shear_max / shear_p95",
        "open/stick/slip": "open_fraction / stick_fraction / slip_fraction",
    },
    "regions": {
        "region": "",
        "von Mises p99": "von_mises_p99",
        "tension max/p99": "principal_max / principal_p99",
        "mean stress": "mean_stress_min .. mean_stress_max",
    },
    "thermal.regions": {
        "temperature": "",
        "hottest": "temperature_max",
        "at time": "temperature_max_time",
        "hottest at end": "temperature_end_max",
        "mean at end": "temperature_mean",
        "over 47 degC": "seconds_over_47",
    },
    "thermal.interfaces": {
        "interface": "",
        "hottest, first side": "temperature_max_first",
        "second side": "temperature_max_second",
        "largest jump": "temperature_jump_max",
        "largest flux": "heat_flux_max",
    },
}
SENTENCES = {
    "bonds": "{name}, bonded: {strength_fraction} of its area above its strength; "
    "normal {normal_mean} (mean), shear {shear_mean}",
    "cure": "{name} has set to {degree_min} .. {degree_max}{reached}; fastest rate {rate_max}",
    "stem": "stem against bone: subsidence {subsidence}, retroversion {retroversion}, "
    "varus {varus}",
}


def lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """Interfaces, regions, bonds, temperatures, dead bone, cure, and motion of the stem."""
    rows: dict[str, dict[str, dict[str, Any]]] = {section: {} for section in TABLE}
    for section, name, numbers in numbers_of(summary):
        rows[section][name] = numbers
    for section in ("interfaces", "regions"):
        yield from _table(section, rows[section])
    yield from (_sentence("bonds", *row) for row in rows["bonds"].items())
    for section in ("thermal.regions", "thermal.interfaces"):
        yield from _table(section, rows[section])
    yield from _necrosis(rows["thermal.regions"])
    if note := summary.get("thermal", {}).get("note"):
        yield note
    for section in ("cure", "stem"):
        yield from (_sentence(section, *row) for row in rows[section].items())


def keys(section: str) -> list[str]:
    """Quantities in the table of a section, in its order."""
    return re.findall(r"\w+", " ".join(TABLES.get(section, {}).values()))


def _table(section: str, rows: Rows) -> list[str]:
    """A table of a section; quantities added by other packages stand on the right."""
    own = TABLE[section]
    columns = TABLES[section] | {q.label: key for key, q in own.items() if q.compute}
    templates = list(filter(None, columns.values()))

    def cell(template: str, numbers: Mapping[str, Any]) -> str:
        return re.sub(r"\w+", lambda key: own[key[0]].text(numbers), template)

    cells = [[name, *(cell(t, numbers) for t in templates)] for name, numbers in rows.items()]
    units = ["", *(own[c.split()[0]].shown for c in templates)]
    return layout.table(list(columns), cells, units).splitlines() if rows else []


def necrosis(regions: Rows) -> tuple[list[str], list[list[str]]]:
    """Regions of bone, and volume and depth of their dead parts by criterion [mm3, mm]."""
    own = TABLE["thermal.regions"]
    bones = [name for name, q in regions.items() if "necrosis_47C_1min_volume" in q]
    columns = [(regions[name], what) for name in bones for what in ("volume", "depth")]
    rows = [
        [words, *(own[f"necrosis_{rule}_{what}"].text(q) for q, what in columns)]
        for rule, words in NECROSIS.items()
    ]
    return bones, rows


def _necrosis(regions: Rows) -> list[str]:
    bones, rows = necrosis(regions)
    head = ["dead bone", *(f"{name}{what}" for name in bones for what in ("", ", depth"))]
    units = ["", *(["mm^3", "mm"] * len(bones))]
    return layout.table(head, rows, units).splitlines() if bones else []


def _sentence(section: str, name: str, numbers: Mapping[str, Any]) -> str:
    own = [(key, q) for key, q in TABLE[section].items() if not q.vector]
    texts = {key: f"{q.text(numbers)} {q.shown}".removesuffix(" -") for key, q in own}
    reached = (
        f", {part} % everywhere at {texts[f'time_{part}']}"
        for part in (50, 90)
        if numbers.get(f"time_{part}") is not None
    )
    return SENTENCES[section].format(name=name, reached="".join(reached), **texts)
