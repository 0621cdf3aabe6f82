"""The lead of a page: its loads in a sentence, and up to three large numbers with captions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import chain, zip_longest

from app.case.number_text import in_print, printed
from app.case.quantities import NECROSIS, TABLE, label_and_unit
from app.case.summary import TEMPERATURE_LEVELS, Numbers, Summary, name_of_implant
from app.report.page import LargeNumber, spelled_out
from app.report.sweep_results import SweptCase, magnitude, named

# Words on the motion at an interface: body that moves, other body, preposition.
PAIRS = {
    "stem_cement": ("the stem", "its cement", "in"),
    "cement_bone": ("the cement", "the bone", "on"),
    "stem_bone": ("the stem", "the bone", "in"),
    "collar_bone": ("the collar", "the bone", "on"),
}
# Slip, gaps and subsidence below this count as zero [um].
SMALLEST_MOTION = 0.05
# Temperatures below this are printed as zero in a range [degC].
SMALLEST_TEMPERATURE = 0.05
# Numbers whose ranges over runs are shown, with the values below which they count as zero.
ZERO_IN_RANGES = {
    "slip_p99": SMALLEST_MOTION,
    "gap_p99": SMALLEST_MOTION,
    "temperature_max": SMALLEST_TEMPERATURE,
}
# Open fraction of the area above which the sides do not touch [-].
APART_FRACTION = 0.995
# Areas below this are not mentioned [mm2].
SMALLEST_AREA = 0.5
# Volume of dead bone below which no bone counts as dead [mm3].
SMALLEST_DEAD_VOLUME = 0.5
# Largest number of large numbers of a page.
MOST_LARGE_NUMBERS = 3
# Words on the force by the sector of the body that is modelled.
SECTORS = {"half": " on the half that is modelled", "quarter": " on the quarter that is modelled"}


def large_numbers(summary: Summary) -> list[LargeNumber]:
    """Return the most important numbers of ``summary.json``, at most `MOST_LARGE_NUMBERS`.

    The first numbers of the groups contact, stem, heat and cure are chosen first, then their second
    numbers, and so on. A case without these groups has the stress of its regions.
    """
    numbers_by_group = [
        list(_contacts(summary)),
        list(_stem(summary)),
        list(_heat(summary)),
        list(_cure(summary)),
    ]
    by_rank = [n for n in chain.from_iterable(zip_longest(*numbers_by_group)) if n is not None]
    chosen_numbers = by_rank[:MOST_LARGE_NUMBERS]
    numbers = [n for n in chain.from_iterable(numbers_by_group) if n in chosen_numbers]
    return numbers or list(_stresses(summary))[:MOST_LARGE_NUMBERS]


def loads(case: SweptCase, summary: Summary) -> str:
    """Return the largest force of a case and the sum of all forces, in sentences.

    The result is empty in three cases: the run ended before its last load, the case has neither
    interfaces nor a stem, or no load has a single size.
    """
    ended = summary["status"] not in ("stopped", "not converged")
    if not ended or not (summary["interfaces"] or summary.get("stem")):
        return ""
    forces: dict[str, list[float]] = {}
    all_loads = case.data.get("loads", {})
    for name, load in all_loads.items():
        if load.get("cycle_table"):
            continue  # its size changes over the cycle
        magnitudes = map(magnitude, load.get("force") or ())
        components = [component for component in magnitudes if component is not None]
        last_factor = (load.get("history") or [1.0])[-1]
        if len(components) == 3 and isinstance(last_factor, int | float):
            forces[name] = [last_factor * component for component in components]
    if not forces:
        return ""
    largest = max(forces, key=lambda name: math.hypot(*forces[name]))
    sector = SECTORS.get(case.data.get("geometry", {}).get("sector", ""), "")
    title = "Load" if len(all_loads) == 1 else f"Largest load ({largest.replace('_', ' ')})"
    if largest == "hip":
        title = "Hip force"
    sentences = f"{title}: {math.hypot(*forces[largest]):,.0f} N{sector}."
    if 1 < len(all_loads) == len(forces):
        total = math.hypot(*map(sum, zip(*forces.values(), strict=True)))
        sentences += f" Sum of all {len(all_loads)} loads: {total:,.0f} N."
    return sentences


def _number(
    section: str, key: str, numbers: Numbers, caption: str, detail: str = ""
) -> LargeNumber:
    """Return a number of a section as a large number."""
    number_text = _with_unit(section, key, numbers)
    value, error_sign, error = number_text.partition(" ± ")
    unit = printed(TABLE[section][key].shown)
    if not error_sign:
        value = value.removesuffix(f" {unit}")
    return LargeNumber(value, unit, caption, f"± {error}" if error_sign else "", detail)


def _with_unit(section: str, key: str, numbers: Numbers) -> str:
    """Return a number as text with its unit: ``8.2 ± 9.5 µm (not resolved)``."""
    q = TABLE[section][key]
    return q.with_unit(numbers, printed(q.shown))


def _contacts(summary: Summary) -> Iterator[LargeNumber]:
    """Slip and opening of the interfaces, and the main numbers of added sections."""
    for name, q in summary["interfaces"].items():
        yield from _captioned(name.replace("_", " "), q)
        if "slip_p99" not in q:
            continue
        moving_body, other_body, preposition = PAIRS.get(name, ("the sides", named(name), "of"))
        surface = "surface without rim and tip" if "rim" in q else "surface"
        if "micromotion_p99" in q:
            detail = f"99 % of the {surface} moves less"
            is_pressed = "insertion_pressure_max" in q
            detail += ", counted from the end of the insertion." if is_pressed else "."
            area = q.get("area_micromotion_over_40um", 0.0)
            if area > SMALLEST_AREA:
                detail += f" Motion above 40 µm: {area:,.0f} of {q['area']:,.0f} mm²."
            caption = f"micromotion of {moving_body} {preposition} {other_body}"
            yield _number("interfaces", "micromotion_p99", q, caption, detail)
            continue
        if q.get("open_fraction", 0.0) > APART_FRACTION:
            caption = f"gap between {moving_body} and {other_body}"
            if name not in PAIRS:
                caption = f"gap of {named(name)}"
            detail = (
                f"The gap is smaller than this on 99 % of the {surface}. The sides touch nowhere."
            )
            yield _number("interfaces", "gap_p99", q, caption, detail)
            continue
        detail = f"99 % of the {surface} slips less."
        area = q.get("area_gap_over_30um", 0.0)
        if area > SMALLEST_AREA:
            detail += f" Open by more than 30 µm: {area:,.0f} of {q['area']:,.0f} mm²."
        elif 1e3 * q.get("gap_p99", 0.0) > SMALLEST_MOTION:
            gap = _with_unit("interfaces", "gap_p99", q)
            detail += f" 99 % is open by less than {gap}."
        else:
            detail += " It stays closed."
        caption = f"slip of {moving_body} {preposition} {other_body}"
        if 1e3 * q["slip_p99"] > SMALLEST_MOTION:
            yield _number("interfaces", "slip_p99", q, caption, detail)
        else:
            yield LargeNumber("0", printed(TABLE["interfaces"]["slip_p99"].shown), caption)


def _captioned(name: str, numbers: Numbers) -> Iterator[LargeNumber]:
    """Return the numbers of an interface that have a caption (`Quantity.caption`)."""
    quantities = TABLE["interfaces"]
    for key, quantity in quantities.items():
        if not quantity.caption or key not in numbers:
            continue
        detail = quantity.detail
        if detail:
            scalars = [k for k, q in quantities.items() if not q.vector]
            detail = detail.format(**{k: _with_unit("interfaces", k, numbers) for k in scalars})
        caption = quantity.caption.format(name=name)
        yield _number("interfaces", key, numbers, caption, detail)


def _stem(summary: Summary) -> Iterator[LargeNumber]:
    """Subsidence of the stem."""
    stem = summary.get("stem", {})
    if abs(1e3 * stem.get("subsidence", 0.0)) > SMALLEST_MOTION:
        name = name_of_implant(summary)
        detail = f"Motion of the {name} against the bone along the shaft."
        if "insertion_subsidence" in stem:
            before = _with_unit("stem", "insertion_subsidence", stem)
            detail += f" Since the insertion, which gave {before}."
        yield _number("stem", "subsidence", stem, f"subsidence of the {name}", detail)


def _heat(summary: Summary) -> Iterator[LargeNumber]:
    """Peak temperature of the bone with its duration, and the volume of dead bone."""
    regions = summary.get("thermal", {}).get("regions", {})
    bone = [q for q in regions.values() if "necrosis_47C_1min_volume" in q]  # heat can kill it
    if not regions:
        return
    if not bone:
        name, q = max(regions.items(), key=lambda item: item[1]["temperature_max"])
        caption = f"highest temperature of {named(name)}"
        yield _number("thermal.regions", "temperature_max", q, caption)
        return
    hottest = max(bone, key=lambda q: q["temperature_max"])
    durations = []
    for level in TEMPERATURE_LEVELS:
        seconds = max(q[f"seconds_over_{level}"] for q in bone)
        if seconds > 0:
            durations.append(f"{seconds:,.0f} s above {level} °C")
    detail = f"For up to {', '.join(durations)}." if durations else "Never above 47 °C."
    caption = "highest temperature of the bone"
    yield _number("thermal.regions", "temperature_max", hottest, caption, detail)
    volume_by_criterion = {}
    for criterion in NECROSIS:
        volume_by_criterion[criterion] = sum(
            q.get(f"necrosis_{criterion}_volume") or 0.0 for q in bone
        )
    rule = "47C_1min"
    other_volumes = [
        volume for criterion, volume in volume_by_criterion.items() if criterion != rule
    ]
    detail = f"By the rule of {in_print(NECROSIS[rule])}. By other rules "
    detail += f"{min(other_volumes):,.0f} to {max(other_volumes):,.0f} mm³."
    if max(volume_by_criterion.values()) < SMALLEST_DEAD_VOLUME:
        detail = "No bone dies by any rule."
    yield LargeNumber(f"{volume_by_criterion[rule]:,.0f}", "mm³", "dead bone", detail=detail)


def _cure(summary: Summary) -> Iterator[LargeNumber]:
    """Least degree of cure."""
    for name, q in summary.get("cure", {}).items():
        # Rounded down: incomplete cure never reads as 100 %.
        degree = math.floor(1e3 * q["degree_min"]) / 10
        caption = f"least degree of cure of {named(name)}"
        yield LargeNumber(f"{degree:g}", "%", caption, detail="Everywhere at least this much.")


def _stresses(summary: Summary) -> Iterator[LargeNumber]:
    """Stress of the regions, for cases without contact and heat."""
    for name, q in summary.get("regions", {}).items():
        caption = f"von Mises stress of {named(name)}"
        detail = "99 % of the volume is below this."
        yield _number("regions", "von_mises_p99", q, caption, detail)


# Many runs


def ranges_over_runs(cases: Sequence[SweptCase], names: Sequence[str]) -> list[LargeNumber]:
    """Return the ranges of slip, gap and temperature over several runs.

    There are at most `MOST_LARGE_NUMBERS`.
    """
    numbers = []
    for name, extremes in ranges(cases, names):
        title, unit = label_and_unit(name)
        smallest = _zero_in_range(name)
        lowest, highest = (
            f"{value if abs(value) > smallest else 0.0:.3g}" for value, _ in extremes
        )
        if lowest == highest:
            continue
        least_case, most_case = (c.name.replace("_", " ") for _, c in extremes)
        detail = f"Least: {least_case}. Most: {most_case}."
        numbers.append(
            LargeNumber(f"{lowest} to {highest}", unit, spelled_out(title), detail=detail)
        )
    return numbers[:MOST_LARGE_NUMBERS]


def _zero_in_range(name: str) -> float:
    """Value below which a number counts as zero in its range, in the printed unit."""
    return ZERO_IN_RANGES[name.rpartition(".")[2]]


def ranges(
    cases: Sequence[SweptCase], names: Sequence[str]
) -> Iterator[tuple[str, list[tuple[float, SweptCase]]]]:
    """Yield each slip, gap and temperature that varies, with its least and largest value.

    Each value comes with its case, in the printed unit.
    """
    for name in names:
        if name.rpartition(".")[2] not in ZERO_IN_RANGES:
            continue
        values = []
        for k, case in enumerate(cases):
            number = case.number(name)
            if number:
                values.append((number.value, k))
        if len(values) > 1:
            extremes = min(values), max(values)
            if extremes[1][0] > _zero_in_range(name) and extremes[0] != extremes[1]:
                yield name, [(value, cases[k]) for value, k in extremes]
