"""Log of a run: messages on rank 0 through `logging`, lines per step, the closing tables."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from app.case.quantities import ADDED, NECROSIS, TABLE, numbers_of
from app.foundation.verdict import Severity, recorded
from app.results.cycles import sentences
from app.results.verdicts import BALANCES
from app.system import layout

if TYPE_CHECKING:
    from app.stepping.heat_state import HeatStep
    from app.stepping.load_steps import LoadStep


log = logging.getLogger("mantle")

# Columns of the lines of steps and of heat steps, with their widths.
STEP = {"step": 4, "time": 7, "newton": 6, "krylov": 6, "residual": 9}
STEP |= {"open": 6, "slip": 6, "penetration": 12, "wall": 8, "left": 8}
HEAT = {"step": 4, "time": 11, "step of": 10, "newton": 6, "krylov": 6}
HEAT |= {"hottest": 10, "balance": 9, "wall": 8}


def line(columns: Mapping[str, int], texts: Iterable[object]) -> str:
    """Texts in columns, to the right."""
    return " ".join(f"{t:>{width}}" for t, width in zip(texts, columns.values(), strict=True))


def step_line(
    step: LoadStep, fractions: Sequence[float], penetration: float, wall: float, left: float
) -> str:
    """One line for a converged step.

    Open and slipping fraction of the contact area, largest penetration [mm], seconds so far, left.
    """
    o = step.outcome
    effort = (o.iterations, o.linear_iterations, f"{o.residuals[-1]:.1e}")
    states = (*(f"{100 * part:.1f}%" for part in fractions), f"{penetration:.1e} mm")
    times = (f"{wall:.1f} s", f"{left:.1f} s")
    return line(STEP, (step.number, f"{step.time:.4g}", *effort, *states, *times))


def heat_line(number: int, accepted: HeatStep, row: dict[str, float], wall: float) -> str:
    """One line for a heat step."""
    hottest = max(v for k, v in row.items() if k.endswith("temperature_max [degC]"))
    o = accepted.outcome
    times = (f"{accepted.seconds:.4g} s", f"{accepted.dt:.3g} s")
    found = (f"{hottest:.1f} degC", f"{row['heat balance [-]']:.1e}", f"{wall:.1f} s")
    return line(HEAT, (number, *times, o.iterations, o.linear_iterations, *found))


def closing_table(summary: dict[str, Any]) -> str:
    """Table of results at the end of a run, with balances."""
    b = summary["balance"]
    balances = ", ".join(f"{name} {b[name]:.1e}" for name in BALANCES if name in b)
    return "\n".join([*lines(summary), f"balance of {balances}"])


def report(summary: dict[str, Any], table: bool = True) -> None:
    """Log the end of a run: its verdicts, below all its numbers if these are wanted."""
    if table:
        log.info("%s", closing_table(summary))
    for verdict in recorded(summary):
        # Notes are logged when they are found.
        if verdict.severity is not Severity.NOTE:
            log.info("%s", verdict, extra={"tone": verdict.tone})


# Tables

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
FAILING = "failure_load_factor"
SENTENCES = {
    "bonds": "{name}, bonded: {strength_fraction} of its area above its strength; "
    "normal {normal_mean} (mean), shear {shear_mean}",
    "torque_max": "{name}: friction torque {torque_max} at most in a cycle",
    "dissipation_cycle": "{name}: {dissipation_cycle} dissipated and {slid_max} slid in a cycle",
    "uncovered_fraction": "{name}: {uncovered_fraction} of the slave faced no master at some time",
    "wear_volume": "{name}: {wear_volume_million} worn in a million cycles, "
    "{wear_depth_max_million} at the deepest, {wear_depth_p99_million} (p99)",
    "strength": "{name}: a hundredth of its area fails at {failure_load_factor} of this load; "
    "failure index {failure_index_p99} (p99), {failure_index_max} (max)",
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
    for key in ("torque_max", "dissipation_cycle", "wear_volume", "uncovered_fraction"):
        own = (row for row in rows["interfaces"].items() if key in row[1])
        yield from (_sentence("interfaces", *row, text=key) for row in own)
    yield from (_sentence("bonds", *row) for row in rows["bonds"].items())
    strong = (row for row in (rows["interfaces"] | rows["bonds"]).items() if FAILING in row[1])
    yield from (_sentence("bonds", *row, text="strength") for row in strong)
    for section in (*ADDED, "thermal.regions", "thermal.interfaces"):
        yield from _table(section, rows[section])
    yield from _necrosis(rows["thermal.regions"])
    note = summary.get("thermal", {}).get("note")
    if note:
        yield note
    for section in ("cure", "stem"):
        yield from (_sentence(section, *row) for row in rows[section].items())
    yield from sentences(summary.get("cycles", {}))


def keys(section: str) -> list[str]:
    """Quantities in the table of a section, in its order."""
    return re.findall(r"\w+", " ".join(_columns(section).values()))


def _columns(section: str) -> Mapping[str, str]:
    """Columns of the table of a section; none if it has none."""
    return ADDED[section].columns if section in ADDED else TABLES.get(section, {})


def _table(section: str, rows: Rows) -> list[str]:
    """A table of a section; quantities added by other packages stand on the right."""
    own = TABLE[section]
    columns = dict(_columns(section)) | {q.label: key for key, q in own.items() if q.compute}
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


def _sentence(section: str, name: str, numbers: Mapping[str, Any], text: str = "") -> str:
    own = [(key, q) for key, q in TABLE[section].items() if not q.vector]
    texts = {key: f"{q.text(numbers)} {q.shown}".removesuffix(" -") for key, q in own}
    reached = (
        f", {part} % everywhere at {texts[f'time_{part}']}"
        for part in (50, 90)
        if numbers.get(f"time_{part}") is not None
    )
    return SENTENCES[text or section].format(name=name, reached="".join(reached), **texts)
