"""The problems of ``mantle verify``: runs of cases, judges and tolerances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from app.verification import closed_forms as exact
from app.verification import measures
from app.verification.cement_problems import cement_problems
from app.verification.check import Check, each, ladder, problem
from app.verification.closed_forms_cohesion import cohesion_problems
from app.verification.closed_forms_creep import creep_problems
from app.verification.closed_forms_layer import layer_problems
from app.verification.closed_forms_slip import slip_problems
from app.verification.heat_problems import heat_problems
from app.verification.measures import BONE, CEMENT, SLICE, TITANIUM
from app.verification.remodelling_problems import remodelling_problems
from app.verification.validation import validation

# Some of each kind, each some seconds.
QUICK = {
    *("klarbring", "cattaneo_stick_width", "hertz_ball_pressure", "hertz_line_pressure"),
    *("cook_0.499", "lame_plane_strain_3", "lame_p2_curved", "patch_fibre_111"),
    *("uniaxial_along_fibre", "incline", "foundation_bar_end", "oval_fit_p1", "oval_pressure_p2"),
    *("sine_p2", "layers_bonded", "heat_slab", "heat_bars", "heat_contact_resistance"),
    *("layer_cycle", "layer_turned", "layer_corner", "slip_drawn", "slip_wear"),
    *("cure_adiabatic_23C", "cure_isothermal_23C", "cure_heat", "cure_order_backward_euler"),
    *("creep_constant_stress", "creep_relaxation", "cohesive_bar", "cohesive_unloading"),
}


def problems() -> list[Check]:
    """All problems of ``mantle verify``."""
    fits = (_homogeneous, _sines, _fibre_rings, _press_fits, _oval_fits)
    kinds = (*fits, _hertz, _friction, _wall, _cook)
    what = "friction beyond which a particle has several equilibria, relative"
    klarbring = Check("klarbring", what, (), measures.klarbring, 1e-9)
    every = [*(check for kind in kinds for check in kind()), klarbring, *heat_problems()]
    every += [*cement_problems(), *creep_problems(), *layer_problems(), *remodelling_problems()]
    every += [*cohesion_problems(), *slip_problems()]
    every = [replace(p, tier="quick") if p.name in QUICK else p for p in every]
    return [*every, *validation()]


def _homogeneous() -> Iterator[Check]:
    """Affine displacements and uniaxial tension, by first and second order."""
    b, σ = BONE, 10.0

    def runs(region: str, fibre: list[int]) -> list[tuple[str, str]]:
        return [(f"regions.{region}.fibre={fibre}", f"mesh.order={order}") for order in (1, 2)]

    what = "stress of an affine displacement [MPa], over the largest; P1 and P2"
    for name, fibre in {"100": [1, 0, 0], "011": [0, 1, 1], "111": [1, 1, 1]}.items():
        stress = partial(measures.patch_stress, fibre=fibre)
        yield problem(f"patch_fibre_{name}", what, "patch", stress, 1e-10, runs("cube", fibre))
    what = "strains under tension, over the largest; P1 and P2"
    along = σ * np.array([-b.nu_l / b.E_l, -b.nu_l / b.E_l, 1 / b.E_l])
    across = σ * np.array([-b.nu_l / b.E_l, -b.nu_t / b.E_t, 1 / b.E_t])
    for name, fibre, ε in (("along", [0, 0, 1], along), ("across", [1, 0, 0], across)):
        strains = partial(measures.strains, along_axes=ε)
        name = f"uniaxial_{name}_fibre"
        yield problem(name, what, "uniaxial", strains, 1e-10, runs("bone", fibre))


def _sines() -> Iterator[Check]:
    what = "displacement of a manufactured solution, relative in L2"
    sine = partial(measures.in_l2, fields=[partial(exact.sine, amplitude=0.01, side=2.0)])
    for order, sizes, tolerance in (
        (1, (1 / 4, 1 / 6, 1 / 8, 1 / 10, 1 / 16), 0.05),
        (2, (1 / 2, 1 / 3, 1 / 4, 1 / 6), 0.005),
    ):
        own = (f"mesh.order={order}", "mesh.size={!r} mm")
        name = f"sine_p{order}"
        yield ladder(name, what, "sine", sine, tolerance, own, sizes, order + 1.0)


def _fibre_rings() -> Iterator[Check]:
    for lay in ("circumferential", "radial"):
        ring = exact.FibreRing(5, 10, 10.0, measures.WOOD, lay == "radial")
        yield ladder(
            f"fibre_ring_{lay}",
            f"displacement of a pressed ring of {lay} fibres, relative in L2",
            "fibre_ring",
            partial(measures.in_l2, fields=[ring.displacement]),
            0.01,
            (f"regions.ring.fibre.kind={lay}", "mesh.size={} mm"),
            (1, 0.5, 0.35, 0.25),
        )


_RUNGS = (1.6, 0.8, 0.4, 0.25)


def _slice(size: float) -> list[str]:
    return [o.format(size) for o in SLICE]


def _press_fits() -> Iterator[Check]:
    laws = {"plane_strain": exact.lame_pressure, "free_ends": exact.lame_pressure_free}
    for (kind, law), t in product(laws.items(), (2, 3, 4, 5, 7)):
        reference = law(0.01, 7.0, 7.0 + t, TITANIUM, CEMENT)
        mean = partial(measures.number, name="stem_cement.pressure_mean", reference=reference)
        half = (f"geometry.cement_thickness={t / 2} mm", f"geometry.bone_thickness={t / 2} mm")
        name, case = f"lame_{kind}_{t}", f"lame_{kind}"
        what = f"mean pressure of a shrink fit, {t} mm [MPa], relative"
        if t == 3:  # one thickness shows the order
            yield ladder(name, what, case, mean, 0.005, (*half, *SLICE), _RUNGS)
        else:
            yield problem(name, what, case, mean, 0.005, [(*half, *_slice(0.4))])
    reference = exact.lame_pressure(0.01, 7.0, 10.0, TITANIUM, CEMENT)
    yield problem(
        "lame_p2_curved",
        "the same, plane strain, 3 mm, by curved cells of second order [MPa], relative",
        "lame_plane_strain",
        partial(measures.number, name="stem_cement.pressure_mean", reference=reference),
        1e-3,
        [("mesh.order=2", "mesh.curved=true", *_slice(0.8))],
    )


def _oval_fits() -> Iterator[Check]:
    fit = exact.OvalFit(7, 12, TITANIUM, CEMENT, 0.01, 0.003)
    fields = [partial(fit.displacement, in_core=core) for core in (True, False)]
    what = "displacement of a press fit of varying interference, relative in L2"
    for name, options, tolerance in (
        ("p1", ("mesh.order=1",), 0.05),
        ("p2", ("mesh.order=2", "mesh.curved=false"), 0.01),
        ("p2_curved", ("mesh.order=2", "mesh.curved=true"), 0.01),
    ):
        own = (*options, *SLICE)
        # The jump is of first order in space whatever the displacement: order 2 for all.
        moved = partial(measures.in_l2, fields=fields)
        rungs = ladder(f"oval_fit_{name}", what, "oval_fit", moved, 0.005, own, _RUNGS)
        yield rungs
        judge = each(partial(measures.oval_pressure, fit=fit))
        pressure = "its pressure [MPa], relative in L2"
        yield Check(f"oval_pressure_{name}", pressure, rungs.runs[2:], judge, tolerance)


def _hertz() -> Iterator[Check]:
    size, modulus = 0.1, exact.contact_modulus(CEMENT)
    line, ball = exact.hertz_line(100.0, 10.0, modulus), exact.hertz_point(100.0, 10.0, modulus)
    for kind, hertz, axes in (("line", line, 1), ("ball", ball, 2)):
        peak = partial(measures.number, name="contact.pressure_max", reference=hertz.p0)
        width = partial(measures.contact_width, reference=hertz.a, axes=axes, size=size)
        rows = [
            ("pressure", f"peak pressure under a {kind} contact [MPa], relative", peak, 0.03),
            ("width", "half-width of contact [mm], in cells", width, 1.0),
        ]
        if kind == "ball":
            down = partial(measures.approach, reference=hertz.approach)
            rows.append(("approach", "approach [mm], relative", down, 0.02))
        runs = [(f"mesh.size={size} mm", "mesh.order=2")]
        for name, what, measure, tolerance in rows:
            yield problem(f"hertz_{kind}_{name}", what, f"hertz_{kind}", measure, tolerance, runs)


def _friction() -> Iterator[Check]:
    size = 0.1
    what = "half-width of the strip that sticks [mm], in cells"
    width = partial(measures.stick_width, size=size)
    yield problem("cattaneo_stick_width", what, "cattaneo", width, 1.0, [(f"mesh.size={size} mm",)])
    bar = exact.FoundationBar(force=500.0, friction=6.0, stiffness=1.1e6)
    end = partial(measures.bar_end, time=2.0, reference=bar.end)
    residual = partial(measures.bar_end, time=3.0, reference=bar.residual)
    cycle = partial(measures.bar_cycle, reference=bar.cycle)
    for name, what, measure in (
        ("end", "end displacement of a bar on a bed with friction [mm], relative", end),
        ("residual", "the same after unloading [mm], relative", residual),
        ("dissipation", "work lost in a cycle of its load [N mm], relative", cycle),
    ):
        yield problem(f"foundation_bar_{name}", what, "foundation_bar", measure, 0.02)
    law = "{kind: penalty, friction_coefficient: 0.3, penalty: 1.0e3 MPa/mm}"
    what = "force over weight that pushes a block up a slope, relative; by a penalty too"
    runs = [(), (f"interfaces.slope_block={law}",)]
    yield problem("incline", what, "incline", measures.push, 0.005, runs)


def _wall() -> Iterator[Check]:
    key = "interfaces.wall_bar"
    yield problem(
        "wall_augmented",
        "force of a bar on a wall [N] and penetration, relative; augmentation 1 to 1e6 MPa/mm",
        "wall",
        measures.wall_force,
        1e-10,
        [(f"{key}.augmentation={r} MPa/mm",) for r in 10.0 ** np.arange(0, 7)],
    )
    law = "{{kind: penalty, friction_coefficient: 0.3, penalty: {} MPa/mm}}"
    penalties = 10.0 ** np.arange(2, 9)
    yield problem(
        "wall_penalty",
        "penetration by the penalty's law [mm], relative; penalty 1e2 to 1e8 MPa/mm",
        "wall",
        [partial(measures.penetration, penalty=float(r)) for r in penalties],
        1e-6,
        [(f"{key}={law.format(r)}",) for r in penalties],
    )


def _cook() -> Iterator[Check]:
    ratio = "regions.membrane.poisson_ratio={}"
    for ν in exact.COOK:
        what = f"rise of the corner of Cook's membrane by P2, nu {ν} [mm], relative"
        corner = partial(measures.corner, poisson_ratio=ν)
        yield problem(f"cook_{ν}", what, "cook", corner, 0.01, [(ratio.format(ν),)])
    ν = max(exact.COOK)
    what = f"the same by P1, nu {ν} [mm]: locks, and warns of it (error 0) or not (1)"
    locks = partial(measures.locking, poisson_ratio=ν)
    runs = [(ratio.format(ν), "mesh.order=1")]
    yield problem("cook_p1_warns", what, "cook", locks, 0.0, runs)
