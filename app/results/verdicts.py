"""Verdicts on the numbers of a run: which are sound, doubtful, or must not be used."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from app.case import quantities, summary_numbers
from app.case.number_text import in_print
from app.case.quantities import TABLE
from app.case.summary import Numbers, Summary
from app.foundation.errors import UnusableError
from app.foundation.layout import count, several, two_digits
from app.foundation.verdict import Severity, Verdict, recorded, texts_of
from app.results.damage import RESOLVED
from app.results.error_estimate import is_zero, largest_of_units

# Status of solved cases whose numbers are not to be used.
UNUSABLE = "do not use"
# Parts of a result that verdicts judge: `Verdict.where`.
EQUILIBRIUM = "equilibrium"
HEAT = "heat"
CONTACT = "contact"
PEAKS = "maxima that still change with the mesh"
# Sources of error that a comparison with coarser meshes covers.
BOTH = "mesh and step"
# All sources of error that are estimated (`error_estimate.error_sources`).
ERRORS = (BOTH, "time step", "load step")
# Largest number of listed maxima that change with the mesh.
MOST_MAXIMA = 3
# Factor of the largest pressure over the largest mean at a point above which it depends on the
# mesh.
STEEP = 1.5
# Overlap of bodies above which contact is not satisfied to rounding [mm].
PENETRATION = 1e-9
# A largest pressure below this one is shown as 0.00 [MPa].
SHOWN = 0.005
# Ends of the keys of percentiles.
PERCENTILE = re.compile(r"_p\d+$")
# Limits of the defects of balances: rounding of forces, tolerance of the solver of heat.
BALANCES: dict[str, float] = {"force": 1e-8, "moment": 1e-8, "energy": 1e-8, "heat": 1e-6}
# Strain of a living cortex [1e-6], from memory.
STRAINS = (500.0, 2500.0)
# Motion of the head under load [mm] (Chen 2020).
MOTION = 5.0


ResultVerdict = Callable[[Summary], Iterable[Verdict]]
# Functions of other packages that return verdicts.
_RESULT_VERDICTS: list[ResultVerdict] = []


def result_verdict(function: ResultVerdict) -> ResultVerdict:
    """Register a function that returns verdicts on the numbers of ``summary.json``."""
    _RESULT_VERDICTS.append(function)
    return function


def record_verdicts(summary: Summary, notes: Sequence[Verdict]) -> None:
    """Put all verdicts on a run into its summary: first on its numbers, then notes on its case."""
    verdicts = [*of_numbers(summary), *notes]
    summary["verdicts"] = [verdict.record() for verdict in verdicts]


def reasons_not_to_use(summary: Summary) -> list[str]:
    """Return the reasons not to use the numbers of a solved case; empty if they are sound."""
    return texts_of(recorded(summary), Severity.ERROR)


def notes_of(summary: Summary) -> list[str]:
    """Return the notes on the case of a run."""
    return texts_of(recorded(summary), Severity.NOTE)


def check_usable(summaries: Mapping[Path, Summary]) -> None:
    """Check that no result is unusable; summaries are given by run directory.

    Raises:
        UnusableError: Some results must not be used; the message has the reasons.
    """
    reasons = {folder: "; ".join(reasons_not_to_use(s)) for folder, s in summaries.items()}
    bad_numbers = [
        f"do not use the numbers in {folder}: {reason}"
        for folder, reason in reasons.items()
        if reason
    ]
    if bad_numbers:
        raise UnusableError(bad_numbers)


def of_numbers(summary: Summary) -> list[Verdict]:
    """Return the verdicts on the numbers of a solved case."""
    solver = summary["solver"]
    memory = summary.get("memory")
    counts = ", ".join(
        (
            several(solver["dofs"], "unknown"),
            several(solver["steps"], "step"),
            several(solver["newton_iterations"], "Newton iteration"),
        )
    )
    solved = f"{counts} in {summary['timing']['total']:.1f} s on {several(solver['ranks'], 'rank')}"
    if memory:
        solved += f", with {count(memory['peak'])} MB of memory"
    verdicts = [Verdict(solved, "converged", severity=Severity.PLAIN)]
    verdicts += _balances(summary)
    interfaces = summary["interfaces"]
    if interfaces:
        verdicts.append(_contact(interfaces))
    verdicts += [_by_facets(name, q) for name, q in interfaces.items() if "pressure_by_facets" in q]
    verdicts += [_steep(name, q) for name, q in interfaces.items() if _is_steep(q)]
    verdicts += [_crack(name, q) for name, q in interfaces.items() if "zone_length" in q]
    slipping = large_slip(summary)
    if slipping:
        message = f"larger than a facet on {' and '.join(slipping)}: small sliding does not hold"
        verdicts.append(Verdict(message, "slip", "use `sliding: finite`"))
    for of_package in _RESULT_VERDICTS:
        verdicts += of_package(summary)
    verdicts += _physiology(summary)
    verdicts.append(_mesh_and_step(summary))
    failed = ", ".join(summary.get("error", {}).get("failed", []))
    if failed:
        message = f"these coarser runs failed and are left out of the estimate: {failed}"
        verdicts.append(Verdict(message, "error", severity=Severity.WARNING))
    if "assumed_bone" in summary:
        message = summary["assumed_bone"]["sentence"]
        verdicts.append(Verdict(message, "assumed bone", severity=Severity.PLAIN))
    if "accuracy" in summary:
        verdicts.append(Verdict(summary["accuracy"], severity=Severity.PLAIN))
    return [*verdicts, *_peaks(summary)]


def unbalanced(summary: Summary) -> list[str]:
    """Return the balances with a defect above its limit; NaN counts as above."""
    b = summary.get("balance", {})
    return [name for name, limit in BALANCES.items() if name in b and not b[name] < limit]


def large_slip(summary: Summary) -> list[str]:
    """Return the interfaces on which bodies slip by more than the width of their facets."""
    return [
        name
        for name, q in summary.get("interfaces", {}).items()
        if summary_numbers.maximum_with_parts(q, "slip_max") > q.get("facet_size", np.inf)
    ]


def _balances(summary: Summary) -> Iterator[Verdict]:
    """Yield verdicts on the balances of forces and of heat."""
    balance = summary["balance"]
    defects = {name: f"{name} {balance[name]:.1e}" for name in BALANCES if name in balance}
    excess = {
        name: f"relative error of {defects[name]}; allowed {BALANCES[name]:g}"
        for name in unbalanced(summary)
    }
    heat = excess.pop("heat", "")
    if "force" in balance:
        if excess:
            yield Verdict(f"NOT satisfied: {'; '.join(excess.values())}", EQUILIBRIUM)
        else:
            defects_text = ", ".join(defect for name, defect in defects.items() if name != "heat")
            message = f"satisfied to rounding (relative errors: {defects_text})"
            yield Verdict(message, EQUILIBRIUM, severity=Severity.GOOD)
    if "heat" in balance:
        if heat:
            yield Verdict(f"NOT balanced: {heat}", HEAT)
        else:
            message = f"balanced (relative error {balance['heat']:.1e})"
            yield Verdict(message, HEAT, severity=Severity.GOOD)


def _physiology(summary: Summary) -> Iterator[Verdict]:
    """Yield verdicts on motion of the head and strain of the cortex outside measured ranges."""
    femur = summary.get("femur")
    loaded = summary.get("section_loads", [])
    if not femur or not any(any(section["force"]) for section in loaded):
        return
    head = float(np.linalg.norm(femur["head_displacement"]))
    strains = [1e6 * abs(v) for key, v in femur.items() if re.fullmatch(r"strain.*\d", key)]
    lowest_usual, highest_usual = STRAINS
    smallest = min(strains)
    largest = max(strains)
    clauses = []
    if head > MOTION:
        clauses.append(f"the head moves {head:.1f} mm (usually at most {MOTION:g} mm)")
    # A stem takes load from the cortex beside it: there the largest strain judges the loads.
    lowest = largest if summary.get("stem") else smallest
    if lowest < lowest_usual or largest > highest_usual:
        usual_range = f"(usually {lowest_usual:g} to {highest_usual:g} um/m)"
        clauses.append(
            f"the strain of the cortex is {smallest:.0f} to {largest:.0f} um/m {usual_range}"
        )
    if clauses:
        yield Verdict("; ".join(clauses), "physiology", severity=Severity.WARNING)


def _crack(name: str, q: Numbers) -> Verdict:
    """Return the verdict on damage; a warning if the mesh does not resolve the process zone."""
    table = TABLE["interfaces"]
    keys = ("area_damaged", "area_broken", "unbonded_fraction", "zone_length", "zone_elements")
    damaged, broken, never_bonded, zone, elements = (table[key].text(q) for key in keys)
    message = f"{name} is damaged on {damaged} mm^2, of which {broken} are broken"
    if q["unbonded_fraction"]:
        message += f"; {never_bonded} % was never bonded"
    if q["zone_length"]:
        message += f"; its process zone is {zone} mm long, {elements} elements"
    if 0 < q["zone_elements"] < RESOLVED:
        message += f"; at least {RESOLVED} elements are needed"
        return Verdict(in_print(message), "cohesion", "reduce mesh.size", Severity.WARNING)
    return Verdict(in_print(message), "cohesion", severity=Severity.GOOD)


def _contact(interfaces: Mapping[str, Numbers]) -> Verdict:
    """Return the verdict on penetration, and on parts that numbers of interfaces exclude.

    Sides with an elastic layer between them overlap by its compression, which is no fault.
    """

    def length(key: str, value: float) -> str:
        q = TABLE["interfaces"][key]
        return f"{two_digits(q.factor * value)} {q.shown}"

    layers = {
        name: q["compression_max"]
        for name, q in interfaces.items()
        if q.get("compression_max", 0.0) >= PENETRATION
    }
    exact = [q for q in interfaces.values() if "compression_max" not in q]
    largest = {
        key: max((q.get(key, 0.0) for q in exact), default=0.0)
        for key in ("penetration_max", "penetration_sampled")
    }
    gap = TABLE["interfaces"]["gap_max"].text
    rims = [f"{gap(q['rim'])} um ({name})" for name, q in interfaces.items() if "rim" in q]
    rim = ""
    if rims:
        rim = f". These numbers exclude rim and tip; the rim opens by {', '.join(rims)}"
    layer_text = "".join(
        f"; the elastic layer of {name} is compressed by up to {length('compression_max', depth)}"
        for name, depth in layers.items()
    )
    if largest["penetration_max"] >= PENETRATION:
        overlap_length = length("penetration_max", largest["penetration_max"])
        message = f"bodies overlap by {overlap_length} at nodes{layer_text}{rim}"
        return Verdict(message, CONTACT, severity=Severity.WARNING)
    overlap_text = ""
    if largest["penetration_sampled"] >= PENETRATION:
        overlap_length = length("penetration_sampled", largest["penetration_sampled"])
        overlap_text = f"; between nodes bodies overlap by up to {overlap_length}"
    message = f"satisfied to rounding at nodes{overlap_text}{layer_text}{rim}"
    return Verdict(message, CONTACT, severity=Severity.GOOD)


def _by_facets(name: str, q: Numbers) -> Verdict:
    """Return the verdict on a largest pressure that depends on the facets."""
    largest = TABLE["interfaces"]["pressure_max"].text(q)
    facet_pressure = TABLE["interfaces"]["pressure_by_facets"].text(q)
    part = f"up to {facet_pressure} MPa"
    if q["pressure_by_facets"] >= q["pressure_max"]:
        part = "all of it"
    message = (
        f"the maximum on {name}, {largest} MPa, depends on the facets of the mesh: slip over their "
        f"edges may cause {part}"
    )
    remedy = "reduce `mesh.size`, or use curved cells (`mesh.order: 2`) if they are straight"
    return Verdict(message, "pressure", remedy, Severity.WARNING)


def _is_steep(q: Numbers) -> bool:
    largest = q.get("pressure_max", 0.0)
    return bool(largest >= SHOWN and largest > STEEP * q.get("pressure_mean_max", np.inf))


def _steep(name: str, q: Numbers) -> Verdict:
    """Return the verdict on a largest pressure that is far above the mean at its point."""
    largest, mean = (
        TABLE["interfaces"][key].text(q) for key in ("pressure_max", "pressure_mean_max")
    )
    message = (
        f"the maximum on {name}, {largest} MPa, is at a ridge or an edge; averaged over the area "
        f"of a node on one face the pressure is at most {mean} MPa"
    )
    return Verdict(message, "pressure", severity=Severity.WARNING)


class PercentileErrors(NamedTuple):
    """Errors of the percentiles of interfaces and regions.

    Attributes:
        relative: Error over size, by number in words.
        unresolved: Numbers with an error that exceeds them.
        zeros: Numbers close to zero.
    """

    relative: dict[str, float]
    unresolved: list[str]
    zeros: list[str]


def _percentile_errors(summary: Summary) -> PercentileErrors:
    """Return the estimated errors of the percentiles."""
    largest = largest_of_units(summary)
    errors = PercentileErrors({}, [], [])
    owners = {"interfaces": summary.get("interfaces", {}), "regions": summary.get("regions", {})}
    for section, numbers_by_owner in owners.items():
        for name, q in numbers_by_owner.items():
            for key in filter(PERCENTILE.search, q):
                error = q.get(f"{key}_error")
                if error is None or not q[key] or key not in TABLE[section]:
                    continue
                words = quantities.label_and_unit(f"{name}.{key}")[0]
                if is_zero(q[key], error, largest[TABLE[section][key].unit]):
                    errors.zeros.append(words)
                elif error > abs(q[key]):
                    errors.unresolved.append(words)
                else:
                    errors.relative[words] = error / abs(q[key])
    return errors


def _mesh_and_step(summary: Summary) -> Verdict:
    """Return the verdict on the estimated errors of mesh and step."""
    estimated = summary.get("error", {})
    if not estimated.get("companions"):
        message = "errors are not estimated; run with --error"
        return Verdict(message, BOTH, severity=Severity.PLAIN)
    errors = _percentile_errors(summary)
    by_error = sorted(errors.relative, key=errors.relative.__getitem__)
    message = "± is the estimated error"
    if by_error:
        median_and_worst = (by_error[len(by_error) // 2], by_error[-1])
        median_error, largest_error = (
            f"{float(f'{100 * errors.relative[key]:.2g}'):g}" for key in median_and_worst
        )
        message = f"half of the percentiles have errors below ± {median_error} %"
        message += f"; the largest error is ± {largest_error} % ({by_error[-1]})"
        share_within_error = estimated.get("share_within_error")
        if share_within_error:
            message += (
                f". For about {100 * share_within_error:.0f} % of such numbers the true error is"
                " smaller than ±"
            )
    if errors.unresolved:
        message += f". Not resolved, because ± exceeds them: {'; '.join(errors.unresolved)}"
    if errors.zeros:
        message += f". Not counted, because close to zero: {'; '.join(errors.zeros)}"
    source = estimated.get("sources", BOTH)
    if source != BOTH:
        message += "; the error of the mesh is not estimated"
    return Verdict(message, source, severity=Severity.PLAIN)


def _peaks(summary: Summary) -> list[Verdict]:
    """Return verdicts on maxima that change with the mesh, with their values on all meshes."""
    lines = []
    for name, ((finest, value), *coarser) in summary.get("error", {}).get("unsettled", {}).items():
        q = quantities.quantity_of(name)
        if q and q.unit != "-":  # a risk stands with the strength
            number_title = quantities.label_and_unit(name)[0].removesuffix(" max").removesuffix(",")
            finest_values = [f"{number_title} {q.text({q.key: value})} {q.shown} at {finest:g} mm"]
            lines.append(
                ", ".join(
                    finest_values + [f"{q.text({q.key: v})} at {size:g}" for size, v in coarser]
                )
            )
    if not lines:
        return []
    shown_lines = lines[:MOST_MAXIMA]
    if lines[MOST_MAXIMA:]:
        shown_lines.append(f"{len(lines) - MOST_MAXIMA} more: `error.unsettled` in summary.json")
    return [Verdict("; ".join(shown_lines), PEAKS, severity=Severity.WARNING)]
