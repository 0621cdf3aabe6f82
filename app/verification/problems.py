"""The problems of ``mantle verify``: which runs of which case, and what is tolerated."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import product

import numpy as np

from mantle.verification import closed_forms as exact
from mantle.verification import measures
from mantle.verification.heat_problems import heat_problems
from mantle.verification.measures import BONE, CEMENT, TITANIUM, Measure
from mantle.verification.problem import Check, CheckRun, ladder


def problems(fine: bool = False) -> list[Check]:
    """All problems.

    Args:
        fine: Whether ladders have their finest rungs too.
    """
    return [
        *_patches(),
        *_uniaxial(),
        *_sines(fine),
        *_press_fits(fine),
        *_oval_fits(fine),
        *_hertz(),
        *_friction(),
        *_wall(),
        *_cook(),
        Check(
            "klarbring",
            "friction beyond which a particle has several equilibria, relative",
            1e-9,
            direct=measures.klarbring,
        ),
        *heat_problems(fine),
    ]


def _patches() -> Iterator[Check]:
    for name, fibre in {"100": [1, 0, 0], "011": [0, 1, 1], "111": [1, 1, 1]}.items():
        measure = partial(measures.patch_stress, fibre=fibre)
        yield Check(
            f"patch_fibre_{name}",
            "stress of an affine displacement [MPa], over the largest; P1 and P2",
            1e-10,
            "patch.yaml",
            tuple(
                CheckRun((f"regions.cube.fibre={fibre}", f"mesh.order={order}"), measure)
                for order in (1, 2)
            ),
        )


def _uniaxial() -> Iterator[Check]:
    b, σ = BONE, 10.0
    along = σ * np.array([-b.nu_l / b.E_l, -b.nu_l / b.E_l, 1 / b.E_l])
    across = σ * np.array([-b.nu_l / b.E_l, -b.nu_t / b.E_t, 1 / b.E_t])
    for name, fibre, strains in (("along", [0, 0, 1], along), ("across", [1, 0, 0], across)):
        measure = partial(measures.strains, along_axes=strains)
        yield Check(
            f"uniaxial_{name}_fibre",
            "strains under tension, over the largest; P1 and P2",
            1e-10,
            "uniaxial.yaml",
            tuple(
                CheckRun((f"regions.bone.fibre={fibre}", f"mesh.order={order}"), measure)
                for order in (1, 2)
            ),
        )


def _sines(fine: bool) -> Iterator[Check]:
    ladders = {
        1: [1 / 4, 1 / 6, 1 / 8, 1 / 10, *([1 / 16] if fine else [])],
        2: [1 / 2, 1 / 3, 1 / 4, *([1 / 6] if fine else [])],
    }
    for order, sizes in ladders.items():
        yield Check(
            f"sine_p{order}",
            "displacement of a manufactured solution, relative in L2",
            0.05 if order == 1 else 0.005,
            "sine.yaml",
            ladder(sizes, (f"mesh.order={order}", "mesh.size={!r} mm"), measures.sine),
            order + 1.0,
        )


# The slices of cylinders are as long as their cells.
_SLICE = ("geometry.length={} mm", "mesh.size={} mm", "mesh.far_size={} mm")


def _press_fits(fine: bool) -> Iterator[Check]:
    laws = {"plane_strain": exact.lame_pressure, "free_ends": exact.lame_pressure_free}
    for (kind, law), t in product(laws.items(), (2, 3, 4, 5, 7)):
        reference = law(0.01, 7.0, 7.0 + t, TITANIUM, CEMENT)
        half = (f"geometry.cement_thickness={t / 2} mm", f"geometry.bone_thickness={t / 2} mm")
        # One thickness shows the order.
        sizes = [1.6, 0.8, 0.4, *([0.25] if fine else [])] if t == 3 else [0.4]
        measure = partial(measures.mean_pressure, reference=reference)
        yield Check(
            f"lame_{kind}_{t}",
            f"mean pressure of a shrink fit, {t} mm [MPa], relative",
            0.005,
            f"lame_{kind}.yaml",
            ladder(sizes, (*half, *_SLICE), measure),
            2.0 if len(sizes) > 1 else None,
        )
    size = 0.8
    overrides = ("mesh.order=2", "mesh.curved=true", *_SLICE)
    reference = exact.lame_pressure(0.01, 7.0, 10.0, TITANIUM, CEMENT)
    yield Check(
        "lame_p2_curved",
        "the same, plane strain, 3 mm, by curved cells of second order [MPa], relative",
        1e-3,
        "lame_plane_strain.yaml",
        ladder([size], overrides, partial(measures.mean_pressure, reference=reference)),
    )


def _oval_fits(fine: bool) -> Iterator[Check]:
    fit = exact.OvalFit(7, 12, TITANIUM, CEMENT, 0.01, 0.003)
    elements = {
        "p1": (("mesh.order=1",), 0.05),
        "p2": (("mesh.order=2", "mesh.curved=false"), 0.01),
        "p2_curved": (("mesh.order=2", "mesh.curved=true"), 0.01),
    }
    sizes = [1.6, 0.8, 0.4, *([0.25] if fine else [])]
    for name, (options, tolerance) in elements.items():
        overrides = (*options, *_SLICE)
        # The jump is of first order in space whatever the displacement: order 2 for all.
        yield Check(
            f"oval_fit_{name}",
            "displacement of a press fit of varying interference, relative in L2",
            0.005,
            "oval_fit.yaml",
            ladder(sizes, overrides, partial(measures.oval_displacement, fit=fit)),
            2.0,
        )
        yield Check(
            f"oval_pressure_{name}",
            "its pressure [MPa], relative in L2",
            tolerance,
            "oval_fit.yaml",
            ladder(sizes[-1:], overrides, partial(measures.oval_pressure, fit=fit)),
        )


def _hertz() -> Iterator[Check]:
    size, modulus = 0.1, exact.contact_modulus(CEMENT)
    kinds = {
        "line": (exact.hertz_line(100.0, 10.0, modulus), 1),
        "ball": (exact.hertz_point(100.0, 10.0, modulus), 2),
    }
    overrides = (f"mesh.size={size} mm", "mesh.order=2")
    for kind, (hertz, axes) in kinds.items():
        peak = partial(measures.peak_pressure, reference=hertz.p0)
        width = partial(measures.contact_width, reference=hertz.a, axes=axes, size=size)
        rows: list[tuple[str, str, float, Measure]] = [
            ("pressure", f"peak pressure under a {kind} contact [MPa], relative", 0.03, peak),
            ("width", "half-width of contact [mm], in cells", 1.0, width),
        ]
        if kind == "ball":
            down = partial(measures.approach, reference=hertz.approach)
            rows.append(("approach", "approach [mm], relative", 0.02, down))
        for name, quantity, tolerance, measure in rows:
            yield Check(
                f"hertz_{kind}_{name}",
                quantity,
                tolerance,
                f"hertz_{kind}.yaml",
                (CheckRun(overrides, measure),),
            )


def _friction() -> Iterator[Check]:
    size = 0.1
    yield Check(
        "cattaneo_stick_width",
        "half-width of the strip that sticks [mm], in cells",
        1.0,
        "cattaneo.yaml",
        (CheckRun((f"mesh.size={size} mm",), partial(measures.stick_width, size=size)),),
    )
    bar = exact.FoundationBar(force=500.0, friction=6.0, stiffness=1.1e6)
    end = partial(measures.bar_end, time=2.0, reference=bar.end)
    residual = partial(measures.bar_end, time=3.0, reference=bar.residual)
    cycle = partial(measures.bar_cycle, reference=bar.cycle)
    rows: list[tuple[str, str, Measure]] = [
        ("end", "end displacement of a bar on a bed with friction [mm], relative", end),
        ("residual", "the same after unloading [mm], relative", residual),
        ("dissipation", "work lost in a cycle of its load [N mm], relative", cycle),
    ]
    for name, quantity, measure in rows:
        yield Check(
            f"foundation_bar_{name}",
            quantity,
            0.02,
            "foundation_bar.yaml",
            (CheckRun((), measure),),
        )
    yield Check(
        "incline",
        "force over weight that pushes a block up a slope, relative; by a penalty too",
        0.005,
        "incline.yaml",
        (
            CheckRun((), measures.push),
            CheckRun(
                (
                    "interfaces.slope_block="
                    "{kind: penalty, friction_coefficient: 0.3, penalty: 1.0e3 MPa/mm}",
                ),
                measures.push,
            ),
        ),
    )


def _wall() -> Iterator[Check]:
    yield Check(
        "wall_augmented",
        "force of a bar on a wall [N] and penetration, relative; augmentation 1 to 1e6 MPa/mm",
        1e-10,
        "wall.yaml",
        tuple(
            CheckRun((f"interfaces.wall_bar.augmentation={r} MPa/mm",), measures.wall_force)
            for r in 10.0 ** np.arange(0, 7)
        ),
    )
    law = "interfaces.wall_bar={{kind: penalty, friction_coefficient: 0.3, penalty: {} MPa/mm}}"
    yield Check(
        "wall_penalty",
        "penetration by the penalty's law [mm], relative; penalty 1e2 to 1e8 MPa/mm",
        1e-6,
        "wall.yaml",
        tuple(
            CheckRun((law.format(r),), partial(measures.penetration, penalty=float(r)))
            for r in 10.0 ** np.arange(2, 9)
        ),
    )


def _cook() -> Iterator[Check]:
    for ratio in exact.COOK:
        yield Check(
            f"cook_{ratio}",
            f"rise of the corner of Cook's membrane by P2, nu {ratio} [mm], relative",
            0.01,
            "cook.yaml",
            (
                CheckRun(
                    (f"regions.membrane.poisson_ratio={ratio}",),
                    partial(measures.corner, poisson_ratio=ratio),
                ),
            ),
        )
    ratio = max(exact.COOK)
    yield Check(
        "cook_p1_warns",
        f"the same by P1, nu {ratio} [mm]: locks, and warns of it (error 0) or not (1)",
        0.0,
        "cook.yaml",
        (
            CheckRun(
                (f"regions.membrane.poisson_ratio={ratio}", "mesh.order=1"),
                partial(measures.locking, poisson_ratio=ratio),
            ),
        ),
    )
