"""Numbers of a hip: motion of stem and head, strain of the cortex, and numbers by Gruen zone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from app.case.case import Case
from app.case.femurs import IntactFemur
from app.case.hips import ON_CUT
from app.case.quantities import GAUGES
from app.case.summary import Numbers, Zone
from app.foundation.arrays import Floats, Ints
from app.mechanics.body_forms import shape_functions_in_cells
from app.mechanics.contact import TrialState
from app.mechanics.problem import Problem
from app.results.interface_numbers import ContactSamples
from app.results.stresses import Stresses
from app.scene import bodies
from app.stepping.load_steps import LoadStep, OnStep
from meshes.geometry import is_hip
from meshes.gruen import Zones

# Fraction of the length of the stem within which a node belongs to its end [-].
END_FRACTION = 1e-6
# Interfaces of a stem and its collar.
ON_STEM = ("stem_cement", "stem_bone", ON_CUT)
# Numbers of the two ends of a stem.
ENDS = ("tip_displacement", "top_displacement")


class StemMotion:
    """Motion of the implant; created and called collectively. Empty without implant or bone.

    ``subsidence`` [mm] (distal, -z), ``retroversion`` and ``varus`` [deg] are components of a rigid
    motion. It is fitted, weighted by area, to the motion of the stem's surface relative to the
    nearest surface of bone. Both are the surfaces that face cement, or each other without cement.
    So the neck, and the rigid motion and bending of the femur, have no effect. Retroversion rotates
    the medial side towards posterior, varus tilts the top towards medial. `Case.side` determines
    the medial direction.

    After a press fit this motion counts from the end of the insertion, as micromotion does.
    ``insertion_subsidence`` [mm] is the motion before: a stem that grows in its bed rises.

    ``tip_displacement`` and ``top_displacement`` (3,) [mm] are displacements of the stem's lowest
    and highest nodes. They are in the frame of the model and include the bending of the femur.
    """

    saved = ("at_insertion",)

    def __init__(self, problem: Problem, case: Case) -> None:
        self._problem = problem
        self.at_insertion: Numbers = {}
        regions = problem.tagged.regions
        implant, bone, cement = (
            [r for r in case.of_tissue(t) if r in regions] for t in ("implant", "bone", "cement")
        )
        self._ends = _ends(problem, implant) if implant and bone else []
        self._nearest: Ints | None = None
        if not self._ends:
            return
        self._stem, self._facing = (
            facet_surface(problem, bodies.facets_between(problem.tagged, inside, outside))
            for inside, outside in ((implant, [*cement, *bone]), (bone, [*cement, *implant]))
        )
        if len(self._stem.x) and len(self._facing.x):
            from scipy.spatial import cKDTree  # takes 0.1 s; most runs do not need it

            self._nearest = cKDTree(self._facing.x).query(self._stem.x)[1]

    def __call__(self, side: str) -> Numbers:
        """Return the numbers of a hip of side ``left`` or ``right``."""
        u, comm = nodal_displacements(self._problem), self._problem.comm
        numbers: Numbers = {}
        for end, (body, rows, counted_rows) in zip(ENDS, self._ends, strict=False):
            end_displacements = np.concatenate(comm.allgather(u[body, rows]))
            numbers[end] = [float(c) for c in end_displacements[counted_rows].mean(axis=0)]
        if self._nearest is None:
            return numbers
        motion = self._motion(u, self._nearest)
        if self.at_insertion:
            numbers["insertion_subsidence"] = self.at_insertion["subsidence"]
            motion = {key: value - self.at_insertion[key] for key, value in motion.items()}
        if side == "right":
            motion |= {key: -motion[key] for key in ("retroversion", "varus")}
        return motion | numbers

    def before(self, on_step: OnStep) -> OnStep:
        """Return a hook of steps that keeps the motion at the end of the insertion."""

        def step(accepted: LoadStep, trial: TrialState | None) -> None:
            contact = self._problem.contact
            if contact is not None and contact.gaps.is_inserting and self._nearest is not None:
                self.at_insertion = self._motion(nodal_displacements(self._problem), self._nearest)
            on_step(accepted, trial)

        return step

    def _motion(self, u: Floats, nearest: Ints) -> Numbers:
        """Return the rigid motion of a left stem, from nodal displacements; collective."""
        # The rigid motion of all bone is subtracted first, because it moves a point of the stem and
        # the nearest point of bone differently. The deformation of bone is that of this point.
        stem, bone = self._stem, self._facing
        bone_motion = bone.mean_motion(u)
        v = (
            stem.mean_motion(u)
            - bone_motion[nearest]
            - np.cross(bone.rotation(bone_motion), stem.x - bone.x[nearest])
        )
        t = np.average(v, axis=0, weights=stem.area)
        ω = np.rad2deg(stem.rotation(v))
        motion = {"subsidence": -t[2], "retroversion": -ω[2], "varus": ω[1]}
        return {key: float(value) for key, value in motion.items()}


@dataclass(frozen=True)
class FacetSurface:
    """Facets of all ranks.

    Attributes:
        comm: Their ranks.
        x: Centres (f, 3) [mm].
        area: Areas (f,) [mm2].
        nodes: Body and nodes of this rank's facets.
    """

    comm: MPI.Comm
    x: Floats
    area: Floats
    nodes: tuple[Ints, Ints]

    def mean_motion(self, u: Floats) -> Floats:
        """Return displacements of the centres (f, 3) [mm] from nodal ones; collective."""
        return np.concatenate(self.comm.allgather(u[self.nodes].mean(axis=1)))

    def rotation(self, u: Floats) -> Floats:
        """Fit a small rotation (3,) [rad] to displacements of the centres, weighted by area."""
        ξ = self.x - np.average(self.x, axis=0, weights=self.area)
        second_moment = np.einsum("p,pi,pj->ij", self.area, ξ, ξ)
        inertia = np.trace(second_moment) * np.eye(3) - second_moment
        return np.linalg.solve(inertia, self.area @ np.cross(ξ, u))


def facet_surface(problem: Problem, f: bodies.FacetCells) -> FacetSurface:
    """Return facets with their cells, on all ranks."""
    corners = bodies.facet_coordinates(problem.tagged, f)[0][:, :3]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    dofs = problem.space.dofmap.list[f.cells][:, :4]
    dofs = np.take_along_axis(dofs, bodies.FACET_NODES[f.local, :3], axis=1)
    body = problem.bodies.body_of_tag[bodies.cell_tags(problem.tagged)[f.cells]]
    local = corners.mean(axis=1), np.linalg.norm(normal, axis=1) / 2
    x, area = (np.concatenate(problem.comm.allgather(part)) for part in local)
    return FacetSurface(problem.comm, x, area, (body[:, None], dofs))


def _ends(problem: Problem, implant: Sequence[str]) -> list[tuple[Ints, Ints, Ints]]:
    """Nodes at the lower and the upper end of some regions; collective.

    For each end: body and local dof of the nodes on this rank, and rows of the nodes gathered from
    all ranks without those that occur twice.
    """
    comm = problem.comm
    cells = {r: problem.body_forms.region_cells(r) for r in implant}
    dofs_of = {r: np.unique(problem.space.dofmap.list[c][:, :4]) for r, c in cells.items()}
    dofs = np.concatenate(list(dofs_of.values()))
    body_of_region = problem.bodies.body_of_region
    body = np.concatenate([np.full(len(rows), body_of_region[r]) for r, rows in dofs_of.items()])
    x = problem.space.tabulate_dof_coordinates()[dofs]
    lowest = comm.allreduce(float(x[:, 2].min(initial=np.inf)), MPI.MIN)
    highest = comm.allreduce(float(x[:, 2].max(initial=-np.inf)), MPI.MAX)
    end_length = END_FRACTION * (highest - lowest)
    end_nodes = []
    for z in (lowest, highest):
        is_near = np.abs(x[:, 2] - z) <= end_length
        near_points = np.concatenate(comm.allgather(x[is_near]))
        # Ranks and regions share nodes; each node is counted once.
        first_rows = np.unique(np.round(near_points / end_length), axis=0, return_index=True)[1]
        end_nodes.append((body[is_near], dofs[is_near], first_rows))
    return end_nodes


def nodal_displacements(problem: Problem) -> Floats:
    """Return displacements of all bodies at all nodes of this rank (bodies, n, 3) [mm]."""
    return np.stack([f.x.array.reshape(-1, 3) for f in problem.displacements()])


# Head and cortex

# Standard deviation of the weights of the fit to the strain, in every direction [mm].
GAUGE_RADIUS = 5.0


def of_femur(problem: Problem, case: Case) -> Numbers:
    """Return the motion of a femur's head and the axial strain of its cortex; collective.

    ``head_displacement`` (3,) [mm] is the mean over the head, or over the end of the neck.
    ``strain_lateral_10`` and others [-] are strains on the outer surface of the bone at the levels
    of `GAUGES`, by a fit to the strain nearby. Levels without bone have no number. The result
    is empty for other bodies than femora.
    """
    geometry = case.geometry
    elastic = {e.region for e in problem.scene.elastic}
    bone = elastic.intersection(case.of_tissue("bone"))
    if not is_hip(geometry) or "cortical_bone" not in bone:
        return {}
    head_boundary = "head" if isinstance(geometry, IntactFemur) else "stem_trunnion"
    head = facet_surface(problem, bodies.boundary_facets(problem.tagged, head_boundary))
    bone_facets = bodies.boundary_facets(problem.tagged, "bone_surface")
    outside = facet_surface(problem, bone_facets)
    strain = np.concatenate(problem.comm.allgather(_axial_strain(problem, bone_facets)))
    head_motion = head.mean_motion(nodal_displacements(problem))
    numbers: Numbers = {
        "head_displacement": np.average(head_motion, axis=0, weights=head.area).tolist()
    }
    for side, direction in (("lateral", -1.0), ("medial", 1.0)):
        for name, z in GAUGES.items():
            x, y, height = (outside.x - [0.0, 0.0, z]).T
            weight = (
                outside.area
                * np.exp(-(height**2 + y**2) / (2 * GAUGE_RADIUS**2))
                * (direction * x > 0)
            )
            if z - 2 * GAUGE_RADIUS > geometry.level:
                root = np.sqrt(weight)
                terms = np.stack([np.ones(len(x)), height, y, y * y], axis=1)
                coefficients = np.linalg.lstsq(root[:, None] * terms, root * strain)[0]
                numbers[f"strain_{side}_{name}"] = float(coefficients[0])
    return numbers


def _axial_strain(problem: Problem, facets: bodies.FacetCells) -> Floats:
    """Return the strain along z at the centres of facets, in their cells of bone (f,) [-]."""
    centres = np.vstack([np.zeros(3), np.eye(3)])[bodies.FACET_NODES[:, :3]].mean(axis=1)
    _, gradients = shape_functions_in_cells(problem.space, facets.cells, centres[facets.local])
    u = nodal_displacements(problem)[problem.bodies.body_of_region["cortical_bone"]]
    nodal = u[problem.space.dofmap.list[facets.cells]]
    return np.einsum("fk,fk->f", gradients[:, 2], nodal[:, :, 2])


# Collar


def of_collar(case: Case, interfaces: Mapping[str, Numbers]) -> Numbers:
    """Return forces on the bone along the stem; empty without a collar.

    ``collar_force`` is that of the collar [N], ``flank_force`` that of the flanks if these are not
    bonded [N]. ``collar_share`` is the collar's fraction of both [-]; no fraction if one of them
    pulls.
    """
    geometry = case.geometry
    if ON_CUT not in interfaces or not is_hip(geometry):
        return {}
    axis = geometry.placement.rotation[:, 2]
    force_along_stem = {
        name: float(-axis @ q["force"]) for name, q in interfaces.items() if name in ON_STEM
    }
    collar = force_along_stem.pop(ON_CUT)
    numbers: Numbers = {"collar_force": collar}
    if force_along_stem:
        flanks = sum(force_along_stem.values())
        numbers["flank_force"] = flanks
        if min(collar, flanks) >= 0.0 < collar + flanks:
            numbers["collar_share"] = collar / (collar + flanks)
    return numbers


# Gruen zones

# Fraction of the bone of a zone below which a region has no numbers in the zone. Such a region is a
# remnant of cancellous bone between cement and cortex.
LEAST_SHARE = 0.01


def by_zone(
    problem: Problem, stresses: Stresses, samples: ContactSamples | None, zones: Zones
) -> dict[str, Zone]:
    """Return the numbers of each zone; collective.

    Returns:
        For each zone: ``volume`` [mm3] of the bone that the operation leaves,
        ``strain_energy_density`` [MPa], its mean over this volume, and ``interfaces``, the numbers
        of interfaces within the zone. Bones and interfaces outside a zone have no entry.
    """
    # A rigid region has no strain energy, and that of a path-dependent region is unknown.
    elastic = {e.region for e in problem.scene.elastic} - problem.body_forms.path_dependent_regions
    regions = [r for r in zones.regions if r in elastic]
    sums = {
        r: zone_integrals(problem, stresses, r, zones, stresses.energy_density(r), 1.0)
        for r in regions
    }
    numbers_of_zone: dict[str, Zone] = {}
    for zone in zones.numbers:
        volumes = {r: float(volume[zone]) for r, (_, volume) in sums.items()}
        volumes = {r: v for r, v in volumes.items() if v > LEAST_SHARE * sum(volumes.values())}
        density = {r: float(sums[r][0][zone]) / v for r, v in volumes.items()}
        numbers_of_zone[str(zone)] = {
            "strain_energy_density": density,
            "volume": volumes,
            "interfaces": {},
        }
    if samples is not None:
        zones_of_points = zones.zones_at(samples.x) * zones.touches(samples.x)[:, None]
        for i, interface in enumerate(problem.scene.parting_interfaces):
            for zone in zones.numbers:
                in_zone = (samples.interface == i) & (zones_of_points == zone).any(axis=1)
                if in_zone.any():
                    numbers_of_zone[str(zone)]["interfaces"][interface.name] = _interface(
                        samples, i, in_zone
                    )
    return numbers_of_zone


def zone_integrals(
    problem: Problem, stresses: Stresses, region: str, zones: Zones, *densities: Floats | float
) -> Floats:
    """Return the integrals of densities (cells, points) over the zones of a region.

    The first one is outside all zones. The integrals use the points at which stress is known,
    because a cell may be in several zones.
    """
    x, volume = stresses.points_and_volumes(region)
    zone = zones.zones_at(x) * zones.is_left(x)[:, None]
    rows = (np.repeat((w * volume).ravel(), 2) for w in densities)
    count = len(zones.numbers) + 1
    local = np.array([np.bincount(zone.ravel(), row, minlength=count) for row in rows])
    return np.asarray(problem.comm.allreduce(local, MPI.SUM))


def _interface(s: ContactSamples, i: int, mask: NDArray[np.bool_]) -> dict[str, float]:
    """Return motion and tractions of the points ``mask`` of an interface; means are by area."""
    weight, tractions = s.weight[mask], s.tractions[i]
    numbers: dict[str, float] = {}
    names = ["gap", "slip", "motion", "pressure", "shear"]
    if s.interfaces[i].press_fit:
        names.append("micromotion")
    for name in names:
        value = mean = s.sizes[name].reshape(len(s.x), -1).max(axis=1)
        if name in tractions:
            value, mean = tractions[name].value, tractions[name].point_mean
        numbers[f"{name}_max"] = float(value[mask].max())
        numbers[f"{name}_mean"] = float(np.average(mean[mask], weights=weight))
    return numbers | {"area": float(weight.sum())}
