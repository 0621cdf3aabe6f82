"""Finite sliding over rigid bodies: a ball in its cup, on a block, along a track."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from app.foundation.arrays import Bools, Floats
from app.results.reading import Run
from app.verification import closed_forms as exact
from app.verification.changed_meshes import ROTATION
from app.verification.measures import difference_between, summary_number
from app.verification.problem import (
    Comparison,
    KnownProblem,
    quick,
    relative,
    run,
    verify,
    worst,
)
from meshes.data import exterior_facets

CUP = "verification/ball_in_cup.yaml"
COARSE = "mesh={size: 4 mm, far_size: 6 mm, order: 1}"
WHOLE = "motions.ball.largest_step=30 deg"


def cycle_table(*angles: Sequence[float] | Floats) -> str:
    """Override for the angles of the ball about x, y and z [deg] at equal times."""
    rows = [
        ", ".join(repr(float(v)) for v in (k, *angle_values))
        for k, angle_values in enumerate(angles)
    ]
    lines = ["time [s], rotation x [deg], rotation y [deg], rotation z [deg]", *rows]
    return f"motions.ball.rotation.cycle_table={lines}"


def nodal_areas(run: Run, on: Bools) -> Floats:
    """Nodal areas (n,) of the part of the surface whose nodes are all in a set [mm^2]."""
    corners, _ = exterior_facets(run.cells[:, :4])
    return run.area_by_node(corners[on[corners].all(axis=1)])


def pressures(run: Run) -> tuple[Floats, Floats, Floats]:
    """Area, pressure and distance from z of each node (n,) of the interface."""
    (name,) = run.contacts
    r = np.hypot(*run.points[:, :2].T)
    return nodal_areas(run, run.on_interface(name)), run.at_interface(name, "pressure"), r


# A ball in its cup


@verify
def test_slip_cup(problem: KnownProblem) -> None:
    problem.expects(
        "sink of a ball in cups of four clearances, mean pressure near the pole, relative",
        tolerance=0.01,
        source="separate axisymmetric program (tests/reference/axisymmetric.py)",
    )
    smooth = "interfaces.bearing={kind: contact, friction_coefficient: 0, sliding: finite}"
    changes_of_runs = [
        (
            "mesh.size=1.4 mm",
            smooth,
            WHOLE,
            "stages=[{name: press}]",
            f"geometry.radial_clearance={c} mm",
            f"geometry.liner_thickness={8 - c} mm",
        )
        for c in exact.CUP
    ]
    runs = problem.solve_each(CUP, changes_of_runs)

    def pressed(run: Run, clearance: float) -> Comparison:
        """Displacement of the ball after first touch; mean pressure near the pole (20 degrees)."""
        area, p, r = pressures(run)
        area_near_pole = area * (r < np.tan(np.radians(20)) * run.points[:, 2])
        travel = run.step_record["bearing centre.z [mm]"][-1] - clearance
        sink, mean = exact.CUP[clearance]
        pressure = float(area_near_pole @ p / area_near_pole.sum())
        return worst([relative(1e3 * float(travel), sink), relative(pressure, mean)])

    problem.compare(*(pressed(*pair) for pair in zip(runs, exact.CUP, strict=True)))


@verify
def test_slip_thin_layer(problem: KnownProblem) -> None:
    problem.expects(
        "torque over 4/pi mu F R, relative",
        tolerance=0.005,
        source="pressure of a thin layer: as the cosine of the polar angle",
    )
    solved = problem.solve(
        CUP,
        "geometry.radial_clearance=0 mm",
        "geometry.liner_thickness=1 mm",
        "regions.liner.poisson_ratio=0",
    )
    problem.compare(summary_number(solved, "bearing.torque_along", -4 / np.pi * 0.06 * 2000 * 14))


@verify
def test_slip_steady(problem: KnownProblem) -> None:
    """The energy of the last step is compared with its torque times 5 degrees."""
    problem.expects(
        "work of a turn over M dtheta, relative", tolerance=1e-8, source="work of a torque"
    )
    solved = problem.solve(CUP)
    energy, torque = (
        solved.step_record[f"bearing {quantity} [N mm]"]
        for quantity in ("dissipation", "torque_along")
    )
    expected_work = float(-torque[-1] * np.radians(5))
    problem.compare(relative(float(energy[-1] - energy[-2]), expected_work))


@verify
@quick
def test_slip_wear(problem: KnownProblem) -> None:
    problem.expects(
        "volume worn on both sides against pressure times slip at points [mm^3], relative",
        tolerance=1e-8,
        source="Archard's law",
    )
    path = cycle_table((0, 0, 0), (5, 25, 0), (-5, 10, 20), (0, 0, 0))
    solved = problem.solve(CUP, COARSE, path)
    area = nodal_areas(solved, solved.on_interface("bearing"))
    ball = nodal_areas(solved, np.isclose(np.linalg.norm(solved.points, axis=1), 14))
    volume = 0.0
    for k in range(1, len(solved.times)):
        path_now, path_before = (solved.at_interface("bearing", "slip_path", s) for s in (k, k - 1))
        pressure = solved.at_interface("bearing", "pressure", k)
        volume += 1.07e-9 * float(area @ (pressure * (path_now - path_before)))
    depth = solved.at_interface("bearing", "wear")
    reported = solved.summary["interfaces"]["bearing"]["wear_volume"]
    volumes = (reported, float(area @ depth), float(ball @ depth))
    problem.compare(*(relative(float(v), volume) for v in volumes))


# Cases with the same answer


def compare_energies(problem: KnownProblem, runs: Sequence[Run]) -> None:
    """Compare the energy of the last cycle with that of the last run."""
    energies = [run.summary["interfaces"]["bearing"]["dissipation_cycle"] for run in runs]
    problem.compare(*(relative(energy, energies[-1]) for energy in energies))


CYCLE = cycle_table((0, 0, 0), (0, 25, 0), (0, 0, 0), (0, -25, 0), (0, 0, 0))


@verify
def test_slip_cycle(problem: KnownProblem) -> None:
    problem.expects(
        "energy of a cycle of +-25 degrees in 4, 8, 20 and 80 steps [N mm], relative",
        tolerance=1e-5,
        source="the finest steps",
    )
    stages = "stages=[{{name: press}}, {{name: turn, increments: {}, cycles: 2}}]"
    changes_of_runs = [(COARSE, CYCLE, WHOLE, stages.format(n)) for n in (4, 8, 20, 80)]
    compare_energies(problem, problem.solve_each(CUP, changes_of_runs))


@verify
def test_slip_ball_mesh(problem: KnownProblem) -> None:
    problem.expects(
        "energy by another mesh of the ball, relative", tolerance=1e-9, source="the other mesh"
    )
    changes_of_runs = [(COARSE, "geometry.head_size=0.7"), (COARSE,)]
    compare_energies(problem, problem.solve_each(CUP, changes_of_runs))


@verify
def test_slip_turned(problem: KnownProblem) -> None:
    problem.expects(
        "fields of a ball that turns in its cup, all of it turned, over the largest",
        tolerance=1e-8,
        source="the model rotated back",
    )
    rotation_vectors = np.radians(np.outer(range(0, 30, 5), ROTATION[:, 1]))
    euler_angles = Rotation.from_rotvec(rotation_vectors).as_euler("YXZ", degrees=True)[
        :, [1, 0, 2]
    ]
    rotated = run(
        CUP,
        COARSE,
        "motions.ball.about=[0 mm, 0 mm, 0 mm]",
        "interfaces.bearing.between=[head_surface, liner_inner]",
        f'loads.press.force="{(2000 * ROTATION[:, 2]).tolist()} N"',
        cycle_table(*euler_angles),
        mesh="turned",
    )
    runs = problem.solve_all([rotated, run(CUP, COARSE)])
    problem.compare(difference_between(*runs, turn=ROTATION))


# A ball on a block, and along a track

HERTZ = exact.hertz_point(100.0, 60.0, exact.contact_modulus((1e3, 0.3)))


@verify
def test_slip_hertz(problem: KnownProblem) -> None:
    """The peak pressure comes from the pressure within 0.6 a.

    The radius comes from the second moment 2/5 a^2. The spin torque is compared too.
    """
    problem.expects(
        "peak pressure, radius and torque of a ball that spins on a block, relative",
        tolerance=0.01,
        source="Hertz (Johnson, Contact Mechanics, section 4.2a); torque 3 pi/16 mu F a",
    )
    solved = problem.solve("verification/ball_on_block.yaml")
    area, p, r = pressures(solved)
    shape = np.sqrt(1 - np.minimum(r / HERTZ.a, 1) ** 2)
    area_near_centre = area * (r < 0.6 * HERTZ.a)
    radius = float(np.sqrt(2.5 * (area @ (p * r**2)) / (area @ p)))
    problem.compare(
        relative(float((area_near_centre @ p) / (area_near_centre @ shape)), HERTZ.p0),
        relative(radius, HERTZ.a),
        summary_number(solved, "contact.torque.z", -3 * np.pi / 16 * 0.3 * 100 * HERTZ.a),
    )


@verify
def test_slip_ball_rolls(problem: KnownProblem) -> None:
    problem.expects(
        "force along a track over mu N, of a ball that stands, rolls, turns 10 % too fast",
        tolerance=0.01,
        source="Coulomb's law: 1, 0, -1",
    )
    forces = {0: 1, 1: 0, 1.1: -1}  # by the speed of the ball over that of rolling
    changes_of_runs = [(cycle_table((0, 0, 0), (0, np.degrees(c * 4 / 60), 0)),) for c in forces]
    runs = problem.solve_each("verification/rolling_ball.yaml", changes_of_runs)
    comparisons = []
    for solved, force in zip(runs, forces.values(), strict=True):
        x, _, z = solved.summary["interfaces"]["contact"]["force"]
        drag = x / abs(z) / 0.3
        comparisons.append(Comparison(abs(drag - force), drag, force))
    problem.compare(*comparisons)


@verify
@quick
def test_slip_drawn(problem: KnownProblem) -> None:
    """Force and work of all four paths.

    Height and pressure after the last path are those after the second.
    """
    problem.expects(
        "force to and fro and work, over mu N; 100 times what a second cycle changes, relative",
        tolerance=1e-7,
        source="Coulomb's law",
    )
    solved = problem.solve("verification/drawn_block.yaml")
    column_names = ("force.x [N]", "force.z [N]", "dissipation [N mm]", "centre.z [mm]")
    x, z, energy, height = (solved.step_record[f"contact {name}"] for name in column_names)
    work_of_slides = np.diff(energy).reshape(4, 3)[:, 1:] / 3000
    directions = np.repeat([-1, 1, -1, 1], 3)
    first_pressure, last_pressure = (solved.at_interface("contact", "pressure", k) for k in (6, 12))
    drift = [*(last_pressure - first_pressure) / first_pressure.max(), height[12] / height[6] - 1]
    errors = np.concatenate(
        [(x / z / 0.3)[1:] - directions, work_of_slides.ravel() - 1, np.multiply(100, drift)]
    )
    problem.compare(Comparison(float(np.abs(errors).max())))
