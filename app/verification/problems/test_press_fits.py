"""Press fits of rings: Lamé's pressure, varying interference, different rings, thin rings."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product

import numpy as np
import pytest

from app.foundation.verdict import Reason
from app.results.reading import Run
from app.verification import closed_forms as exact
from app.verification.measures import (
    CEMENT,
    MESH,
    TITANIUM,
    in_l2,
    largest_error,
    slice_of,
    summary_number,
)
from app.verification.problem import (
    Comparison,
    KnownProblem,
    condensed,
    long,
    quick,
    relative,
    stress,
    verify,
)

RINGS = "verification/lame_plane_strain.yaml"
LAME = "Lamé (Timoshenko & Goodier, Theory of Elasticity, section 28)"
INTERFERENCE = 0.01  # mm
RADIUS = 7.0  # mm, of the core
SIZES = (1.6, 0.8, 0.4, 0.25)  # mm, of cells
PRESSURE = "stem_cement.pressure_mean"


def halves(thickness: float) -> tuple[str, str]:
    """Overrides for a ring of a thickness [mm] in two equal halves."""
    keys = ("geometry.cement_thickness", "geometry.bone_thickness")
    first_half, second_half = (f"{key}={thickness / 2} mm" for key in keys)
    return first_half, second_half


def lame_pressure(kind: str, thickness: float) -> float:
    """Pressure of the fit in plane strain or with free ends [MPa]."""
    law = exact.lame_pressure if kind == "plane_strain" else exact.lame_pressure_free
    return law(INTERFERENCE, RADIUS, RADIUS + thickness, TITANIUM, CEMENT)


FITS = [(kind, t) for kind in ("plane_strain", "free_ends") for t in (2, 3, 4, 5, 7)]
QUICK = ("plane_strain", 3)


@verify
@pytest.mark.parametrize(
    ("kind", "t"),
    [
        pytest.param(*fit, id="_".join(map(str, fit)), marks=quick if fit == QUICK else ())
        for fit in FITS
    ],
)
def test_lame(problem: KnownProblem, kind: str, t: int) -> None:
    """One thickness suffices to show the order."""
    ordered = t == 3
    problem.expects(
        f"mean pressure of a shrink fit, {t} mm [MPa], relative",
        tolerance=0.005,
        order=2.0 if ordered else None,
        source=LAME,
    )
    sizes = problem.rungs(SIZES) if ordered else (0.4,)
    changes_of_runs = [(*halves(t), *slice_of(h)) for h in sizes]
    runs = problem.solve_each(f"verification/lame_{kind}.yaml", changes_of_runs)
    pressures = [summary_number(solved, PRESSURE, lame_pressure(kind, t)) for solved in runs]
    if ordered:
        problem.converges(pressures)
    else:
        problem.compare(*pressures)


@verify
@quick
def test_lame_p2_curved(problem: KnownProblem) -> None:
    problem.expects(
        "the same, plane strain, 3 mm, by curved cells of second order [MPa], relative",
        tolerance=1e-3,
        source=LAME,
    )
    solved = problem.solve(RINGS, "mesh.order=2", "mesh.curved=true", *slice_of(0.8))
    problem.compare(summary_number(solved, PRESSURE, lame_pressure("plane_strain", 3)))


# A rigid rod in a ring, by the key `interference`: fitted, pushed in, pulled out, driven in

ROD = "verification/pressed_rod.yaml"
RING = (17e3, 0.3)
OUTER_RADIUS = 17.0  # mm, radius of the ring
ROD_LENGTH = 40.0  # mm
RIGID = (1e12, 0.3)
FRICTION = 0.5
NO_FRICTION = "interfaces.stem_cement.friction_coefficient=0"


@verify
@quick
def test_press_fit_pressure(problem: KnownProblem) -> None:
    problem.expects(
        "mean pressure of a rod pressed into a ring, without friction [MPa], relative",
        tolerance=1e-3,
        source=LAME,
    )
    one_stage = "stages=[{name: fit}]", "supports.rod.history=[0]"
    solved = problem.solve(ROD, NO_FRICTION, *one_stage, *slice_of(1.0))
    problem.compare(summary_number(solved, PRESSURE, fit_pressure()))


def fit_pressure() -> float:
    """Lamé's pressure of the rod in its ring [MPa]."""
    return exact.lame_pressure_free(0.02, RADIUS, OUTER_RADIUS, RIGID, RING)


