"""Faults, notes and verdicts about the strength and the fatigue of a case."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from app.case import quantities
from app.case.case import Case
from app.case.checks import check
from app.case.summary import Numbers, Summary, added_section
from app.fatigue.laws import fatigue_of, level_of, stem_test_of
from app.foundation.layout import two_digits
from app.foundation.verdict import Severity, Verdict, note
from app.results.verdicts import result_verdict
from app.schema.section import did_you_mean
from app.schema.yaml_file import Fault
from app.soundness.preview import PEAK, from_memory, input_note
from app.soundness.result_notes import result_note


@check("fatigue", "stages")
def _stages(case: Case) -> Iterable[Fault]:
    """Activities that are no stages."""
    fatigue = fatigue_of(case)
    assert fatigue
    stage_names = [stage.name for stage in case.stages]
    for name in fatigue.spectrum:
        if name not in stage_names:
            message = (
                f"'{name}' is not one of {', '.join(stage_names)}{did_you_mean(name, stage_names)}"
            )
            yield Fault(("fatigue", "spectrum", name), message)


@check("fatigue", "stages", "loads")
def _cycle_tables(case: Case) -> Iterable[Fault]:
    """Activities whose loads follow a cycle table that does not end at the peak."""
    fatigue = fatigue_of(case)
    assert fatigue
    untimed = [stage.name for stage in case.stages if not stage.takes_time]
    if not untimed or untimed[-1] not in fatigue.spectrum:  # tables act in the last of them
        return
    for name, load in case.loads.items():
        forces = load.force_magnitudes if load else ()
        if forces and forces[-1] < PEAK * max(forces):
            message = (
                f"loads.{name} ends its cycle table at {100 * forces[-1] / max(forces):.0f} % of"
                " the largest force, and the damage is that of the end; expected a table that"
                " begins and ends at the peak"
            )
            yield Fault(("fatigue", "spectrum", untimed[-1]), message)


@check("fatigue", "regions")
def _region(case: Case) -> Iterable[Fault]:
    """Fatigue of a region that does not deform."""
    fatigue = fatigue_of(case)
    assert fatigue
    regions = case.regions
    elastic = [name for name, region in regions.items() if region and region.deforms]
    if not elastic:
        return
    name = fatigue.region
    invalid = name in regions and regions[name] is None
    if name not in elastic and not invalid:
        message = f"'{name}' is not one of the elastic regions {', '.join(elastic)}"
        yield Fault(("fatigue", "region"), message + did_you_mean(name, elastic))


@check("stem_test", "regions", "geometry")
def _stem_test(case: Case) -> Iterable[Fault]:
    """Test of a region that does not deform, or without the level of the resin."""
    test = stem_test_of(case)
    assert test
    elastic = [name for name, region in case.regions.items() if region and region.deforms]
    if test.region not in elastic:
        message = f"'{test.region}' is not one of the elastic regions {', '.join(elastic)}"
        yield Fault(("stem_test", "region"), message + did_you_mean(test.region, elastic))
    if level_of(case) is None:
        yield Fault(("stem_test",), "'level' is missing; this geometry has no neck cut")


@check("stem_test", "loads")
def _head(case: Case) -> Iterable[Fault]:
    """Test without a load on the boundary of the head."""
    test = stem_test_of(case)
    assert test
    loads = [load for load in case.loads.values() if load]
    loaded_boundaries = {boundary for load in loads for boundary in load.boundaries}
    if test.head not in loaded_boundaries:
        listed_boundaries = ", ".join(sorted(loaded_boundaries)) or "none"
        message = f"no load acts on '{test.head}'; boundaries with loads: {listed_boundaries}"
        yield Fault(("stem_test", "head"), message)


@input_note
def _from_memory(case: Case) -> Iterable[Verdict]:
    """S-N laws from memory."""
    fatigue = fatigue_of(case)
    for name, law in fatigue.laws.items() if fatigue else ():
        yield from from_memory(f"fatigue.laws.{name}", law.source)
    test = stem_test_of(case)
    if test:
        yield from from_memory("stem_test.law", test.law.source)


@result_note
def _beyond_measured(case: Case, numbers: Summary) -> Iterable[Verdict]:
    """S-N laws beyond the stresses in which they were measured."""
    fatigue = fatigue_of(case)
    for name, law in fatigue.laws.items() if fatigue else ():
        if law.measured is None:
            continue
        stress = added_section(numbers, "fatigue")[name]["stress_p99"]
        lowest, highest = law.measured
        if not lowest <= stress <= highest:
            message = (
                f"was measured at {lowest:g} to {highest:g} MPa, and is used at"
                f" {two_digits(stress)} MPa (p99)"
            )
            yield note(message, f"fatigue.laws.{name}")


@result_verdict
def _life_and_strength(summary: Summary) -> Iterable[Verdict]:
    """Life of the region that tires, and the probability that each region breaks."""
    laws = added_section(summary, "fatigue")
    if laws:
        yield Verdict(life(laws), "fatigue", severity=Severity.WARNING)
    for name, numbers in added_section(summary, "stem_test").items():
        yield Verdict(_endurance(name, numbers), "bench test", severity=Severity.WARNING)
    unsettled = summary.get("error", {}).get("unsettled", {})
    for name, numbers in summary.get("regions", {}).items():
        if "failure_risk" in numbers:
            yield _strength(name, numbers, unsettled)


# Cycles beyond which a life is not given as a number: no test of the laws was longer.
LONGEST_LIFE = 1e9


def _endurance(stem: str, numbers: Numbers) -> str:
    """Stress and life of a stem in its bench test."""
    lives = [
        f"{cycles:.1e}" if cycles < LONGEST_LIFE else f"more than {LONGEST_LIFE:.0e}"
        for cycles in (numbers["life_median"], numbers["life_p05"])
    ]
    failing = numbers["failing"]
    part = f"{two_digits(100 * failing)} %" if failing >= 1e-4 else "less than 0.01 %"
    return (
        f"{stem}: {numbers['level_stress']:.0f} MPa at the level of the resin, "
        f"{numbers['free_tension_p99']:.0f} MPa above it (p99). Cycles to failure: {lives[0]} in "
        f"the median, {lives[1]} for the weakest 5 %; {part} of the stems fail within the test. "
        "For comparison, not for prediction"
    )


def life(laws: Mapping[str, Numbers]) -> str:
    """Band of the life of a region, over laws and errors; no year without it."""
    damages_and_errors = [
        (q["damage_p99"], q.get("damage_p99_error") or 0.0) for q in laws.values()
    ]
    largest_damage = max(damage + damage_error for damage, damage_error in damages_and_errors)
    smallest_damage = min(damage - damage_error for damage, damage_error in damages_and_errors)
    has_mesh_error = any("damage_p99_error" in q for q in laws.values())
    causes = f"over {', '.join(laws)}"
    if has_mesh_error:
        causes += " and mesh"
    if len(damages_and_errors) < 2 and not has_mesh_error:
        remedy = "add another law, or run with --error"
        return f"the life is not shown without an uncertainty ({causes}): {remedy}"
    shortest_life, longest_life = (
        two_digits(1 / damage) if damage > 0 else "" for damage in (largest_damage, smallest_damage)
    )
    if not shortest_life:
        years = "without end"
    elif not longest_life:
        years = f"at least {shortest_life} years; an upper limit is not resolved"
    else:
        years = f"{shortest_life} to {longest_life} years"
    life = f"99 % of the volume lasts {years}, {causes}"
    return f"{life}: for comparison, not for prediction"


def _strength(name: str, q: Numbers, unsettled: Mapping[str, list[list[float]]]) -> Verdict:
    """Probability that a region and its parts fail, and where it grows with every mesh."""
    probabilities = []
    severity = Severity.PLAIN
    for part in ("", *(p for p in quantities.PARTS if "failure_risk" in q.get(p, {}))):
        numbers = q[part] if part else q
        key = f"{name}_{part}" if part else name
        probability = f"{two_digits(100 * numbers['failure_probability'])} %"
        if part:
            probability += f" at its {part}"
        (_, fine), (size, coarse), *_ = unsettled.get(f"{key}.failure_risk", ((0, 0), (0, 0)))
        if fine > coarse:
            grown = f"from {two_digits(coarse)} at {size:g} mm to {two_digits(fine)}"
            probability = f"{probability} (failure_risk grows {grown} and may not converge)"
            severity = Severity.WARNING
        probabilities.append(probability)
    message = f"{name} fails with a probability of {', '.join(probabilities)}"
    return Verdict(message, "strength", severity=severity)
