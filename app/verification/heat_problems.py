"""The thermal problems of ``mantle verify``: conduction, friction, cure, heated elastic bodies."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

from mantle.verification import closed_forms_heat as exact
from mantle.verification import heat_measures as measures
from mantle.verification.heat_measures import BONE, CEMENT
from mantle.verification.measures import Measure
from mantle.verification.problem import Check, CheckRun, ladder

KINETICS = (2.6397e8, 62866.0)
PMMA = exact.ExactKinetics(*KINETICS, 0.98, 1.064)
RISE = 155 / 1.74  # K
TIME_STEP = "time step (s)"


def heat_problems(fine: bool = False) -> list[Check]:
    """All of them.

    Args:
        fine: Whether ladders have their finest rungs too.
    """
    return [
        *_steady(fine),
        *_transient(fine),
        *_rubbing(),
        *_setting(),
        *_expanding(fine),
        *_stiff(),
        *_stiff_contact(),
    ]


def _sizes(*sizes: float, fine: bool) -> list[float]:
    """The sizes of a ladder, whose last is for those who have time."""
    return list(sizes if fine else sizes[:-1])


# A slice of cylinders as long as its cells, a mesh of one size.
_SLICE = ("geometry.length={} mm", "mesh.size={} mm", "mesh.far_size={} mm")


def _steady(fine: bool) -> Iterator[Check]:
    yield Check(
        "heat_bars",
        "temperatures of two bars, over their range, and flux; 1 to 1e6 W/(m2 K)",
        1e-6,
        "two_bars.yaml",
        tuple(
            CheckRun(
                (f"interfaces.cement_bone.conductance={h} W/(m^2 K)",),
                partial(measures.bars, conductance=1e-3 * h),
            )
            for h in (1.0, 300.0, 1e6)
        ),
    )
    yield Check(
        "heat_rings",
        "temperatures of two rings, relative in L2",
        1e-4,
        "two_rings.yaml",
        ladder(_sizes(1, 0.5, 0.35, 0.25, fine=fine), _SLICE, measures.rings),
        2.0,
    )
    yield Check(
        "heat_slab",
        "temperatures of a perfused slab, relative in L2",
        1e-3,
        "perfused_slab.yaml",
        (CheckRun((), measures.slab),),
    )
    yield Check(
        "heat_fibre",
        "temperatures with a fibre in any direction, relative in L2",
        5e-3,
        "fibre_heat.yaml",
        ladder(
            _sizes(1 / 3, 1 / 4, 1 / 6, 1 / 8, fine=fine), ("mesh.size={!r} mm",), measures.in_fibre
        ),
        2.0,
    )


def _transient(fine: bool) -> Iterator[Check]:
    yield Check(
        "heat_cylinder",
        "temperatures of a cooling cylinder, relative in L2",
        0.005,
        "cooling_cylinder.yaml",
        ladder(_sizes(2, 1, 0.5, 0.3, fine=fine), _SLICE, measures.cylinder),
        2.0,
    )
    for name, h in (("perfect", math.inf), ("resistance", 1.0)):
        text = "perfect" if math.isinf(h) else f"{1e3 * h} W/(m^2 K)"
        yield Check(
            f"heat_contact_{name}",
            "temperatures of two half-spaces in contact, over their range",
            0.01,
            "half_spaces.yaml",
            (
                CheckRun(
                    (f"interfaces.cement_bone.conductance={text}",),
                    partial(measures.half_spaces, conductance=h),
                ),
            ),
        )


def _rubbing() -> Iterator[Check]:
    e, f = exact.effusivity(CEMENT), exact.effusivity(BONE)
    insulated = (
        "interfaces.cement_bone.friction_heating=0.7",
        "interfaces.cement_bone.conductance=0 W/(m^2 K)",
    )
    one = "interfaces.cement_bone.conductance=perfect"
    rows: list[tuple[str, str, float, tuple[str, ...], Measure]] = [
        ("split", "shared by effusivity", 0.01, (), partial(measures.rubbed, share=e / (e + f))),
        ("given", "shared as given", 0.01, insulated, partial(measures.rubbed, share=0.7)),
        ("perfect", "perfect contact", 0.01, (one,), partial(measures.rubbed, share=e / (e + f))),
        ("energy", "heat stored over work lost", 1e-6, (), measures.rubbing_heat),
    ]
    for name, quantity, tolerance, overrides, measure in rows:
        yield Check(
            f"rubbing_{name}",
            f"heat of friction, {quantity}, relative",
            tolerance,
            "rubbing.yaml",
            (CheckRun(overrides, measure),),
        )


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

    cases = {
        "adiabatic_37C": ((), PMMA.time(0.5, 310.15, 1e-3, RISE)),
        "adiabatic_23C": (held(23)[1:], PMMA.time(0.5, 296.15, 1e-3, RISE)),
        "isothermal_23C": (held(23), PMMA.time(0.5, 296.15, 1e-3, 0)),
        "logistic_37C": (
            (*held(37), f"{kinetics}.m=1", f"{kinetics}.n=1"),
            logistic.time(0.5, 310.15, 1e-3, 0),
        ),
    }
    for name, (overrides, reference) in cases.items():
        yield Check(
            f"cure_{name}",
            "when half of it has set, default tolerances [s], relative",
            1e-4,
            "exotherm.yaml",
            (CheckRun(overrides, partial(measures.setting_time, reference=reference)),),
        )
    yield Check(
        "cure_heat",
        "temperature after it has set without losing heat, over its rise",
        1e-9,
        "exotherm.yaml",
        (CheckRun((), measures.heat_of_cure),),
    )
    end, reference = 300.0, PMMA.degree(300.0, 310.15, 1e-3, RISE)
    for method, order, counts, tolerance in (
        ("backward_euler", 1.0, (40, 80, 160), 0.02),
        ("sdirk4", 4.0, (4, 6, 8, 12), 1e-5),
    ):
        yield Check(
            f"cure_order_{method}",
            "degree of cure after 300 s in steps of one length, relative",
            tolerance,
            "exotherm.yaml",
            tuple(
                CheckRun(
                    (f"time={{method: {method}}}", *_forced(end / n, n)),
                    partial(measures.degree, reference=reference),
                    end / n,
                )
                for n in counts
            ),
            order,
            rung=TIME_STEP,
        )


def _expanding(fine: bool) -> Iterator[Check]:
    yield Check(
        "hot_fit",
        "mean pressure of a hot stem in a cooled ring [MPa], relative",
        0.005,
        "hot_fit.yaml",
        ladder(_sizes(1.2, 0.6, 0.3, 0.2, fine=fine), _SLICE, measures.hot_fit),
        2.0,
    )
    yield Check(
        "layers_bonded",
        "stresses of a mantle cooled between stem and bone [MPa], over the largest",
        0.01,
        "cooled_layers.yaml",
        (CheckRun((), partial(measures.layers_stress, joined=(True, True))),),
    )
    law = "{kind: contact, friction_coefficient: 0}"
    free = (f"interfaces.stem_cement={law}", f"interfaces.cement_bone={law}")
    stress = partial(measures.layers_stress, joined=(True, False))
    yield Check(
        "layers_unilateral",
        "the same without tension; pressure, gap [mm], relative",
        0.01,
        "cooled_layers.yaml",
        (CheckRun(free, stress), CheckRun(free, measures.layers_contact)),
    )
    warm = ("regions.cement.thermal.initial_temperature=75 degC",)
    for name, overrides, closed in (("open", (), False), ("closed", warm, True)):
        yield Check(
            f"walls_{name}",
            "conductance that depends on pressure: one of two states, relative",
            1e-4,
            "heated_walls.yaml",
            tuple(
                CheckRun(
                    (*overrides, f"solver.coupling={how}"), partial(measures.walls, closed=closed)
                )
                for how in ("monolithic", "staggered")
            ),
        )
    fields: dict[str, Measure] = {
        "temperature": measures.wavy_temperature,
        "displacement": measures.wavy_displacement,
    }
    for name, measure in fields.items():
        yield Check(
            f"wavy_{name}",
            f"{name} of a manufactured contact, conductance by pressure, relative in L2",
            0.005,
            "wavy_contact.yaml",
            ladder(
                _sizes(0.125, 0.0833, 0.0625, 0.05, fine=fine),
                ("mesh.size={} mm", "mesh.far_size={} mm"),
                measure,
            ),
            2.0,
        )


# Cement that sets, as in exotherm.yaml.
_CURE = (
    "regions.cement.thermal.initial_temperature=23 degC",
    "regions.cement.thermal.cure={{kinetics: {{kind: autocatalytic, rate_constant: 2.6397e8 1/s, "
    "activation_energy: {energy} J/mol, m: 0.98, n: 1.064}}, heat: {heat} J/m^3, "
    "initial: {initial}}}",
)


def _cure(energy: float = 62866.0, heat: float = 1.55e8, initial: float = 1e-3) -> tuple[str, ...]:
    return tuple(o.format(energy=energy, heat=heat, initial=initial) for o in _CURE)


def _forced(step: float, count: int) -> tuple[str, ...]:
    """Steps of one length [s]."""
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
        "mantle_half_mm": (("geometry.cement_thickness=0.5 mm", "mesh.size=1 mm"), 100.0),
        "mantle_half_mm_cure": (
            ("geometry.cement_thickness=0.5 mm", "mesh.size=1 mm", *_cure()),
            math.inf,
        ),
        "diffusivity_1e3": (("regions.stem.thermal.conductivity=430 W/(m K)",), 100.0),
    }
    for name, (overrides, high) in cases.items():
        low = 23.0 if any("23 degC" in o for o in overrides) else 37.0
        yield Check(
            f"stiff_{name}",
            "heat lost, temperatures beyond the data, degrees beyond 0 and 1",
            1e-6,
            "stiff.yaml",
            (CheckRun(overrides, partial(measures.endured, low=low, high=high)),),
        )


def _stiff_contact() -> Iterator[Check]:
    for name, overrides, low, high in (
        ("", (), -163.0, 237.0),
        ("_rubbing", ("interfaces.stem_cement.friction_heating=effusivity",), -163.0, math.inf),
    ):
        yield Check(
            f"stiff_contact{name}",
            "the same as contact opens and closes under 200 K",
            1e-6,
            "stiff_contact.yaml",
            (CheckRun(overrides, partial(measures.endured, low=low, high=high)),),
        )
