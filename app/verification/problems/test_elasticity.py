"""Elastic bodies: affine displacements, manufactured solutions, fibres, near incompressibility."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from itertools import product

import numpy as np
import pytest

from app.results.reading import Run
from app.verification import closed_forms as exact
from app.verification.measures import BONE, WOOD, in_l2, largest_difference, largest_error
from app.verification.problem import (
    Comparison,
    KnownProblem,
    condensed,
    quick,
    relative,
    run,
    stress,
    verify,
)

LEKHNITSKII = "compliance from uniaxial and shear tests (Lekhnitskii, Anisotropic Body, section 4)"


@verify
@pytest.mark.parametrize(
    "fibre",
    [
        pytest.param([1, 0, 0], id="100"),
        pytest.param([0, 1, 1], id="011"),
        pytest.param([1, 1, 1], id="111", marks=quick),
    ],
)
def test_patch_fibre(problem: KnownProblem, fibre: Sequence[int]) -> None:
    """Every component of the stress of an affine displacement."""
    problem.expects(
        "stress of an affine displacement [MPa], over the largest; P1 and P2",
        tolerance=1e-10,
        source=LEKHNITSKII,
    )
    changes_of_runs = [(f"regions.cube.fibre={fibre}", f"mesh.order={order}") for order in (1, 2)]
    runs = problem.solve_each("verification/patch.yaml", changes_of_runs)
    gradient = 1e-3 * np.array([[1, 0.4, -0.2], [0.2, -0.5, 0.6], [0.3, -0.1, 0.8]])
    σ = BONE.stress((gradient + gradient.T) / 2, fibre)

    def component(run: Run) -> Comparison:
        computed = run.stress()
        errors = np.abs(computed - σ)
        cell, i, j = np.unravel_index(int(np.argmax(errors)), errors.shape)
        error = float(errors.max() / np.abs(σ).max())
        return Comparison(error, float(computed[cell, i, j]), float(σ[i, j]))

    problem.compare(*map(component, runs))


@verify
@pytest.mark.parametrize(
    ("fibre", "across"),
    [
        pytest.param([0, 0, 1], (-BONE.nu_l / BONE.E_l,) * 2, id="along_fibre", marks=quick),
        pytest.param([1, 0, 0], (-BONE.nu_l / BONE.E_l, -BONE.nu_t / BONE.E_t), id="across_fibre"),
    ],
)
def test_uniaxial(problem: KnownProblem, fibre: Sequence[int], across: tuple[float, float]) -> None:
    """Strains of a block under 10 MPa along z."""
    problem.expects(
        "strains under tension, over the largest; P1 and P2", tolerance=1e-10, source=LEKHNITSKII
    )
    changes_of_runs = [(f"regions.bone.fibre={fibre}", f"mesh.order={order}") for order in (1, 2)]
    runs = problem.solve_each("verification/uniaxial.yaml", changes_of_runs)
    strain_along = 1 / (BONE.E_l if fibre[2] else BONE.E_t)
    ε = 10.0 * np.array([*across, strain_along])

    def strains(run: Run) -> Comparison:
        u = run.displacement()
        error = np.abs(u - ε * run.points).max() / run.points.max()
        top_node = int(np.argmax(run.points[:, 2]))
        computed = float(u[top_node, 2] / run.points[top_node, 2])
        return Comparison(float(error / np.abs(ε).max()), computed, float(ε[2]))

    problem.compare(*map(strains, runs))


@verify
@pytest.mark.parametrize(
    ("order", "sizes", "tolerance"),
    [
        pytest.param(1, (1 / 4, 1 / 6, 1 / 8, 1 / 10, 1 / 16), 0.05, id="p1"),
        pytest.param(2, (1 / 2, 1 / 3, 1 / 4, 1 / 6), 0.005, id="p2", marks=quick),
    ],
)
def test_sine(problem: KnownProblem, order: int, sizes: Sequence[float], tolerance: float) -> None:
    problem.expects(
        "displacement of a manufactured solution, relative in L2",
        tolerance=tolerance,
        order=order + 1.0,
        source="manufactured: sin(pi x/L) sin(pi y/L) sin(pi z/L) along x",
    )
    changes_of_runs = [(f"mesh.order={order}", f"mesh.size={h!r} mm") for h in problem.rungs(sizes)]
    runs = problem.solve_each("verification/sine.yaml", changes_of_runs)
    field = partial(exact.sine, amplitude=0.01, side=2.0)
    problem.converges([in_l2(run, [field]) for run in runs])


@verify
@pytest.mark.parametrize("lay", [pytest.param("circumferential", marks=quick), "radial"])
def test_fibre_ring(problem: KnownProblem, lay: str) -> None:
    problem.expects(
        f"displacement of a pressed ring of {lay} fibres, relative in L2",
        tolerance=0.01,
        order=2.0,
        source="Lekhnitskii, Anisotropic Plates, section 24",
    )
    changes_of_runs = [
        (f"regions.ring.fibre.kind={lay}", f"mesh.size={h} mm")
        for h in problem.rungs((1, 0.5, 0.35, 0.25))
    ]
    runs = problem.solve_each("verification/fibre_ring.yaml", changes_of_runs)
    ring = exact.FibreRing(5, 10, 10.0, WOOD, lay == "radial")
    problem.converges([in_l2(run, [ring.displacement]) for run in runs])


# Nearly incompressible bodies

TAYLOR_HOOD = (
    "reference solution by Taylor and Hood's elements (tests/reference/cook_taylor_hood.py)"
)


def corner(run: Run, ν: float) -> Comparison:
    """Rise of the corner (48, 60) of Cook's membrane [mm]."""
    nearest_node = int(np.argmin(np.linalg.norm(run.points[:, :2] - (48, 60), axis=1)))
    return relative(float(run.displacement()[nearest_node, 1]), exact.COOK[ν][1])


