"""The thermal problems of ``mantle verify``: conduction, friction, cure, heated elastic bodies."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

from app.verification import closed_forms_heat as exact
from app.verification import heat_measures as measures
from app.verification.check import Check, CheckRun, Measure, each, ladder, problem
from app.verification.heat_measures import BONE, CEMENT
from app.verification.measures import SLICE, number

KINETICS = (2.6397e8, 62866.0)
PMMA = exact.ExactKinetics(*KINETICS, 0.98, 1.064)
RISE = 155 / 1.74  # K


def heat_problems() -> list[Check]:
    """All thermal problems."""
    kinds = (_steady, _transient, _rubbing, _setting, _expanding, _stiff, _stiff_contact)
    return [check for kind in kinds for check in kind()]


def _steady() -> Iterator[Check]:
    conductances = (1.0, 300.0, 1e6)
    yield problem(
        "heat_bars",
        "temperatures of two bars, over their range, and flux; 1 to 1e6 W/(m2 K)",
        "two_bars",
        [partial(measures.bars, conductance=1e-3 * h) for h in conductances],
        1e-6,
        [(f"interfaces.cement_bone.conductance={h} W/(m^2 K)",) for h in conductances],
    )
    what = "temperatures of two rings, relative in L2"
    sizes: tuple[float, ...] = (1, 0.5, 0.35, 0.25)
    yield ladder("heat_rings", what, "two_rings", measures.rings, 1e-4, SLICE, sizes)
    what = "temperatures of a perfused slab, relative in L2"
    yield problem("heat_slab", what, "perfused_slab", measures.slab, 1e-3)
    what = "temperatures with a fibre in any direction, relative in L2"
    cell, sizes = ("mesh.size={!r} mm",), (1 / 3, 1 / 4, 1 / 6, 1 / 8)
    yield ladder("heat_fibre", what, "fibre_heat", measures.in_fibre, 5e-3, cell, sizes)


def _transient() -> Iterator[Check]:
    what, case = "temperatures of a cooling cylinder, relative in L2", "cooling_cylinder"
    sizes = (2, 1, 0.5, 0.3)
    yield ladder("heat_cylinder", what, case, measures.cylinder, 0.005, SLICE, sizes)
    what = "temperatures of two half-spaces in contact, over their range"
    for name, h in (("perfect", math.inf), ("resistance", 1.0)):
        text = "perfect" if math.isinf(h) else f"{1e3 * h} W/(m^2 K)"
        law = partial(measures.half_spaces, conductance=h)
        runs = [(f"interfaces.cement_bone.conductance={text}",)]
        yield problem(f"heat_contact_{name}", what, "half_spaces", law, 0.01, runs)


def _rubbing() -> Iterator[Check]:
    e, f = exact.effusivity(CEMENT), exact.effusivity(BONE)
    insulated = (
        "interfaces.cement_bone.friction_heating=0.7",
        "interfaces.cement_bone.conductance=0 W/(m^2 K)",
    )
    perfect = ("interfaces.cement_bone.conductance=perfect",)
    split = partial(measures.rubbed, share=e / (e + f))
    rows: list[tuple[str, str, Measure, float, tuple[str, ...]]] = [
        ("split", "shared by effusivity", split, 0.01, ()),
        ("given", "shared as given", partial(measures.rubbed, share=0.7), 0.01, insulated),
        ("perfect", "perfect contact", split, 0.01, perfect),
        ("energy", "heat stored over work lost", measures.rubbing_heat, 1e-6, ()),
    ]
    for name, quantity, measure, tolerance, overrides in rows:
        what = f"heat of friction, {quantity}, relative"
        yield problem(f"rubbing_{name}", what, "rubbing", measure, tolerance, [overrides])


def _setting() -> Iterator[Check]:
    logistic = exact.ExactKinetics(*KINETICS, 1, 1)
    kinetics = "regions.cube.thermal.cure.kinetics"

    def held(temperature: float) -> tuple[str, ...]:
        bath = f"{{kind: temperature, regions: [cube], temperature: {temperature} degC}}"
        return (
            f"heat={{bath: {bath}}}",
            f"regions.cube.thermal.initial_temperature={temperature} degC",
            "stages.0.duration=3200 s",
        )

    what = "when half of it has set, default tolerances [s], relative"
    orders = (f"{kinetics}.m=1", f"{kinetics}.n=1")
    rows: list[tuple[str, tuple[str, ...], float]] = [
        ("adiabatic_37C", (), PMMA.time(0.5, 310.15, 1e-3, RISE)),
        ("adiabatic_23C", held(23)[1:], PMMA.time(0.5, 296.15, 1e-3, RISE)),
        ("isothermal_23C", held(23), PMMA.time(0.5, 296.15, 1e-3, 0)),
        ("logistic_37C", (*held(37), *orders), logistic.time(0.5, 310.15, 1e-3, 0)),
    ]
    for name, overrides, reference in rows:
        time = partial(number, name="cube.time_50", reference=reference)
        yield problem(f"cure_{name}", what, "exotherm", time, 1e-4, [overrides])
    what = "temperature after it has set without losing heat, over its rise"
    yield problem("cure_heat", what, "exotherm", measures.heat_of_cure, 1e-9)
    end, reference = 300.0, PMMA.degree(300.0, 310.15, 1e-3, RISE)
    degree = partial(measures.degree, reference=reference)
    for method, order, counts, tolerance in (
        ("backward_euler", 1.0, (40, 80, 160), 0.02),
        ("sdirk4", 4.0, (4, 6, 8, 12), 1e-5),
    ):
        runs = tuple(
            CheckRun(
                "verification/exotherm.yaml",
                (f"time={{method: {method}}}", *_forced(end / n, n)),
                size=end / n,
            )
            for n in counts
        )
        what = "degree of cure after 300 s in steps of one length, relative"
        judge, rung = each(degree, last=True), "time step (s)"
        yield Check(f"cure_order_{method}", what, runs, judge, tolerance, order, rung=rung)


def _expanding() -> Iterator[Check]:
    what = "mean pressure of a hot stem in a cooled ring [MPa], relative"
    sizes = (1.2, 0.6, 0.3, 0.2)
    yield ladder("hot_fit", what, "hot_fit", measures.hot_fit, 0.005, SLICE, sizes)
    what = "stresses of a mantle cooled between stem and bone [MPa], over the largest"
    stress = partial(measures.layers_stress, joined=(True, True))
    yield problem("layers_bonded", what, "cooled_layers", stress, 0.01)
    law = "{kind: contact, friction_coefficient: 0}"
    free = (f"interfaces.stem_cement={law}", f"interfaces.cement_bone={law}")
    what = "the same without tension; pressure, gap [mm], relative"
    stress = partial(measures.layers_stress, joined=(True, False))
    both: list[Measure] = [stress, measures.layers_contact]
    yield problem("layers_unilateral", what, "cooled_layers", both, 0.01, [free, free])
    what = "conductance that depends on pressure: one of two states, relative"
    warm = ("regions.cement.thermal.initial_temperature=75 degC",)
    for name, overrides, closed in (("open", (), False), ("closed", warm, True)):
        state = partial(measures.walls, closed=closed)
        yield problem(f"walls_{name}", what, "heated_walls", state, 1e-4, [overrides])
    sizes = (0.125, 0.0833, 0.0625, 0.05)
    fields: dict[str, Measure] = {
        "temperature": measures.wavy_temperature,
        "displacement": measures.wavy_displacement,
    }
    for name, measure in fields.items():
        what = f"{name} of a manufactured contact, conductance by pressure, relative in L2"
        yield ladder(f"wavy_{name}", what, "wavy_contact", measure, 0.005, SLICE[1:], sizes)


def _cure(energy: float = 62866.0, heat: float = 1.55e8, initial: float = 1e-3) -> tuple[str, str]:
    """Cement that sets, as in exotherm.yaml."""
    rate = f"rate_constant: 2.6397e8 1/s, activation_energy: {energy} J/mol, m: 0.98, n: 1.064"
    kinetics = f"{{kind: autocatalytic, {rate}}}"
    cure = f"{{kinetics: {kinetics}, heat: {heat} J/m^3, initial: {initial}}}"
    thermal = "regions.cement.thermal"
    return f"{thermal}.initial_temperature=23 degC", f"{thermal}.cure={cure}"


def _forced(step: float, count: int) -> tuple[str, ...]:
    stage = f"{{name: forced, duration: {step * count} s, increments: {count}, adaptive: false}}"
    return (f"stages=[{stage}]",)


def _stiff() -> Iterator[Check]:
    """Names, overrides and the highest temperature of the data [degC]."""

    def conductance(h: float) -> tuple[str, ...]:
        return tuple(
            f"interfaces.{name}.conductance={h} W/(m^2 K)"
            for name in ("stem_cement", "cement_bone")
        )

    euler = ("time.method=backward_euler",)
    thin = ("geometry.cement_thickness=0.5 mm", "mesh.size=1 mm")
    cases: dict[str, tuple[tuple[str, ...], float]] = {
        f"h_{h:.0e}".replace("+0", "").replace("e0", ""): (conductance(h), 100.0)
        for h in (0.0, 1.0, 1e3, 1e6, 1e9)
    }
    cases |= {
        "h_1e9_cure": ((*conductance(1e9), *_cure()), math.inf),
        "steps_1ms": (_forced(1e-3, 20), 100.0),
        "steps_1s": (_forced(1, 20), 100.0),
        "steps_1min": (_forced(60, 20), 100.0),
        "steps_1h": (_forced(3600, 2), 100.0),
        "steps_1ms_euler": ((*_forced(1e-3, 20), *euler), 100.0),
        "steps_1h_euler": ((*_forced(3600, 2), *euler), 100.0),
        "steps_1min_cure": ((*_forced(60, 60), *_cure()), math.inf),
        "steps_1h_cure": ((*_forced(3600, 2), *_cure()), math.inf),
        "seed_1e-6": (_cure(initial=1e-6), math.inf),
        "energy_doubled": (_cure(energy=125732.0), math.inf),
        "exotherm_doubled": (_cure(heat=3.1e8), math.inf),
        "mantle_half_mm": (thin, 100.0),
        "mantle_half_mm_cure": ((*thin, *_cure()), math.inf),
        "diffusivity_1e3": (("regions.stem.thermal.conductivity=430 W/(m K)",), 100.0),
    }
    what = "heat lost, temperatures beyond the data, degrees beyond 0 and 1"
    for name, (overrides, high) in cases.items():
        low = 23.0 if any("23 degC" in o for o in overrides) else 37.0
        bounds = partial(measures.endured, low=low, high=high)
        yield problem(f"stiff_{name}", what, "stiff", bounds, 1e-6, [overrides])


def _stiff_contact() -> Iterator[Check]:
    what = "the same as contact opens and closes under 200 K"
    rubbing = ("interfaces.stem_cement.friction_heating=effusivity",)
    for name, overrides, high in (("", (), 237.0), ("_rubbing", rubbing, math.inf)):
        bounds = partial(measures.endured, low=-163.0, high=high)
        yield problem(f"stiff_contact{name}", what, "stiff_contact", bounds, 1e-6, [overrides])
