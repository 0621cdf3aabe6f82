"""Creep of cement: constant stress, relaxation, rings, a taper, jumps over seven decades."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from app.verification import closed_forms_long_term as exact
from app.verification.closed_forms_long_term import CEMENT_CREEP, SUBSIDENCE, E
from app.verification.measures import summary_number
from app.verification.problem import Comparison, KnownProblem, quick, relative, stress, verify

CREEP_BAR = "verification/creep_bar.yaml"
STRAIN = "bar.creep_strain_max"
MISES = "bar.von_mises_max"
CYCLES = 1e6
POWER_LAW = "e = A s^p N^(m0 + m1 log10 s)"
HARDENING = "strain hardening: N(e) by quadrature, as the stress is s - E e"


def held(s: float) -> tuple[str, str]:
    """Overrides for the bar stretched to a stress [MPa] and held."""
    stretch = f"supports.end={{kind: displacement, boundary: top, z: {3 * s / E!r} mm}}"
    return "loads={}", stretch


@verify
@quick
def test_creep_constant_stress(problem: KnownProblem) -> None:
    problem.expects(
        "creep strain at constant stress, in three jumps and by error, relative",
        tolerance=1e-6,
        source=POWER_LAW,
    )
    fine = "stages.0.creep_tolerance=1e-6"
    changes_of_runs = [("stages.0.adaptive=false", "stages.0.increments=3", fine), (fine,)]
    runs = problem.solve_each(CREEP_BAR, changes_of_runs)
    reference = exact.creep_strain_at_constant_stress(CEMENT_CREEP, 5, CYCLES)
    problem.compare(*(summary_number(solved, STRAIN, reference) for solved in runs))


@verify
def test_creep_order(problem: KnownProblem) -> None:
    problem.expects(
        "stress of a held bar by Norton's law, n = 4, in equal steps [MPa], relative",
        tolerance=1e-3,
        order=2.0,
        rung="step (s)",
        source="s^-3 = s0^-3 + 3 E A t",
    )
    norton = "regions.bar.creep={A: 1e-6, p: 4, m0: 1, per: 1 s}"
    stage = "stages.0={{name: hold, creep_time: 1 s, adaptive: false, increments: {}}}"
    steps = problem.rungs((1 / 20, 1 / 40, 1 / 80, 1 / 160))
    changes_of_runs = [(*held(10), norton, stage.format(round(1 / step))) for step in steps]
    runs = problem.solve_each(CREEP_BAR, changes_of_runs)
    reference = (1e-3 + 3 * E * 1e-6) ** (-1 / 3)
    problem.converges([summary_number(solved, MISES, reference) for solved in runs])


@verify
@quick
def test_creep_relaxation(problem: KnownProblem) -> None:
    problem.expects(
        "stress of a held bar, by strain hardening [MPa], relative",
        tolerance=2e-3,
        source=HARDENING,
    )
    solved = problem.solve(CREEP_BAR, *held(10))
    problem.compare(summary_number(solved, MISES, exact.relaxed_stress(CEMENT_CREEP, 10, CYCLES)))


@verify
def test_creep_shrink_fit(problem: KnownProblem) -> None:
    problem.expects(
        "pressure of a shrink fit that relaxes, two exponentials [MPa], relative",
        tolerance=2e-3,
        source="Maxwell's law by correspondence and inverse transform",
    )
    law = f"creep={{A: {2.6 / (3 * E)!r}, p: 1, m0: 1, per: 1 s}}"
    solved = problem.solve(
        "verification/lame_plane_strain.yaml",
        "geometry.stem_radius=6 mm",
        "geometry.cement_thickness=2 mm",
        "geometry.bone_thickness=2 mm",
        "geometry.length=0.8 mm",
        "mesh.size=0.8 mm",
        "mesh.far_size=0.8 mm",
        "mesh.order=2",
        "regions.stem={rigid: true}",
        f"regions.cement.{law}",
        f"regions.bone.{law}",
        "stages=[{name: fit, creep_time: 2 s, creep_tolerance: 2e-3}]",
    )
    reference = exact.shrink_fit(6, 10, 0.01, 0.3, 2)
    problem.compare(summary_number(solved, "stem_cement.pressure_mean", reference))


@verify
@pytest.mark.parametrize(("n", "A"), [pytest.param(2, 1e-5, id="2"), pytest.param(4, 1e-7, id="4")])
def test_creep_ring(problem: KnownProblem, n: int, A: float) -> None:
    """Means of both stresses are compared, because values oscillate within cells."""
    problem.expects(
        f"hoop less radial stress of a ring that flows, n = {n} [MPa], relative in L2",
        tolerance=5e-3,
        source="stationary creep of a thick tube",
    )
    law = f"creep: {{A: {A}, p: {n}, m0: 1, per: 1 s}}"
    material = f"{{youngs_modulus: 2200 MPa, poisson_ratio: 0.3, tissue: other, {law}}}"
    solved = problem.solve(
        "verification/fibre_ring.yaml",
        "mesh.order=2",
        "mesh.size=1 mm",
        f"regions.ring={material}",
        "stages=[{name: hold, creep_time: 20 s}]",
    )
    x = solved.points[solved.cells[:, :4]].mean(axis=1)
    r = np.hypot(x[:, 0], x[:, 1])
    radial = np.column_stack([x[:, 0], x[:, 1], 0 * r]) / r[:, None]
    hoop = np.column_stack([-x[:, 1], x[:, 0], 0 * r]) / r[:, None]
    σ = solved.stress()
    along_hoop, along_radius = (
        np.einsum("ci,cij,cj->c", direction, σ, direction) for direction in (hoop, radial)
    )
    reference = exact.stationary_ring(r, n, pressure=10.0, a=5.0, b=10.0)
    volume = solved.volumes()
    error = np.average((along_hoop - along_radius - reference) ** 2, weights=volume)
    problem.compare(Comparison(float(np.sqrt(error / np.average(reference**2, weights=volume)))))


@verify
def test_creep_taper(problem: KnownProblem) -> None:
    problem.expects(
        "subsidence of a taper by creep, against rings [mm], relative",
        tolerance=5e-3,
        source="integration of rates (tests/verification/test_closed_forms_creep.py)",
    )
    solved = problem.solve("verification/creep_taper.yaml")
    sunk = solved.step_record["stem subsidence [mm]"]
    problem.compare(relative(float(sunk[-1] - sunk[0]), SUBSIDENCE))


# Stress over four decades, loaded and held; jumps over seven

STRESSES = (0.01, 0.1, 1.0, 10.0, 50.0)
JUMPS = (1, 10, 1e3, 1e5, 1e7)


@stress
@pytest.mark.parametrize(
    ("s", "jump"),
    [pytest.param(s, jump, id=f"{s:g} MPa {jump:g}") for s, jump in product(STRESSES, JUMPS)],
)
def test_creep_first_jump(problem: KnownProblem, s: float, jump: float) -> None:
    problem.expects("creep strain after one jump, relative", tolerance=1e-3, source=POWER_LAW)
    stage = f"stages.0={{name: jump, creep_cycles: {jump}, adaptive: false, creep_tolerance: 1e-4}}"
    solved = problem.solve(CREEP_BAR, f"loads.pull.pressure={-s} MPa", stage)
    problem.compare(
        summary_number(solved, STRAIN, exact.creep_strain_at_constant_stress(CEMENT_CREEP, s, jump))
    )


STRESSED = [pytest.param(s, id=f"{s:g} MPa") for s in STRESSES]


@stress
@pytest.mark.parametrize("s", STRESSED)
def test_creep_loaded(problem: KnownProblem, s: float) -> None:
    problem.expects("creep strain under load, relative", tolerance=1e-3, source=POWER_LAW)
    solved = problem.solve(CREEP_BAR, f"loads.pull.pressure={-s} MPa")
    problem.compare(
        summary_number(
            solved, STRAIN, exact.creep_strain_at_constant_stress(CEMENT_CREEP, s, CYCLES)
        )
    )


@stress
@pytest.mark.parametrize("s", STRESSED)
def test_creep_held(problem: KnownProblem, s: float) -> None:
    problem.expects("stress of a held bar, relative", tolerance=5e-3, source=HARDENING)
    solved = problem.solve(CREEP_BAR, *held(s))
    problem.compare(summary_number(solved, MISES, exact.relaxed_stress(CEMENT_CREEP, s, CYCLES)))
