"""Large slip over rigid bodies: problems of ``mantle verify`` with closed forms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from app.foundation.arrays import Bools, Floats
from app.results.reading import Run
from app.verification import closed_forms as exact
from app.verification import judges
from app.verification.changed_meshes import ROTATION
from app.verification.check import Check, Sample, problem, run, worst
from app.verification.measures import number, relative
from meshes.data import exterior_facets

# Sink [um] and mean pressure [MPa] within 20 degrees of the pole of the ball of ball_in_cup.yaml
# without friction, by clearance; the cup's outside stays at 22 mm. From
# tests/reference/axisymmetric.py.
CUP = {0.05: (35.424, 8.298), 0.1: (45.084, 10.332), 0.2: (58.746, 13.159), 0.5: (84.498, 18.328)}
HERTZ = exact.hertz_point(100.0, 60.0, exact.contact_modulus((1e3, 0.3)))
_COARSE, _WHOLE = "mesh={size: 4 mm, far_size: 6 mm, order: 1}", "motions.ball.largest_step=30 deg"


def slip_problems() -> Iterator[Check]:
    """All of them."""
    cup, gap, thick = "ball_in_cup", "geometry.radial_clearance", "geometry.liner_thickness"
    smooth = "interfaces.bearing={kind: contact, friction_coefficient: 0, sliding: finite}"
    own = ("mesh.size=1.4 mm", smooth, _WHOLE, "stages=[{name: press}]")
    runs = [(*own, f"{gap}={c} mm", f"{thick}={8 - c} mm") for c in CUP]
    what = "sink of a ball in cups of four clearances, mean pressure near the pole, relative"
    yield problem("slip_cup", what, cup, [partial(pressed, clearance=c) for c in CUP], 0.01, runs)
    layer = (f"{gap}=0 mm", f"{thick}=1 mm", "regions.liner.poisson_ratio=0")
    M = partial(number, name="bearing.torque_along", reference=-4 / np.pi * 0.06 * 2000 * 14)
    yield problem("slip_thin_layer", "torque over 4/pi mu F R, relative", cup, M, 0.005, [layer])
    yield problem("slip_steady", "work of a turn over M dtheta, relative", cup, steady, 1e-8)
    what = "volume worn on both sides against pressure times slip at points [mm^3], relative"
    path = _course((0, 0, 0), (5, 25, 0), (-5, 10, 20), (0, 0, 0))
    yield problem("slip_wear", what, cup, worn, 1e-8, [(_COARSE, path)])
    what = "peak pressure, radius and torque of a ball that spins on a block, relative"
    yield problem("slip_hertz", what, "ball_on_block", hertz, 0.01)
    what = "force along a track over mu N, of a ball that stands, rolls, turns 10 % too fast"
    drags = [partial(drag, reference=force) for force in (1, 0, -1)]
    turns = [(_course((0, 0, 0), (0, np.degrees(c * 4 / 60), 0)),) for c in (0, 1, 1.1)]
    yield problem("slip_ball_rolls", what, "rolling_ball", drags, 0.01, turns)
    what = "force to and fro and work, over mu N; 100 times what a second cycle changes, relative"
    yield problem("slip_drawn", what, "drawn_block", drawn, 1e-7)
    yield from _alike()


def _alike() -> Iterator[Check]:
    """Cases with the same answer: steps, meshes of the ball, a turn of all."""
    cup = partial(run, "verification/ball_in_cup.yaml", _COARSE)
    cycle = _course((0, 0, 0), (0, 25, 0), (0, 0, 0), (0, -25, 0), (0, 0, 0))
    stages = "stages=[{{name: press}}, {{name: turn, increments: {}, cycles: 2}}]"
    runs = tuple(cup(cycle, _WHOLE, stages.format(n)) for n in (4, 8, 20, 80))
    what = "energy of a cycle of +-25 degrees in 4, 8, 20 and 80 steps [N mm], relative"
    yield Check("slip_cycle", what, runs, alike, 1e-5)
    runs = cup("geometry.head_size=0.7"), cup()
    yield Check("slip_ball_mesh", "energy by another mesh of the ball, relative", runs, alike, 1e-9)
    about = np.radians(np.outer(range(0, 30, 5), ROTATION[:, 1]))
    turned = Rotation.from_rotvec(about).as_euler("YXZ", degrees=True)[:, [1, 0, 2]]
    at = "motions.ball.about=[0 mm, 0 mm, 0 mm]"
    between = "interfaces.bearing.between=[head_surface, liner_inner]"
    force = f'loads.press.force="{(2000 * ROTATION[:, 2]).tolist()} N"'
    own = cup(at, between, force, _course(*turned), mesh="turned")
    what = "fields of a ball that turns in its cup, all of it turned, over the largest"
    yield Check("slip_turned", what, (own, cup()), partial(judges.same, turn=ROTATION), 1e-8)


def _course(*angles: Sequence[float] | Floats) -> str:
    """Angles of the ball about x, y and z [deg] at equal times."""
    rows = [", ".join(repr(float(v)) for v in (k, *of)) for k, of in enumerate(angles)]
    lines = ("time [s], rotation x [deg], rotation y [deg], rotation z [deg]", *rows)
    return f"motions.ball.rotation.course={list(lines)}"


def _areas(run: Run, on: Bools) -> Floats:
    """Area of a surface with some nodes, by node (n,)."""
    corners, _ = exterior_facets(run.cells[:, :4])
    return run.area_by_node(corners[on[corners].all(axis=1)])


def _pressure(run: Run) -> tuple[Floats, Floats, Floats]:
    """Area and pressure of the interface, and distance from z, by node (n,)."""
    (name,), r = run.contacts, np.hypot(*run.points[:, :2].T)
    return _areas(run, run.on_interface(name)), run.at_interface(name, "pressure"), r


def pressed(run: Run, clearance: float) -> Sample:
    """Way of the ball after first touch; mean pressure within 20 degrees of the pole."""
    area, p, r = _pressure(run)
    near = area * (r < np.tan(np.radians(20)) * run.points[:, 2])
    way, (sink, mean) = run.history["bearing centre.z [mm]"][-1] - clearance, CUP[clearance]
    return worst([relative(1e3 * float(way), sink), relative(float(near @ p / near.sum()), mean)])


def steady(run: Run) -> Sample:
    """Energy of the last step over its torque times 5 degrees."""
    energy, M = (run.history[f"bearing {of} [N mm]"] for of in ("dissipation", "torque_along"))
    return relative(float(energy[-1] - energy[-2]), float(-M[-1] * np.radians(5)))


def alike(runs: Sequence[Run]) -> Sample:
    """Largest difference of the energy of the last cycle."""
    energies = [run.summary["interfaces"]["bearing"]["dissipation_cycle"] for run in runs]
    return worst([relative(energy, energies[-1]) for energy in energies])


def worn(run: Run) -> Sample:
    """Volume by pressure and slip of each step, against that told and the fields of both sides."""
    of, r = partial(run.at_interface, "bearing"), np.linalg.norm(run.points, axis=1)
    way = (of("slip_path", k) - of("slip_path", k - 1) for k in range(1, len(run.times)))
    area, ball = _areas(run, run.on_interface("bearing")), _areas(run, np.isclose(r, 14))
    volume = 1.07e-9 * float(area @ sum(of("pressure", k) * slid for k, slid in enumerate(way, 1)))
    depth, told = of("wear"), run.summary["interfaces"]["bearing"]["wear_volume"]
    return worst([relative(float(v), volume) for v in (told, area @ depth, ball @ depth)])


def hertz(run: Run) -> Sample:
    """Peak pressure by that within 0.6 a; radius by its second moment, 2/5 a^2; spin torque."""
    area, p, r = _pressure(run)
    shape, near = np.sqrt(1 - np.minimum(r / HERTZ.a, 1) ** 2), area * (r < 0.6 * HERTZ.a)
    radius = float(np.sqrt(2.5 * (area @ (p * r**2)) / (area @ p)))
    spin = number(run, "contact.torque.z", -3 * np.pi / 16 * 0.3 * 100 * HERTZ.a)
    peak = relative(float((near @ p) / (near @ shape)), HERTZ.p0)
    return worst([peak, relative(radius, HERTZ.a), spin])


def drag(run: Run, reference: float) -> Sample:
    """Force along x over the largest friction."""
    x, _, z = run.summary["interfaces"]["contact"]["force"]
    return Sample(abs(x / abs(z) / 0.3 - reference), x / abs(z) / 0.3, reference)


def drawn(run: Run) -> Sample:
    """Force and work of all four ways; height and pressure after the last against the second."""
    names = ("force.x [N]", "force.z [N]", "dissipation [N mm]", "centre.z [mm]")
    x, z, energy, height = (run.history[f"contact {name}"] for name in names)
    work, way = np.diff(energy).reshape(4, 3)[:, 1:] / 3000, np.repeat([-1, 1, -1, 1], 3)
    first, last = (run.at_interface("contact", "pressure", k) for k in (6, 12))
    drift = [*(last - first) / first.max(), height[12] / height[6] - 1]
    off = np.concatenate([(x / z / 0.3)[1:] - way, work.ravel() - 1, np.multiply(100, drift)])
    return Sample(float(np.abs(off).max()))
