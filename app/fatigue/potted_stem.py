r"""Stress, deflection and life of a stem that is potted in resin and loaded at its head.

At the level of the resin the stem is a bar: the axial stress is linear over the section, and its
moments are linear along the stem,

.. math:: σ_{zz} = a + b x + c y + (z - z_0) (d + e x + f y) .

It is fitted to the stress in a band above the resin, weighted by volume. The fit gives the stress
of the section at z_0 without the peak at the rim of the resin, which has no limit on finer meshes.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from app.case.case import Case
from app.case.summary import Numbers
from app.fatigue.laws import level_of, stem_test_of
from app.foundation.arrays import Bools, Floats
from app.foundation.errors import InputError
from app.laws.values import ROUNDING_OF_HEIGHTS
from app.results.hip import facet_surface, nodal_displacements
from app.results.percentiles import percentile
from app.results.records import Record, RecordedModel
from app.results.stresses import Stresses
from app.scene import bodies

# Strength of the weakest 20th of the stems, in standard deviations from the mean.
WEAK = -1.645


class PottedStem(Record):
    """Numbers of section ``stem_test`` in the last state; made collectively.

    Raises:
        InputError: There is nothing of the stem just above the level of the resin.
    """

    def __init__(self, case: Case, followed: RecordedModel) -> None:
        test, level = stem_test_of(case), level_of(case)
        assert test is not None
        assert level is not None
        self._test = test
        self._level = level
        self._problem = followed.problem
        self._stresses = Stresses(followed.problem, fine=[test.region])
        height = self._stresses.points_and_volumes(test.region)[0][:, 2] - level
        is_in_band = bool(((height > 0) & (height <= test.band)).any())
        if not followed.problem.comm.allreduce(is_in_band, MPI.LOR):
            raise InputError(
                f"stem_test.level: region '{test.region}' has no cells within {test.band:g} mm"
                f" above {level:g} mm, where its stress is fitted; expected a level that the stem"
                " passes, or a wider band"
            )
        facets = bodies.boundary_facets(followed.problem.tagged, test.head)
        self._head = facet_surface(followed.problem, facets)
        loads = [load for load in case.loads.values() if test.head in load.boundaries]
        self._force = np.sum([load.resultant or (0.0, 0.0, 0.0) for load in loads], axis=0)
        points = [load.point for load in loads if load.point is not None]
        centre = np.average(self._head.x, axis=0, weights=self._head.area)
        self._centre = np.asarray(points[0]) if points else centre

    def numbers(self) -> dict[str, dict[str, Numbers]]:
        """Section ``stem_test``; collective."""
        stresses, region = self._stresses, self._test.region
        x, volume = stresses.points_and_volumes(region)
        σ = stresses.evaluate(region).reshape(-1, 3, 3)
        above = x[:, 2] - self._level
        is_free = above > self._test.band
        is_near_resin = (above > 0) & ~is_free
        level_stress = self._level_stress(x, volume.ravel(), σ[:, 2, 2], is_near_resin)
        tension = np.linalg.eigvalsh(σ[is_free])[:, 2]
        tensions, weight = stresses.gather(np.stack([tension, volume.ravel()[is_free]]))
        free_tension = percentile(tensions, weight) if len(tensions) else 0.0
        decisive = max(level_stress, free_tension)
        numbers: Numbers = {
            "level_stress": level_stress,
            "free_tension_p99": free_tension,
            "free_tension_max": float(tensions.max(initial=0.0)),
            "deflection": self._deflection(),
            "life_median": self._test.life(decisive),
            "life_p05": self._test.life(decisive, WEAK),
            "failing": self._test.failing(decisive),
        }
        return {"stem_test": {region: numbers}}

    def _level_stress(
        self, x: Floats, volume: Floats, axial: Floats, is_near_resin: Bools
    ) -> float:
        """Largest axial stress of the section at the level of the resin; collective [MPa]."""
        rows = np.column_stack([axial, volume, x])[is_near_resin].T
        stress, weight, *place = self._stresses.gather(rows)
        centre = np.average(place[:2], axis=1, weights=weight)
        section_terms = np.column_stack(
            [np.ones(len(stress)), place[0] - centre[0], place[1] - centre[1]]
        )
        height = (place[2] - self._level)[:, None]
        by_volume = np.sqrt(weight)
        fit = np.hstack([section_terms, height * section_terms]) * by_volume[:, None]
        coefficients = np.linalg.lstsq(fit, stress * by_volume)[0][:3]
        nodes = self._section_nodes()
        section = np.column_stack([np.ones(len(nodes)), nodes[:, :2] - centre])
        return float((section @ coefficients).max())

    def _section_nodes(self) -> Floats:
        """Nodes of the stem on all ranks in the band above the resin (n, 3) [mm]; collective."""
        problem = self._problem
        cells = problem.body_forms.region_cells(self._test.region)
        dofs = np.unique(problem.space.dofmap.list[cells][:, :4])
        x = problem.space.tabulate_dof_coordinates()[dofs]
        above = x[:, 2] - self._level
        nodes_in_band = x[(above >= -ROUNDING_OF_HEIGHTS) & (above <= self._test.band)]
        return np.concatenate(problem.comm.allgather(nodes_in_band))

    def _deflection(self) -> float:
        """Displacement of the centre of the head along the force; collective [mm].

        The centre moves with the rigid motion that fits the boundary of the load best.
        """
        head_motion = self._head.mean_motion(nodal_displacements(self._problem))
        centre = np.average(self._head.x, axis=0, weights=self._head.area)
        mean = np.average(head_motion, axis=0, weights=self._head.area)
        at_head = mean + np.cross(self._head.rotation(head_motion), self._centre - centre)
        size = float(np.linalg.norm(self._force))
        return float(at_head @ self._force / size) if size else float(np.linalg.norm(at_head))
