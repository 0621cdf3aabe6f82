"""Faults of press fits, and verdicts on their micromotion and on the strain of the bone.

Sources of the verdict on ingrowth: Jasty et al., J Bone Joint Surg 79-A (1997) 707 (dogs, 0 to
150 um; read: abstract); Kohli, Stoddart and van Arkel, Sci Rep 11 (2021) 10797 (review of measured
micromotions; read: abstract).
"""

from __future__ import annotations

from collections.abc import Iterable

from app.case.case import Case
from app.case.checks import check
from app.case.hips import ON_CUT
from app.case.number_text import in_print
from app.case.quantities import TABLE
from app.case.summary import Numbers, Summary
from app.foundation.verdict import Severity, Verdict, note
from app.laws.interface_laws import insertion_stages, most_interference
from app.laws.values import MUCH_INTERFERENCE
from app.results.closing_lines import CEMENT_NUMBER
from app.results.verdicts import result_verdict
from app.schema.yaml_file import Fault
from app.soundness.preview import input_note

# Strain at which bone yields [-], from memory: check.
YIELD = 0.007
# Strains of bone after the insertion that are compared with it, and the verb of the sentence.
STRAINS = {"insertion_hoop_strain_p99": "strains", "insertion_compressive_strain_p99": "compresses"}
# Rise of a stem by the insertion, and mean gap of its collar, above which a warning is given [mm].
RAISED = 0.003
# Part of the collar's area above which it does not rest on the bone.
MOSTLY_OPEN = 0.5
# Open part of the area of a stem above which it is stated with the areas of micromotion.
NOTED_OPEN = 0.05


@check("geometry", "interfaces", "stages", "loads", "supports")
def _stages(case: Case) -> Iterable[Fault]:
    """Press fits without a stage after the insertion, or with loads that act during it."""
    laws = {name: law for name, law in case.interfaces.items() if law is not None}
    loads = {name: load for name, load in case.loads.items() if load is not None}
    insertion = insertion_stages(laws, case.geometry.press_fits)
    histories: dict[tuple[str, str], tuple[float, ...] | None] = {
        ("loads", name): load.history for name, load in loads.items() if load.cycle is None
    }
    in_insertion = {stage.name for stage in case.stages[:insertion]}
    for name, support in case.supports.items():
        if support is None or support.is_spring or not support.moves:
            continue
        moves_at_all = support.history is None or any(support.history)
        if moves_at_all and (support.stages is None or in_insertion.intersection(support.stages)):
            histories["supports", name] = support.history
    is_cyclic = any(load.cycle is not None for load in loads.values())
    if not insertion or not (histories or is_cyclic):
        return
    stages = [stage.name for stage in case.stages]
    last = max((k for k, stage in enumerate(case.stages) if not stage.takes_time), default=0)
    if insertion > (last if is_cyclic else len(stages) - 1):
        example = "`stages: [{name: insertion}, {name: load, increments: 2}]`"
        example += ", and `loads: {history: [0, 1]}`"
        if is_cyclic:
            example = "`stages: [{name: insertion}, {name: rise}, {name: gait, increments: 20}]`"
        message = (
            "the interference grows until the end of the last stage; micromotion is the motion"
            f" after it. Expected a further stage, e.g. {example}"
        )
        yield Fault(("stages",), message)
        return
    for section, act in (("loads", "loads act"), ("supports", "supports move bodies")):
        acting = {
            name: history
            for (of_section, name), history in histories.items()
            if of_section == section and (history is None or any(history[:insertion]))
        }
        if acting:
            multipliers = [0] * insertion + [1] * (len(stages) - insertion)
            given = [name for name, history in acting.items() if history is not None]
            end = stages[insertion - 1]
            example = f"`history: {multipliers}`"
            if section == "loads" and not given:
                example = f"`loads: {{history: {multipliers}}}`"
            message = (
                f"micromotion counts from the end of the insertion, but {act} during it:"
                f" {', '.join(acting)}. Expected `history` with one number for each stage, 0 up to"
                f" the end of '{end}', e.g. {example}"
            )
            if given:
                message += (
                    f"; if '{end}' is no part of the insertion, put `{{name: insertion}}` before"
                    " all stages, and 0 before the numbers of each `history`"
                )
            yield Fault((section, given[0], "history") if given else (section,), message)


