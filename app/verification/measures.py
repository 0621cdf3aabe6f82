"""Errors of the runs of ``mantle verify``: one small function per quantity."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.case import quantities
from app.foundation.arrays import Bools, Field, Floats, Ints
from app.results.reading import Run
from app.verification import closed_forms as exact
from app.verification.check import Sample

# Materials of the cases (MPa, -).
CEMENT, TITANIUM = (2200.0, 0.3), (110e3, 0.3)
BONE = exact.Fibrous(E_l=17000, E_t=11500, nu_l=0.31, nu_t=0.51, mu_l=3280)
# A slice of cylinders as long as its cells, on a mesh of one size.
SLICE = ("geometry.length={} mm", "mesh.size={} mm", "mesh.far_size={} mm")
WOOD = exact.Fibrous(E_l=12e3, E_t=2e3, nu_l=0.4, nu_t=0.3, mu_l=1e3)


def relative(value: float, reference: float) -> Sample:
    """A value whose error is relative to its reference."""
    return Sample(abs(value / reference - 1), value, reference)


def by_region(region: Ints, values: Sequence[NDArray[np.floating]]) -> Floats:
    """Of the values (n, k) for each region those of each point (n, k); the last for all others."""
    return np.asarray(np.choose(np.minimum(region, len(values))[:, None] - 1, values))


def in_l2(run: Run, fields: Sequence[Field]) -> Sample:
    """Displacement against exact fields, one for each region, relative in L2."""
    error, norm, reference = run.norms(lambda x, region: by_region(region, [u(x) for u in fields]))
    return Sample(error / reference, norm, reference)


def patch_stress(run: Run, fibre: Sequence[float]) -> Sample:
    """Stress under the affine displacement of patch.yaml: its worst component [MPa]."""
    G = 1e-3 * np.array([[1, 0.4, -0.2], [0.2, -0.5, 0.6], [0.3, -0.1, 0.8]])
    σ = BONE.stress((G + G.T) / 2, fibre)
    off = np.abs(run.stress() - σ)
    cell, i, j = np.unravel_index(int(np.argmax(off)), off.shape)
    error = float(off.max() / np.abs(σ).max())
    return Sample(error, float(run.stress()[cell, i, j]), float(σ[i, j]))


def strains(run: Run, along_axes: Floats) -> Sample:
    """Displacement of a block strained along the axes; the value is the strain along z."""
    u = run.displacement()
    off = np.abs(u - along_axes * run.points).max() / run.points.max()
    top = int(np.argmax(run.points[:, 2]))
    value = float(u[top, 2] / run.points[top, 2])
    return Sample(float(off / np.abs(along_axes).max()), value, float(along_axes[2]))


def number(run: Run, name: str, reference: float) -> Sample:
    """A number of the summary, named as in studies."""
    value = quantities.read(run.summary, name)
    return relative(math.nan if value is None else value, reference)


def oval_pressure(run: Run, fit: exact.OvalFit) -> Sample:
    """Pressure at the contact points of the same press fit, relative in L2 [MPa]."""
    area = run.areas("stem_cement")
    p, should = run.at_interface("stem_cement", "pressure"), fit.pressure(run.points)
    error, norm, reference = (
        float(np.sqrt(np.average(values**2, weights=area))) for values in (p - should, p, should)
    )
    return Sample(error / reference, norm, reference)


def contact_width(run: Run, reference: float, axes: int, size: float) -> Sample:
    """Distance of the furthest point under pressure from 0 along x, or in the plane [mm].

    The error is in cells.
    """
    return _width(run, run.at_interface("contact", "pressure") > 0, reference, axes, size)


def _width(run: Run, wanted: Bools, reference: float, axes: int, size: float) -> Sample:
    points = run.points[run.on_interface("contact") & wanted, :axes]
    value = float(np.linalg.norm(points, axis=1).max(initial=0.0))
    return Sample(abs(value - reference) / size, value, reference)


def approach(run: Run, reference: float) -> Sample:
    """Descent of the plate, the second region [mm]."""
    plate = np.unique(run.cells[run.region == 2])
    return relative(float(-run.displacement()[plate, 2].mean()), reference)


def stick_width(run: Run, size: float) -> Sample:
    """Half-width of the strip of cattaneo.yaml that sticks [mm]; the error is in cells."""
    thickness, friction = 0.2, 0.3
    shear, _, pressure = np.abs(run.summary["interfaces"]["contact"]["force"]) / thickness
    a = exact.hertz_line(pressure, 10.0, exact.contact_modulus(CEMENT, CEMENT)).a
    reference = exact.stick_half_width(a, shear, pressure, friction)
    return _width(run, run.at_interface("contact", "status") == 1, reference, 1, size)


def step_at(run: Run, time: float) -> int:
    """The written step nearest to a time."""
    return int(np.argmin(np.abs(run.times - time)))


def work_lost(run: Run, interface: str, times: ArrayLike) -> Floats:
    """Work that an interface loses from each of n times to the next (n - 1,) [N mm]."""
    work = run.history[f"{interface} dissipation [N mm]"]
    return np.diff(np.interp(np.asarray(times, dtype=float), run.history["time [-]"], work))


def end_of_bar(run: Run, time: float) -> float:
    """End displacement of the bar on a frictional foundation [mm]."""
    x, z = run.points[:, 0], run.points[:, 2]
    end = np.isclose(x, 110) & np.isclose(z, z.max())
    return float(run.displacement(step_at(run, time))[end, 0].mean())


def bar_end(run: Run, time: float, reference: float) -> Sample:
    """End displacement of the bar on a frictional foundation [mm]."""
    return relative(end_of_bar(run, time), reference)


def bar_cycle(run: Run, reference: float) -> Sample:
    """Work that the bar loses from time 3 to time 5 [N mm]."""
    return relative(float(work_lost(run, "base_bar", (3.0, 5.0))[0]), reference)


def push(run: Run, friction: float = 0.3) -> Sample:
    """Horizontal force over weight of the block on a slope."""
    weight = 0.01 * 800
    force = run.summary["interfaces"]["slope_block"]["force"][0]
    return relative(abs(force) / weight, exact.push_up(0.1, friction))


def wall_force(run: Run) -> Sample:
    """Force of the bar on the wall [N]; relative penetration counts as error too."""
    q = run.summary["interfaces"]["wall_bar"]
    force = relative(abs(q["force"][2]), 220 * 0.01 * 4)
    return Sample(max(force.error, q["penetration_max"] / 0.01), force.value, force.reference)


def penetration(run: Run, penalty: float) -> Sample:
    """Penetration of the bar into the wall [mm]."""
    value = run.summary["interfaces"]["wall_bar"]["penetration_max"]
    return relative(value, exact.penalty_penetration(220, 0.01, penalty))


def corner(run: Run, poisson_ratio: float) -> Sample:
    """Rise of the corner (48, 60) of Cook's membrane [mm]."""
    at = int(np.argmin(np.linalg.norm(run.points[:, :2] - (48, 60), axis=1)))
    return relative(float(run.displacement()[at, 1]), exact.COOK[poisson_ratio][1])


def locking(run: Run, poisson_ratio: float) -> Sample:
    """Warning about locking in the log: error 0 if it is there, else 1."""
    rise = corner(run, poisson_ratio)
    warned = rise.error > 0.1 and re.search(r"\block", run.log)
    return Sample(0.0 if warned else 1.0, rise.value, rise.reference)


def klarbring(runs: Sequence[Run]) -> Sample:
    """Friction beyond which Klarbring's particle has several equilibria."""
    from app.soundness.failure import critical_friction  # brings the whole solver

    K = np.diag([1.0, 1.0, 2.0])
    K[0, 2] = K[2, 0] = 0.8
    value = critical_friction(K[None], np.array([[0.0, 0.0, 1.0]]))[0]
    return relative(float(value), exact.particle_friction(1.0, 0.8))
