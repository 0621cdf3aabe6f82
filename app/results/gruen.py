"""Strain energy of the bone and numbers of the interfaces, by Gruen zone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from app.arrays import Floats
from app.mechanics.problem import Problem
from app.results.interface_numbers import ContactSamples
from app.results.stresses import Stresses

if TYPE_CHECKING:
    from meshes.gruen import Zones

Zone = dict[str, Any]

# A region with less than this part of a zone's bone has no numbers there: it is cancellous bone
# that the mesh leaves between cement and cortex.
LEAST = 0.01


def summary(
    problem: Problem, stresses: Stresses, samples: ContactSamples | None, zones: Zones
) -> dict[str, Zone]:
    """Numbers by zone; collective.

    Returns:
        For each: ``strain_energy_density`` [MPa], the mean over the ``volume`` [mm3] of the zone's
        bone that the operation leaves, and ``interfaces``: numbers of the interfaces within it.
        Parts that a zone lacks have no entry.
    """
    # A rigid region has no strain energy; that of a curing one is not known.
    elastic = {e.region for e in problem.scene.elastic} - set(problem.mechanics.growth)
    regions = [r for r in zones.regions if r in elastic]
    sums = {r: _energy_and_volume(problem, stresses, r, zones) for r in regions}
    result: dict[str, Zone] = {}
    for zone in zones.numbers:
        volumes = {r: float(volume[zone]) for r, (_, volume) in sums.items()}
        volumes = {r: v for r, v in volumes.items() if v > LEAST * sum(volumes.values())}
        density = {r: float(sums[r][0][zone]) / v for r, v in volumes.items()}
        numbers = {"strain_energy_density": density, "volume": volumes, "interfaces": {}}
        result[str(zone)] = numbers
    if samples is not None:
        where = zones.at(samples.x)
        for i, contact in enumerate(problem.scene.contacts):
            for zone in zones.numbers:
                at = (samples.interface == i) & (where == zone).any(axis=1)
                if at.any():
                    result[str(zone)]["interfaces"][contact.name] = _interface(samples, at)
    return result


def _energy_and_volume(
    problem: Problem, stresses: Stresses, region: str, zones: Zones
) -> tuple[Floats, Floats]:
    """Strain energy [N mm] and volume [mm3] of a region by zone, zone 0 outside of all.

    By the points at which its stress is known: cells may span several zones.
    """
    x, volume = stresses.places(region)
    dx = volume.ravel()
    zone = zones.at(x) * zones.is_left(x)[:, None]
    local = np.array(
        [
            np.bincount(zone.ravel(), np.repeat(w, 2), minlength=len(zones.numbers) + 1)
            for w in (stresses.energy_density(region).ravel() * dx, dx)
        ]
    )
    energy, volume = problem.comm.allreduce(local, MPI.SUM)
    return energy, volume


def _interface(s: ContactSamples, at: NDArray[np.bool_]) -> dict[str, float]:
    """Motion and tractions of the marked points of an interface; means by area."""
    weight = s.weight[at]
    result: dict[str, float] = {}
    for name in ("gap", "slip", "motion", "pressure", "shear"):
        values = s.sizes[name][at].reshape(len(weight), -1).max(axis=1)
        result[f"{name}_max"] = float(values.max())
        result[f"{name}_mean"] = float(np.average(values, weights=weight))
    return result | {"area": float(weight.sum())}
