"""Log of a run: messages on rank 0 through `logging`, lines per step, the closing tables."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from app.case import quantities
from app.case.quantities import NECROSIS, TABLE, in_print, numbers_of
from app.foundation.errors import UnusableError
from app.results.cycles import sentences
from app.results.damage import RESOLVED
from app.results.error_estimate import is_zero, largest_of_units
from app.system import layout

if TYPE_CHECKING:
    from app.stepping.heat_state import HeatStep
    from app.stepping.load_steps import LoadStep


log = logging.getLogger("mantle")

# Status of solved cases whose numbers are not to be used.
UNUSABLE = "do not use"
BEYOND = "exceeds the size of its facets: beyond small displacements (`sliding: finite` follows it)"

# Error sources, where coarser meshes could be compared.
BOTH = "mesh and step"

# Unsettled peaks that the log lists.
MOST = 3

# A largest pressure above the largest mean at a point by this factor depends on the mesh.
STEEP = 1.5

PERCENTILE = re.compile(r"_p\d+$")

# Limits of the balances: forces to rounding, heat to its solver's tolerance.
BALANCES: dict[str, float] = {"force": 1e-8, "moment": 1e-8, "energy": 1e-8, "heat": 1e-6}

# Strain of a living cortex [1e-6], from memory, and motion of the head [mm] (Chen 2020).
STRAINS, MOTION = (500.0, 2500.0), 5.0

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


def unbalanced(summary: Mapping[str, Any]) -> list[str]:
    """Balances above their limit; NaN counts as above."""
    b = summary.get("balance", {})
    return [name for name, limit in BALANCES.items() if name in b and not b[name] < limit]


def too_far(summary: Mapping[str, Any]) -> list[str]:
    """Interfaces on which bodies slip farther than their facets are wide."""
    return [
        name
        for name, q in summary.get("interfaces", {}).items()
        if quantities.largest(q, "slip_max") > q.get("facet_size", np.inf)
    ]


def reasons_not_to_use(summary: Mapping[str, Any]) -> list[str]:
    """Reasons not to use the numbers of a solved case; empty if they are sound."""
    lost = [
        f"the balance of {name} is {summary['balance'][name]:.1e}, not below {BALANCES[name]:g}"
        for name in unbalanced(summary)
    ]
    return lost + [f"slip on {name} {BEYOND}" for name in too_far(summary)]


def check_usable(summaries: Mapping[Path, Mapping[str, Any]]) -> None:
    """Refuse unusable results, by run directory.

    Raises:
        UnusableError: With the reasons of each.
    """
    found = {folder: "; ".join(reasons_not_to_use(s)) for folder, s in summaries.items()}
    if bad := [f"do not use the numbers in {f}: {why}" for f, why in found.items() if why]:
        raise UnusableError("\n".join(bad))


@dataclass(frozen=True)
class Verdict:
    """A line on one aspect: ``good``, ``doubtful``, ``bad``, or empty where it is neither."""

    text: str
    tone: str = ""


def report(summary: dict[str, Any], table: bool = True) -> None:
    """Log the end of a run: its verdict, below all its numbers if these are wanted."""
    if table:
        log.info("%s", closing_table(summary))
    for clause in (*verdict(summary), *peaks(summary)):
        log.info("%s", clause.text, extra={"tone": clause.tone})


def verdict(summary: dict[str, Any]) -> list[Verdict]:
    """Reliability of the numbers, a line for each reason."""
    solver, t, m = summary["solver"], summary["timing"], summary.get("memory")
    took = f", {m['peak']:.0f} MB ({m['per_unknown']:.1f} kB per unknown)" if m else ""
    solved = (
        f"converged: {solver['dofs']} unknowns, {solver['steps']} steps, "
        f"{solver['newton_iterations']} Newton iterations on {solver['ranks']} rank(s) in "
        f"{t['total']:.1f} s{took}"
    )
    lost = unbalanced(summary)
    forces = [name for name in lost if name != "heat"]
    clauses = [Verdict(solved)]
    if "force" in summary["balance"]:
        held = f"NOT balanced ({', '.join(forces)}), do not use" if forces else "exact to rounding"
        clauses.append(Verdict(f"equilibrium: {held}", "bad" if forces else "good"))
    if "heat" in summary["balance"]:
        kept = "NOT balanced, do not use" if "heat" in lost else "none is lost"
        clauses.append(Verdict(f"heat: {kept}", "bad" if "heat" in lost else "good"))
    if summary["interfaces"]:
        clauses.append(_contact(summary["interfaces"]))
    clauses += [
        _by_facets(name, q)
        for name, q in summary["interfaces"].items()
        if "pressure_by_facets" in q
    ]
    clauses += [_steep(name, q) for name, q in summary["interfaces"].items() if _is_steep(q)]
    clauses += [_crack(name, q) for name, q in summary["interfaces"].items() if "zone_length" in q]
    if far := too_far(summary):
        clauses.append(Verdict(f"slip: on {' and '.join(far)} {BEYOND}, do not use", "bad"))
    asked = [Verdict(summary["accuracy"])] if "accuracy" in summary else []
    if laws := summary.get("fatigue"):
        clauses.append(Verdict(f"fatigue: {life(laws)}", "doubtful"))
    unsettled = summary.get("error", {}).get("unsettled", {})
    for name, q in summary.get("regions", {}).items():
        if "failure_risk" in q:
            clauses.append(_strength(name, q, unsettled))
    return [*clauses, *_physiology(summary), _mesh_and_step(summary), *asked]


def _physiology(summary: Mapping[str, Any]) -> Iterator[Verdict]:
    """Motion of the head and strain of the cortex that are not those of a loaded living femur."""
    femur, loaded = summary.get("femur"), summary.get("section_loads", [])
    if not femur or not any(any(section["force"]) for section in loaded):
        return
    head = float(np.linalg.norm(femur["head_displacement"]))
    strains = [1e6 * abs(v) for key, v in femur.items() if re.fullmatch(r"strain.*\d", key)]
    (low, high), least, most = STRAINS, min(strains), max(strains)
    clauses = [f"the head moves {head:.1f} mm, above {MOTION:g}"] * (head > MOTION)
    if not low <= least <= most <= high:
        span = f"{least:.0f} to {most:.0f} um/m, not within {low:g} to {high:g}"
        clauses.append(f"the cortex is strained by {span}")
    if clauses:
        yield Verdict(f"physiology: {'; '.join(clauses)}", "doubtful")


def life(laws: Mapping[str, Mapping[str, Any]]) -> str:
    """Band of the life of a region, over laws and errors; no year without it."""
    known = [(q["damage_p99"], q.get("damage_p99_error") or 0.0) for q in laws.values()]
    most, least = max(d + e for d, e in known), min(d - e for d, e in known)
    mesh = any("damage_p99_error" in q for q in laws.values())
    text = f"over {', '.join(laws)}{' and mesh' * mesh}"
    if len(known) < 2 and not mesh:
        return f"no year without a band ({text}): name another law, or --error"
    short, long = (f"{float(f'{1 / d:.2g}'):g}" if d > 0 else "endless" for d in (most, least))
    return f"99 % of the volume lasts {short} to {long} years, {text}: to rank, not to predict"


def _strength(name: str, q: Mapping[str, Any], unsettled: Mapping[str, Any]) -> Verdict:
    """Probability that a region and its parts fail, and where it grows with every mesh."""
    texts, tone = [], ""
    for part in ("", *(p for p in quantities.PARTS if "failure_risk" in q.get(p, {}))):
        own, key = q[part] if part else q, f"{name}_{part}" if part else name
        text = f"{100 * own['failure_probability']:.2g} %{f' at its {part}' * bool(part)}"
        (_, fine), (size, coarse), *_ = unsettled.get(f"{key}.failure_risk", ((0, 0), (0, 0)))
        if fine > coarse:
            grown = f"from {coarse:.2g} at {size:g} mm to {fine:.2g}"
            text, tone = f"{text} (R grows {grown}: it may have no limit)", "doubtful"
        texts.append(text)
    return Verdict(f"strength: {name} breaks with a probability of {', '.join(texts)}", tone)


def _crack(name: str, q: Mapping[str, Any]) -> Verdict:
    """What of an interface is damaged, and whether the mesh resolves the zone where it breaks."""
    own = TABLE["interfaces"]
    keys = ("area_damaged", "area_broken", "unbonded_fraction", "zone_length", "zone_elements")
    damaged, broken, never, zone, elements = (own[key].text(q) for key in keys)
    text = f"cohesion: {name} is damaged on {damaged} mm^2, of which {broken} are broken"
    if q["unbonded_fraction"]:
        text += f"; {never} % never held"
    if q["zone_length"]:
        text += f"; its process zone is {zone} mm long, {elements} elements"
    if coarse := 0 < q["zone_elements"] < RESOLVED:
        text += f": not resolved, it takes {RESOLVED}; refine"
    return Verdict(in_print(text), "doubtful" if coarse else "good")


def _contact(interfaces: Mapping[str, Any]) -> Verdict:
    """Penetration of the bodies, and what the numbers of interfaces leave out."""

    def length(key: str) -> str:
        q = TABLE["interfaces"][key]
        return f"{q.factor * most[key]:.2g} {q.shown}"

    keys = ("penetration_max", "penetration_sampled")
    most = {key: max(q.get(key, 0.0) for q in interfaces.values()) for key in keys}
    gap = TABLE["interfaces"]["gap_max"].text
    rims = [f"{gap(own['rim'])} um ({name})" for name, own in interfaces.items() if "rim" in own]
    apart = f"; numbers are without rim and tip, the rim opens by {', '.join(rims)}" if rims else ""
    if most["penetration_max"] >= 1e-9:
        deep = length("penetration_max")
        return Verdict(f"contact: the bodies penetrate by {deep}{apart}", "doubtful")
    between = most["penetration_sampled"] >= 1e-9
    rest = f", within {length('penetration_sampled')} between them" if between else ""
    return Verdict(f"contact: exact to rounding at points{rest}{apart}", "good")


def _by_facets(name: str, q: Mapping[str, Any]) -> Verdict:
    """The largest pressure of an interface, where straight facets decide it."""
    most = TABLE["interfaces"]["pressure_max"].text(q)
    part = TABLE["interfaces"]["pressure_by_facets"].text(q)
    text = (
        f"pressure: the maximum on {name}, {most} MPa, depends on the facets of the mesh: slip "
        f"over them makes up to {part} MPa; less by curved cells of second order or smaller ones"
    )
    return Verdict(text, "doubtful")


def _is_steep(q: Mapping[str, Any]) -> bool:
    return bool(q.get("pressure_max", 0.0) > STEEP * q.get("pressure_mean_max", np.inf))


def _steep(name: str, q: Mapping[str, Any]) -> Verdict:
    """The largest pressure of an interface, where it is far above the mean at its point."""
    most, mean = (TABLE["interfaces"][key].text(q) for key in ("pressure_max", "pressure_mean_max"))
    text = f"pressure: the maximum on {name}, {most} MPa, is at a ridge or an edge"
    return Verdict(f"{text}; the mean at one point is {mean} MPa at most", "doubtful")


def _mesh_and_step(summary: Mapping[str, Any]) -> Verdict:
    """Estimated error of mesh and step."""
    estimated = summary.get("error", {})
    if not estimated.get("companions"):
        return Verdict(f"{BOTH}: error not estimated (--error does)")
    largest = largest_of_units(dict(summary))
    shares, zero = dict[str, float](), list[str]()
    for section in ("interfaces", "regions"):
        for name, q in summary.get(section, {}).items():
            for key in filter(PERCENTILE.search, q):
                error = q.get(f"{key}_error")
                if error is None or not q[key] or key not in TABLE[section]:
                    continue
                if is_zero(q[key], error, largest[TABLE[section][key].unit]):
                    zero.append(f"{key} of {name}")
                else:
                    shares[f"{key} of {name}"] = error / abs(q[key])
    share, text = sorted(shares, key=shares.__getitem__), "± is their estimated error"
    if share:
        of_them = (share[len(share) // 2], share[-1])
        half, worst = (f"{float(f'{100 * shares[key]:.2g}'):g}" for key in of_them)
        text = f"half of the percentiles within ± {half} %"
        text += f", the least sure ({share[-1]}) within ± {worst} %"
        if within := estimated.get("within"):
            text += f"; about {100 * within:.0f} of 100 such numbers lie within their ±"
    if zero:
        text += f"; zero to rounding or beside others: {', '.join(zero)}"
    of = estimated.get("of", BOTH)
    return Verdict(f"{of}: {text}" + ("" if of == BOTH else "; error of the mesh not estimated"))


def peaks(summary: Mapping[str, Any]) -> list[Verdict]:
    """Peaks that change most with the mesh, with their values on every mesh solved."""
    lines = []
    for name, ((finest, value), *others) in summary.get("error", {}).get("unsettled", {}).items():
        if (q := quantities.get(name)) and q.unit != "-":  # a risk is told with the strength
            on = [f"{name} {q.text({q.key: value})} {q.shown} at {finest:g} mm"]
            lines.append(
                ", ".join(on + [f"{q.text({q.key: v})} at {size:g}" for size, v in others])
            )
    more = [f"{len(lines) - MOST} more in error.unsettled of summary.json"] if lines[MOST:] else []
    text = f"peaks that still change with the mesh: {'; '.join(lines[:MOST] + more)}"
    return [Verdict(text, "doubtful")] if lines else []


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
    "fatigue": {
        "damage in a year": "",
        "p99": "damage_p99",
        "largest": "damage_max",
        "stress p99": "stress_p99",
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
    for section in ("fatigue", "thermal.regions", "thermal.interfaces"):
        yield from _table(section, rows[section])
    yield from _necrosis(rows["thermal.regions"])
    if note := summary.get("thermal", {}).get("note"):
        yield note
    for section in ("cure", "stem"):
        yield from (_sentence(section, *row) for row in rows[section].items())
    yield from sentences(summary.get("cycles", {}))


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


def _sentence(section: str, name: str, numbers: Mapping[str, Any], text: str = "") -> str:
    own = [(key, q) for key, q in TABLE[section].items() if not q.vector]
    texts = {key: f"{q.text(numbers)} {q.shown}".removesuffix(" -") for key, q in own}
    reached = (
        f", {part} % everywhere at {texts[f'time_{part}']}"
        for part in (50, 90)
        if numbers.get(f"time_{part}") is not None
    )
    return SENTENCES[text or section].format(name=name, reached="".join(reached), **texts)
