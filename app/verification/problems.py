"""The problems of ``mantle verify``: runs of cases, judges and tolerances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from app.verification import closed_forms as exact
from app.verification import measures
from app.verification.check import Check, CheckRun, Measure, each, finest, ladder
from app.verification.heat_problems import heat_problems
from app.verification.measures import BONE, CEMENT, TITANIUM

# Some of each kind, each some seconds.
QUICK = {
    *("klarbring", "cattaneo_stick_width", "hertz_ball_pressure", "hertz_line_pressure"),
    *("cook_0.499", "lame_plane_strain_3", "lame_p2_curved", "patch_fibre_111"),
    *("uniaxial_along_fibre", "incline", "foundation_bar_end", "oval_fit_p1", "oval_pressure_p2"),
    *("sine_p2", "layers_bonded", "heat_slab", "heat_bars", "heat_contact_resistance"),
    *("cure_adiabatic_23C", "cure_isothermal_23C", "cure_heat", "cure_order_backward_euler"),
}


def problems() -> list[Check]:
    """All mechanical problems of ``mantle verify``."""
    kinds = (
        _homogeneous,
        _sines,
        _fibre_rings,
        _press_fits,
        _oval_fits,
        _hertz,
        _friction,
        _wall,
        _cook,
    )
    what = "friction beyond which a particle has several equilibria, relative"
    klarbring = Check("klarbring", what, (), measures.klarbring, 1e-9)
    every = [*(check for kind in kinds for check in kind()), klarbring, *heat_problems()]
    return [replace(p, tier="quick") if p.name in QUICK else p for p in every]


def _homogeneous() -> Iterator[Check]:
    """Affine displacements and uniaxial tension, by first and second order."""
    b, σ = BONE, 10.0
    along = σ * np.array([-b.nu_l / b.E_l, -b.nu_l / b.E_l, 1 / b.E_l])
    across = σ * np.array([-b.nu_l / b.E_l, -b.nu_t / b.E_t, 1 / b.E_t])
    affine = "stress of an affine displacement [MPa], over the largest; P1 and P2"
    tension = "strains under tension, over the largest; P1 and P2"
    rows: list[tuple[str, str, str, list[int], Measure]] = [
        *(
            (f"patch_fibre_{name}", affine, "cube", a, partial(measures.patch_stress, fibre=a))
            for name, a in {"100": [1, 0, 0], "011": [0, 1, 1], "111": [1, 1, 1]}.items()
        ),
        *(
            (f"uniaxial_{name}_fibre", tension, "bone", a, partial(measures.strains, along_axes=ε))
            for name, a, ε in (("along", [0, 0, 1], along), ("across", [1, 0, 0], across))
        ),
    ]
    for name, what, region, fibre, measure in rows:
        case = f"verification/{name.partition('_')[0]}.yaml"
        overrides = (f"regions.{region}.fibre={fibre}",)
        runs = (CheckRun(case, (*overrides, f"mesh.order={order}")) for order in (1, 2))
        yield Check(name, what, tuple(runs), each(measure), 1e-10)


def _sines() -> Iterator[Check]:
    for order, sizes, last, tolerance in (
        (1, (1 / 4, 1 / 6, 1 / 8, 1 / 10), 1 / 16, 0.05),
        (2, (1 / 2, 1 / 3, 1 / 4), 1 / 6, 0.005),
    ):
        overrides = (f"mesh.order={order}", "mesh.size={!r} mm")
        yield Check(
            f"sine_p{order}",
            "displacement of a manufactured solution, relative in L2",
            ladder("verification/sine.yaml", overrides, sizes, last),
            finest(measures.sine),
            tolerance,
            order + 1.0,
        )


def _fibre_rings() -> Iterator[Check]:
    for lay in ("circumferential", "radial"):
        ring = exact.FibreRing(5, 10, 10.0, measures.WOOD, lay == "radial")
        overrides = (f"regions.ring.fibre.kind={lay}", "mesh.size={} mm")
        yield Check(
            f"fibre_ring_{lay}",
            f"displacement of a pressed ring of {lay} fibres, relative in L2",
            ladder("verification/fibre_ring.yaml", overrides, (1, 0.5, 0.35), 0.25),
            finest(partial(measures.ring_of_fibres, ring=ring)),
            0.01,
            2.0,
        )


# The slices of cylinders are as long as their cells.
SLICE = ("geometry.length={} mm", "mesh.size={} mm", "mesh.far_size={} mm")
_RUNGS = (1.6, 0.8, 0.4)


def _press_fits() -> Iterator[Check]:
    laws = {"plane_strain": exact.lame_pressure, "free_ends": exact.lame_pressure_free}
    for (kind, law), t in product(laws.items(), (2, 3, 4, 5, 7)):
        reference = law(0.01, 7.0, 7.0 + t, TITANIUM, CEMENT)
        half = (f"geometry.cement_thickness={t / 2} mm", f"geometry.bone_thickness={t / 2} mm")
        # One thickness shows the order.
        sizes, last = (_RUNGS, 0.25) if t == 3 else (_RUNGS[-1:], None)
        yield Check(
            f"lame_{kind}_{t}",
            f"mean pressure of a shrink fit, {t} mm [MPa], relative",
            ladder(f"verification/lame_{kind}.yaml", (*half, *SLICE), sizes, last),
            finest(partial(measures.number, name="stem_cement.pressure_mean", reference=reference)),
            0.005,
            2.0 if last else None,
        )
    overrides = ("mesh.order=2", "mesh.curved=true", *SLICE)
    reference = exact.lame_pressure(0.01, 7.0, 10.0, TITANIUM, CEMENT)
    yield Check(
        "lame_p2_curved",
        "the same, plane strain, 3 mm, by curved cells of second order [MPa], relative",
        ladder("verification/lame_plane_strain.yaml", overrides, (0.8,)),
        each(partial(measures.number, name="stem_cement.pressure_mean", reference=reference)),
        1e-3,
    )


def _oval_fits() -> Iterator[Check]:
    fit = exact.OvalFit(7, 12, TITANIUM, CEMENT, 0.01, 0.003)
    elements = {
        "p1": (("mesh.order=1",), 0.05),
        "p2": (("mesh.order=2", "mesh.curved=false"), 0.01),
        "p2_curved": (("mesh.order=2", "mesh.curved=true"), 0.01),
    }
    for name, (options, tolerance) in elements.items():
        runs = ladder("verification/oval_fit.yaml", (*options, *SLICE), _RUNGS, 0.25)
        # The jump is of first order in space whatever the displacement: order 2 for all.
        yield Check(
            f"oval_fit_{name}",
            "displacement of a press fit of varying interference, relative in L2",
            runs,
            finest(partial(measures.oval_displacement, fit=fit)),
            0.005,
            2.0,
        )
        yield Check(
            f"oval_pressure_{name}",
            "its pressure [MPa], relative in L2",
            runs[2:],
            each(partial(measures.oval_pressure, fit=fit)),
            tolerance,
        )


def _hertz() -> Iterator[Check]:
    size, modulus = 0.1, exact.contact_modulus(CEMENT)
    line, ball = exact.hertz_line(100.0, 10.0, modulus), exact.hertz_point(100.0, 10.0, modulus)
    for kind, hertz, axes in (("line", line, 1), ("ball", ball, 2)):
        peak = partial(measures.number, name="contact.pressure_max", reference=hertz.p0)
        width = partial(measures.contact_width, reference=hertz.a, axes=axes, size=size)
        run = CheckRun(f"verification/hertz_{kind}.yaml", (f"mesh.size={size} mm", "mesh.order=2"))
        rows = [
            ("pressure", f"peak pressure under a {kind} contact [MPa], relative", peak, 0.03),
            ("width", "half-width of contact [mm], in cells", width, 1.0),
        ]
        if kind == "ball":
            down = partial(measures.approach, reference=hertz.approach)
            rows.append(("approach", "approach [mm], relative", down, 0.02))
        for name, what, measure, tolerance in rows:
            yield Check(f"hertz_{kind}_{name}", what, (run,), each(measure), tolerance)


def _friction() -> Iterator[Check]:
    size = 0.1
    yield Check(
        "cattaneo_stick_width",
        "half-width of the strip that sticks [mm], in cells",
        (CheckRun("verification/cattaneo.yaml", (f"mesh.size={size} mm",)),),
        each(partial(measures.stick_width, size=size)),
        1.0,
    )
    bar = exact.FoundationBar(force=500.0, friction=6.0, stiffness=1.1e6)
    end = partial(measures.bar_end, time=2.0, reference=bar.end)
    residual = partial(measures.bar_end, time=3.0, reference=bar.residual)
    cycle = partial(measures.bar_cycle, reference=bar.cycle)
    for name, what, measure in (
        ("end", "end displacement of a bar on a bed with friction [mm], relative", end),
        ("residual", "the same after unloading [mm], relative", residual),
        ("dissipation", "work lost in a cycle of its load [N mm], relative", cycle),
    ):
        run = CheckRun("verification/foundation_bar.yaml")
        yield Check(f"foundation_bar_{name}", what, (run,), each(measure), 0.02)
    law = "{kind: penalty, friction_coefficient: 0.3, penalty: 1.0e3 MPa/mm}"
    yield Check(
        "incline",
        "force over weight that pushes a block up a slope, relative; by a penalty too",
        tuple(
            CheckRun("verification/incline.yaml", own)
            for own in ((), (f"interfaces.slope_block={law}",))
        ),
        each(measures.push),
        0.005,
    )


def _wall() -> Iterator[Check]:
    case = "verification/wall.yaml"
    yield Check(
        "wall_augmented",
        "force of a bar on a wall [N] and penetration, relative; augmentation 1 to 1e6 MPa/mm",
        tuple(
            CheckRun(case, (f"interfaces.wall_bar.augmentation={r} MPa/mm",))
            for r in 10.0 ** np.arange(0, 7)
        ),
        each(measures.wall_force),
        1e-10,
    )
    law = "interfaces.wall_bar={{kind: penalty, friction_coefficient: 0.3, penalty: {} MPa/mm}}"
    penalties = 10.0 ** np.arange(2, 9)
    yield Check(
        "wall_penalty",
        "penetration by the penalty's law [mm], relative; penalty 1e2 to 1e8 MPa/mm",
        tuple(CheckRun(case, (law.format(r),)) for r in penalties),
        each(*(partial(measures.penetration, penalty=float(r)) for r in penalties)),
        1e-6,
    )


def _cook() -> Iterator[Check]:
    for ν in exact.COOK:
        yield Check(
            f"cook_{ν}",
            f"rise of the corner of Cook's membrane by P2, nu {ν} [mm], relative",
            (CheckRun("verification/cook.yaml", (f"regions.membrane.poisson_ratio={ν}",)),),
            each(partial(measures.corner, poisson_ratio=ν)),
            0.01,
        )
    ν = max(exact.COOK)
    overrides = (f"regions.membrane.poisson_ratio={ν}", "mesh.order=1")
    yield Check(
        "cook_p1_warns",
        f"the same by P1, nu {ν} [mm]: locks, and warns of it (error 0) or not (1)",
        (CheckRun("verification/cook.yaml", overrides),),
        each(partial(measures.locking, poisson_ratio=ν)),
        0.0,
    )