def _areas(name: str, motion: str, q: Numbers) -> str:
    """Shares of the area of an owner of numbers with little and much motion, and open ones."""
    below_40um, above_150um = (
        100 * q[f"area_{motion}_over_{level}um"] / q["area"] for level in (40, 150)
    )
    text = (
        f"{100 - below_40um:.0f} % of {name} moves less than 40 um, {above_150um:.0f} % more than"
        " 150 um"
    )
    open_fraction = q.get("open_fraction", 0.0)
    if open_fraction > NOTED_OPEN:
        text += (
            f", and {100 * open_fraction:.0f} % does not touch the bone (gap"
            f" {1e3 * q['gap_p99']:.0f} um, p99)"
        )
    return text


@input_note
def _interference(case: Case) -> Iterable[Verdict]:
    """Notes on interferences of bone that are far above the range in which it is elastic."""
    bones = {*case.of_tissue("bone")}
    for name, law in case.interfaces.items():
        first, second = case.geometry.interface_sides[name]
        if not bones.intersection((*first, *second)):
            continue
        for path, surface in law.gaps.items():
            key, most = most_interference(surface)
            if most > MUCH_INTERFERENCE:
                pressed = "presses bone by" if key == "interference" else "is an interference of"
                message = f"{pressed} {most:g} mm; bone is elastic here and is not crushed"
                usual = "0.01 to 0.02 mm" if key == "interference" else "-0.01 to -0.02 mm"
                place = ".".join(("interfaces", name, *path, key))
                yield note(message, place, f"usual: {usual}, along the normal")


@result_verdict
def _beyond_yield(summary: Summary) -> Iterable[Verdict]:
    """Bone strained by the insertion beyond what it bears."""
    interfaces = summary.get("interfaces", {})
    pressures = {n: q.get("insertion_pressure_p95", 0.0) for n, q in interfaces.items()}
    of_largest = max(pressures, key=pressures.__getitem__, default="the stem")
    for name, key in _yielding(summary):
        strain = TABLE["regions"][key].text(summary["regions"][name])
        message = (
            f"the insertion {STRAINS[key]} {name} by {strain} um/m beside the stem (p99); bone"
            f" yields near {1e6 * YIELD:.0f} um/m. Bone is elastic in this model; real bone would"
            " keep less of the interference"
        )
        advice = f"reduce the interference of {of_largest}"
        yield Verdict(message, "insertion", advice, Severity.WARNING)


def _yielding(summary: Summary) -> list[tuple[str, str]]:
    """Regions of bone that the insertion strains beyond yield, with the keys of their strains."""
    regions = summary.get("regions", {})
    return [(n, key) for n, q in regions.items() for key in STRAINS if q.get(key, 0.0) > YIELD]


def _may_grow_in(summary: Summary, interface: str) -> bool:
    """Return False for an interface with cement, or without one of the bones that are known."""

    def touches(region: str) -> bool:
        return interface.startswith(f"{region}_") or interface.endswith(f"_{region}")

    regions = summary.get("regions", {})
    if any(CEMENT_NUMBER in q and touches(name) for name, q in regions.items()):
        return False
    bones = {name for name, q in regions.items() if "insertion_hoop_strain_p99" in q}
    return not bones or any(touches(name) for name in (*bones, "bone"))


