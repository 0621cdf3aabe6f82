"""The closing tables: what a run has found, for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.case.quantities import NECROSIS, TABLE, numbers_of

Rows = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        title: What stands above it.
        keys: Its quantities, separated by blanks.
        widths: Least number of characters without errors and with them.
        between: What separates the quantities.
        unit: That of the quantities by default.
    """

    title: str
    keys: str
    widths: tuple[int, int] = (9, 14)
    between: str = " / "
    unit: str = ""


# By section of the summary, the column of names first.
TABLES: dict[str, tuple[Column, ...]] = {
    "interfaces": (
        Column("interface", "", (14, 14)),
        Column("gap max/p99", "gap_max gap_p99", (15, 21)),
        Column("slip max/p99", "slip_max slip_p99", (15, 21)),
        Column("motion max/p99", "motion_max motion_p99", (15, 21)),
        Column("pressure max/p95", "pressure_max pressure_p95", (17, 23)),
        Column("shear max/p95", "shear_max shear_p95", (17, 23)),
        Column(
            title="open/stick/slip",
            keys="open_fraction stick_fraction slip_fraction",
            widths=(18, 18),
            unit="% of area",
        ),
    ),
    "regions": (
        Column("region", "", (16, 16)),
        Column("von Mises p99", "von_mises_p99", (15, 21)),
        Column("tension max/p99", "principal_max principal_p99", (19, 25)),
        Column("mean stress", "mean_stress_min mean_stress_max", (18, 18), " .. "),
    ),
    "thermal.regions": (
        Column("temperature", "", (18, 18)),
        Column("hottest", "temperature_max"),
        Column("at time", "temperature_max_time"),
        Column("hottest at end", "temperature_end_max"),
        Column("mean at end", "temperature_mean"),
        Column("over 47 degC", "seconds_over_47"),
    ),
    "thermal.interfaces": (
        Column("interface", "", (18, 18)),
        Column("hottest, first side", "temperature_max_first"),
        Column("second side", "temperature_max_second"),
        Column("largest jump", "temperature_jump_max"),
        Column("largest flux", "heat_flux_max"),
    ),
}
SENTENCES = {
    "bonds": "{name}, bonded: {strength_fraction} of its area above its strength; "
    "normal {normal_mean} (mean), shear {shear_mean}",
    "cure": "{name} has set to {degree_min} .. {degree_max}{reached}; fastest rate {rate_max}",
    "stem": "stem against bone: subsidence {subsidence}, retroversion {retroversion}, "
    "varus {varus}",
}


def lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """Interfaces, regions, bonds, temperatures, dead bone, cure, and how the stem moves."""
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


def _table(section: str, rows: Rows) -> list[str]:
    """A table of a section; what other packages have added stands on the right."""
    own = TABLE[section]
    first, *columns = TABLES[section]
    columns += [Column(q.label, q.key) for q in own.values() if q.compute]
    heads = [(c.title, c.unit or own[c.keys.split()[0]].shown, c.widths) for c in columns]
    heads.insert(0, (first.title, "", first.widths))
    cells = {
        name: [c.between.join(own[key].text(q) for key in c.keys.split()) for c in columns]
        for name, q in rows.items()
    }
    return _layout(heads, cells, rows)


def _necrosis(regions: Rows) -> list[str]:
    """Dead bone by every criterion, because they disagree."""
    own = TABLE["thermal.regions"]
    bone = {name: q for name, q in regions.items() if "necrosis_47C_1min_volume" in q}
    kinds = (("volume", "", "mm^3"), ("depth", ", depth", "mm"))
    heads = [(f"{name}{what}", unit, (9, 14)) for name in bone for _, what, unit in kinds]
    heads.insert(0, ("dead bone", "", (18, 18)))
    cells = {
        words: [own[f"necrosis_{rule}_{k}"].text(q) for q in bone.values() for k, *_ in kinds]
        for rule, words in NECROSIS.items()
    }
    return _layout(heads, cells, bone)


def _layout(
    heads: Sequence[tuple[str, str, tuple[int, int]]],
    cells: Mapping[str, Sequence[str]],
    rows: Rows,
) -> list[str]:
    """Titles, units and cells, each as wide as its title at least; nothing without rows."""
    errors = any(key.endswith("_error") for q in rows.values() for key in q)
    wide, *widths = (max(len(title), least[errors]) for title, _, least in heads)
    every = [*list(zip(*heads, strict=True))[:2], *((name, *row) for name, row in cells.items())]
    return [
        f"{name:<{wide}}" + "".join(f" {c:>{w}}" for c, w in zip(row, widths, strict=True))
        for name, *row in every
        if rows
    ]


def _sentence(section: str, name: str, numbers: Mapping[str, Any]) -> str:
    own = [(key, q) for key, q in TABLE[section].items() if not q.vector]
    texts = {key: f"{q.text(numbers)} {q.shown}".removesuffix(" -") for key, q in own}
    reached = (
        f", {part} % everywhere at {texts[f'time_{part}']}"
        for part in (50, 90)
        if numbers.get(f"time_{part}") is not None
    )
    return SENTENCES[section].format(name=name, reached="".join(reached), **texts)