@verify
@pytest.mark.parametrize(
    "ν", [pytest.param(ν, id=f"{ν}", marks=quick if ν == 0.499 else ()) for ν in exact.COOK]
)
def test_cook(problem: KnownProblem, ν: float) -> None:
    problem.expects(
        f"rise of the corner of Cook's membrane by P2, nu {ν} [mm], relative",
        tolerance=0.01,
        source=TAYLOR_HOOD,
    )
    solved = problem.solve("verification/cook.yaml", f"regions.membrane.poisson_ratio={ν}")
    problem.compare(corner(solved, ν))


@verify
def test_cook_p1_warns(problem: KnownProblem) -> None:
    """Cells of first order lock, and the run has to warn of it."""
    ν = max(exact.COOK)
    problem.expects(
        f"the same by P1, nu {ν} [mm]: locks, and warns of it (error 0) or not (1)",
        tolerance=0.0,
        source=TAYLOR_HOOD,
    )
    ratio = f"regions.membrane.poisson_ratio={ν}"
    solved = problem.solve("verification/cook.yaml", ratio, "mesh.order=1")
    rise = corner(solved, ν)
    warned = rise.error > 0.1 and re.search(r"\block", solved.log)
    problem.compare(Comparison(0.0 if warned else 1.0, rise.computed, rise.exact))


# A stack of blocks of 5 mm in a smooth box under 2 MPa

STACK = "blocks.yaml"
UNIAXIAL = "uniaxial strain: p / (lambda + 2 mu)"
# Young's moduli [MPa] and Poisson's ratios of its blocks, from below.
MODULI = (17e3, 2200.0, 110e3)
RATIOS = (0.3, 0.3, 0.3)


def stack(run: Run, moduli: Sequence[float], ratios: Sequence[float]) -> Comparison:
    """Displacement and pressure of a stack, which are exact on any mesh."""
    p = 2.0
    height = 5.0
    lame = (exact.lame(material) for material in zip(moduli, ratios, strict=True))
    strains = [p / (λ + 2 * μ) for λ, μ in lame]
    levels = np.arange(len(moduli) + 1) * height
    falls = -np.cumsum([0.0, *strains]) * height
    u = run.displacement()
    should = np.zeros_like(u)
    should[:, 2] = np.interp(run.points[:, 2], levels, falls)
    errors = {"displacement": largest_difference(u, should)}
    for name in run.contacts:
        on_interface = run.on_interface(name)
        pressure = run.at_interface(name, "pressure")[on_interface]
        errors[f"pressure of {name}"] = largest_difference(pressure, np.full(on_interface.sum(), p))
    return largest_error(errors)


# Soft on stiff and stiff on soft, by nine decades.
STIFFNESS_RATIOS = tuple(float(f"{10.0**k:.6g}") for k in range(-3, 7))


@stress
@condensed
@pytest.mark.parametrize(
    ("order", "ratio"),
    [
        pytest.param(order, ratio, id=f"P{order}/{ratio:g}")
        for order, ratio in product((1, 2), STIFFNESS_RATIOS)
    ],
)
def test_modulus_stack(problem: KnownProblem, order: int, ratio: float) -> None:
    problem.expects("displacement and pressure of a stack", tolerance=1e-8, source=UNIAXIAL)
    moduli = (17e3, 17e3 / ratio, 17e3)
    solved = problem.solve(
        STACK,
        f"mesh.order={order}",
        f"regions.cement.youngs_modulus={moduli[1]!r} MPa",
        "regions.metal.youngs_modulus=17 GPa",
    )
    problem.compare(stack(solved, moduli, RATIOS))


@stress
@condensed
@pytest.mark.parametrize(
    "ν", [pytest.param(ν, id=f"P2/{ν:g}") for ν in (0.0, 0.3, 0.45, 0.49, 0.499, 0.4999)]
)
def test_poisson_stack(problem: KnownProblem, ν: float) -> None:
    problem.expects("displacement and pressure of a stack", tolerance=1e-8, source=UNIAXIAL)
    solved = problem.solve(STACK, "mesh.order=2", f"regions.cement.poisson_ratio={ν}")
    problem.compare(stack(solved, MODULI, (0.3, ν, 0.3)))


@stress(group="bad cells")
@condensed
@pytest.mark.parametrize(
    ("mesh", "order"),
    [
        pytest.param(mesh, order, id=f"P{order}/quality {quality:g}")
        for (mesh, quality), order in product((("bad", 0.1), ("worst", 0.012)), (1, 2))
    ],
)
def test_bad_cells(problem: KnownProblem, mesh: str, order: int) -> None:
    """Cells of bad shape."""
    problem.expects("displacement and pressure of a stack", tolerance=1e-8, source=UNIAXIAL)
    overrides = (f"mesh.order={order}", "mesh.size=3 mm")
    (solved,) = problem.solve_all([run(STACK, *overrides, mesh=mesh)])
    problem.compare(stack(solved, MODULI, RATIOS))