@result_verdict
def _ingrowth(summary: Summary) -> Iterable[Verdict]:
    """Areas of motion, compared with published limits of ingrowth, which are of oscillation.

    The motion is the inducible one of the last cycle of a stage. Of several stages with cycles it
    is the one with the largest area above 40 um. Without cycles it is that of one load.
    """
    for name, q in summary.get("interfaces", {}).items():
        has_grown_in = "damage_mean" in q
        has_micromotion = bool(q.get("area")) and "area_micromotion_over_40um" in q
        if name == ON_CUT or has_grown_in or not has_micromotion or not _may_grow_in(summary, name):
            continue
        motion = "micromotion"
        motion_text = (
            "This motion began at the end of the insertion, so it has a permanent part. To see the"
            " inducible part alone, give the last stage `cycles` and the loads a `history`, no"
            " cycle table."
        )
        zones = {f"zone {zone}": part for zone, part in q.get("zones", {}).items()}
        of_stages = {
            stage: numbers["areas"][name]
            for stage, numbers in summary.get("cycles", {}).items()
            if name in numbers.get("areas", {})
        }
        has_inducible = "area_inducible_over_40um" in q
        if of_stages:
            motion = "inducible"
            worst = max(of_stages, key=lambda stage: of_stages[stage]["area_inducible_over_40um"])
            last = next(reversed(of_stages))
            motion_text = (
                "The motion is inducible, from the last valley to the last peak of stage"
                f" '{worst}'."
            )
            if len(of_stages) > 1:
                motion_text = motion_text.removesuffix(".") + (
                    ", which has the largest area above 40 um of"
                    f" {len(of_stages)} stages with cycles."
                )
            if not (has_inducible and worst == last):
                q = {**q, **of_stages[worst]}
                zones = {}
        elif has_inducible:
            motion = "inducible"
            motion_text = "The motion is inducible, from the last valley to the last peak."
        edges = {part: q[part] for part in ("rim", "tip") if part in q}
        all_but = f"{name} without its {' and '.join(edges)}" if edges else name
        counted = f"area_{motion}_over_40um"
        owners = {all_but: q, **{f"its {part}": n for part, n in edges.items() if counted in n}}
        shares = (_areas(owner, motion, part) for owner, part in (owners | zones).items())
        doubt = " This holds for elastic bone, but the insertion strains bone beyond its yield."
        message = (
            f"{'; '.join(shares)}. {motion_text}"
            f"{doubt if _yielding(summary) else ''} In dogs bone"
            " grew in at oscillations of 20 um,"
            " partly at 40 um, not at 150 um (Jasty 1997)."
            " There is no universal limit: implants integrated at 112 ± 176 um, others did not at"
            " 349 ± 231 um (Kohli 2021)"
        )
        yield Verdict(in_print(message), "ingrowth", severity=Severity.PLAIN)


@result_verdict
def _raised_collar(summary: Summary) -> Iterable[Verdict]:
    """Collars that the insertion lifts off the bone."""
    collar = summary.get("interfaces", {}).get(ON_CUT, {})
    rise = -summary.get("stem", {}).get("insertion_subsidence", 0.0)
    gap, open_fraction = (
        collar.get(f"insertion_{key}", 0.0) for key in ("gap_mean", "open_fraction")
    )
    is_lifted = min(rise, gap) > RAISED and open_fraction > MOSTLY_OPEN
    has_clearance = gap > rise + RAISED
    if is_lifted and not has_clearance:
        largest_gap = collar["insertion_gap_p95"]
        message = (
            f"the insertion raises the stem by {1e3 * rise:.1f} um, since it grows in its bed;"
            f" {100 * open_fraction:.0f} % of its collar is off the bone, by {1e3 * gap:.1f} um in"
            f" the mean and {1e3 * largest_gap:.1f} um (p95). A collar that is seated last carries"
            " more"
        )
        advice = (
            f"to bring it closer, change the `gap` of interfaces.{ON_CUT} by {-largest_gap:.3f} mm"
            " (it is 0 mm if not given)"
        )
        yield Verdict(message, "insertion", advice, Severity.WARNING)