@verify
@pytest.mark.parametrize(
    ("way", "sign"),
    [pytest.param("into", -1, id="in", marks=quick), pytest.param("out of", 1, id="out")],
)
def test_press_fit_pushed(problem: KnownProblem, way: str, sign: int) -> None:
    """The whole rod slides. The axial stress of the ring changes the pressure by a tenth.

    Cells of 2.4, 1.6, 1.2 and 0.9 mm give errors of pushing in of -0.24, -0.07, 0.00 and 0.04 %.
    Poisson's effect alone gives -1.2, -1.1, -1.0 and -0.95 %.
    """
    problem.expects(
        f"force that moves a rod {way} its ring [N], relative",
        tolerance=0.005,  # the axial stress is taken as uniform across the ring
        source="Lamé with Poisson's effect of the axial stress, and the change of shear",
    )
    solved = problem.solve(ROD, f"supports.rod.z={sign * 0.2} mm")
    area = 2 * np.pi * RADIUS * ROD_LENGTH / 4
    factor = exact.press_out_factor(sign * FRICTION, RADIUS, OUTER_RADIUS, ROD_LENGTH, RING[1])
    force = abs(solved.summary["interfaces"]["stem_cement"]["force"][2])
    problem.compare(relative(force, FRICTION * fit_pressure() * area * factor))


@verify
def test_press_fit_taper(problem: KnownProblem) -> None:
    """Without friction the force grows with the depth to which a cone is driven."""
    problem.expects(
        "force that drives a cone into a ring without friction [N], relative",
        tolerance=0.03,
        source="rings of Lamé",
    )
    angle, depth = float(np.radians(1.5)), 0.6
    solved = problem.solve(
        ROD,
        NO_FRICTION,
        "interfaces.stem_cement.interference=null",
        "geometry.taper=1.5 deg",
        f"supports.rod.z={-depth} mm",
    )
    rise = 0.5 * ROD_LENGTH * np.tan(angle)
    cone = RADIUS - rise, RADIUS + rise
    force = 4 * abs(solved.summary["interfaces"]["stem_cement"]["force"][2])
    problem.compare(relative(force, exact.taper_force(depth, angle, cone, OUTER_RADIUS, RING)))


# Interference that varies around the core

OVAL = exact.OvalFit(7, 12, TITANIUM, CEMENT, 0.01, 0.003)
MICHELL = "Lamé and Michell's solution of order 2 (Barber, Elasticity, table 9.1)"


def oval_changes(cells: str, sizes: Sequence[float]) -> list[tuple[str, ...]]:
    """Overrides for cells of first order, and for straight and curved cells of second order."""
    order = {
        "p1": ("mesh.order=1",),
        "p2": ("mesh.order=2", "mesh.curved=false"),
        "p2_curved": ("mesh.order=2", "mesh.curved=true"),
    }
    return [(*order[cells], *slice_of(h)) for h in sizes]


@verify
@pytest.mark.parametrize(
    "cells", [pytest.param("p1", marks=quick), pytest.param("p2"), pytest.param("p2_curved")]
)
def test_oval_fit(problem: KnownProblem, cells: str) -> None:
    """The jump is of first order in space for any displacement, so all converge at order 2."""
    problem.expects(
        "displacement of a press fit of varying interference, relative in L2",
        tolerance=0.005,
        order=2.0,
        source=MICHELL,
    )
    changes_of_runs = oval_changes(cells, problem.rungs(SIZES))
    runs = problem.solve_each("verification/oval_fit.yaml", changes_of_runs)
    fields = [partial(OVAL.displacement, in_core=core) for core in (True, False)]
    problem.converges([in_l2(solved, fields) for solved in runs])


@verify
@pytest.mark.parametrize(
    ("cells", "tolerance"),
    [
        pytest.param("p1", 0.05, id="p1"),
        pytest.param("p2", 0.01, id="p2", marks=quick),
        pytest.param("p2_curved", 0.01, id="p2_curved"),
    ],
)
def test_oval_pressure(problem: KnownProblem, cells: str, tolerance: float) -> None:
    """Pressure at the contact points."""
    problem.expects("its pressure [MPa], relative in L2", tolerance=tolerance, source=MICHELL)
    sizes = SIZES[2:] if problem.tier == "long" else SIZES[2:3]
    runs = problem.solve_each("verification/oval_fit.yaml", oval_changes(cells, sizes))

    def pressure(run: Run) -> Comparison:
        area = run.areas("stem_cement")
        computed = run.at_interface("stem_cement", "pressure")
        should = OVAL.pressure(run.points)
        error, norm, reference = (
            float(np.sqrt(np.average(values**2, weights=area)))
            for values in (computed - should, computed, should)
        )
        return Comparison(error / reference, norm, reference)

    problem.compare(*map(pressure, runs))


# Rings at extremes

CURVED = ("mesh.order=2", "mesh.curved=true")
COARSE = (*CURVED, "mesh.size=1 mm", "mesh.far_size=1 mm", "geometry.length=1 mm")


def compare_rings(
    problem: KnownProblem,
    overrides: Sequence[str],
    thicknesses: Sequence[float],
    materials: Sequence[exact.Elastic],
) -> None:
    """Solve a core in a mantle in a ring.

    The outer pressure counts if the outer interface is in contact.
    """
    solved = problem.solve(RINGS, *overrides)
    radii = [float(r) for r in RADIUS + np.cumsum([0.0, *thicknesses])]
    swelling = INTERFERENCE / (1 + materials[0][1]) / RADIUS
    layers = exact.Layers(radii, materials, (swelling, 0.0, 0.0), (True, True))
    errors = {}
    notes = []
    for i, name in enumerate(("stem_cement", "cement_bone")):
        if name in solved.summary["interfaces"]:
            computed = solved.summary["interfaces"][name]["pressure_mean"]
            p = -layers.state_at(i, radii[i])[1]
            errors[name] = abs(computed / p - 1)
            notes.append(f"{name} {computed:.5g} MPa, exact {p:.5g}")
    problem.compare(Comparison(largest_error(errors).error, note="; ".join(notes)))


@stress
@condensed
@pytest.mark.parametrize(
    "ratio",
    [pytest.param(float(f"{10.0**k:.6g}"), id=f"P2/{10.0**k:g}") for k in range(-3, 7)],
)
def test_modulus_rings(problem: KnownProblem, ratio: float) -> None:
    problem.expects("mean pressures of rings [MPa], relative", tolerance=MESH / 2, source=LAME)
    core = (2200 * ratio, 0.3)
    overrides = (*COARSE, f"regions.stem.youngs_modulus={core[0]!r} MPa")
    compare_rings(problem, overrides, (1.5, 1.5), (core, CEMENT, CEMENT))


@stress
@condensed
@pytest.mark.parametrize(
    "ν", [pytest.param(ν, id=f"P2/{ν:g}") for ν in (0.0, 0.3, 0.45, 0.49, 0.499, 0.4999)]
)
def test_poisson_rings(problem: KnownProblem, ν: float) -> None:
    problem.expects("mean pressures of rings [MPa], relative", tolerance=MESH / 2, source=LAME)
    overrides = (*COARSE, f"regions.cement.poisson_ratio={ν}")
    compare_rings(problem, overrides, (1.5, 1.5), (TITANIUM, (2200, ν), CEMENT))


OUTER = {
    "bonded": (),
    "contact": ("interfaces.cement_bone={kind: contact, friction_coefficient: 0}",),
}


@stress(group="thin mantle")
@condensed
@pytest.mark.parametrize(
    ("size", "t", "outer"),
    [
        pytest.param(
            size,
            t,
            outer,
            id=f"cells {size:g} mm {outer}/{t:g} mm",
            marks=() if size in (1.0, 2.0) else long,
        )
        for size, t, outer in product((0.5, 1.0, 2.0, 4.0), (4.0, 1.0, 0.5, 0.2), OUTER)
    ],
)
def test_thin_mantle(problem: KnownProblem, size: float, t: float, outer: str) -> None:
    """A mantle of 0.2 mm has cells of ten times its thickness, and of twenty times.

    Cells of more than half the radius follow the mantle less closely. Cells of twenty times the
    thickness leave no mantle, and the mesh has a note.
    """
    problem.expects(
        "mean pressures of rings [MPa], relative",
        tolerance=MESH * max(1.0, (size / 2) ** 2),
        source=LAME,
        or_refusal=Reason.MISSING_PART if size >= 20 * t else None,
    )
    overrides = (
        *CURVED,
        f"geometry.cement_thickness={t} mm",
        "geometry.bone_thickness=6 mm",
        f"mesh.size={size} mm",
        f"mesh.far_size={size} mm",
        f"geometry.length={size} mm",
        "regions.bone.youngs_modulus=17 GPa",
        *OUTER[outer],
    )
    compare_rings(problem, overrides, (t, 6), (TITANIUM, CEMENT, (17e3, 0.3)))
