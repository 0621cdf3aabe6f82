"""A case as an input file of CalculiX: mesh, materials, contact, supports, forces, steps.

The deck has a displacement node once for each body. Bonded interfaces need no ties. Forces are the
load vectors of mantle. Contact is SURFACE TO SURFACE: a penalty at the integration points of the
facets, with a stick slope.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from mpi4py import MPI

import basix
import numpy as np

from app.case.case import Case, LoadedCase
from app.foundation import files
from app.foundation.arrays import Floats, Ints
from app.laws.interface_laws import InterfaceLaw
from app.laws.loads import Load
from app.laws.materials import Elastic
from app.laws.values import amplitude
from app.mechanics.body_forms import IMAGE_DEGREE, BodyForms
from app.mechanics.external_forces import nodal_forces
from app.scene.bodies import (
    FacetCells,
    bodies_of,
    boundary_facets,
    cell_tags,
    facet_nodes,
    facets_between,
)
from app.scene.scene import build_scene
from app.schema.yaml_file import Fault
from app.system.timing import Timing
from meshes.data import MeshData
from meshes.distribute import distribute

# Pressure per penetration, and shear per slip of a sticking point, in place of exact contact
# [MPa/mm].
NORMAL_STIFFNESS = 1e4
TANGENTIAL_STIFFNESS = 1e3
# Relative range of Young's modulus that one material of the deck covers.
ALIKE = 0.02
# Number in basix of each node of a C3D10.
ORDER = [0, 1, 2, 3, 9, 6, 8, 7, 5, 4]
# Number in CalculiX of the face opposite each corner.
FACE = np.array([3, 4, 2, 1])


def write(case: LoadedCase, data: MeshData, path: Path) -> list[str]:
    """Write the deck of a case on its mesh; return notes on what the deck represents differently.

    Raises:
        InputError: The deck format lacks parts of the case; all are listed, each at its place.
    """
    case.file.raise_all(_refused(case.config))
    deck_text = "\n".join(_Deck(case.config, data).lines()) + "\n"
    files.write_bytes(path, deck_text.encode("ascii", "replace"))
    notes = [
        f"variation {v.name} is not in the file; set its keys by --set to write it"
        for v in case.variations
    ]
    for name, law in case.config.interfaces.items():
        normal, tangential = _stiffness(law)
        penalties = []
        if (normal, tangential) != law.layer:
            penalties.append(f"a penalty of {normal:g} MPa/mm")
        if law.layer is None:
            penalties.append(f"a stick slope of {tangential:g} MPa/mm")
        if law.is_contact and penalties:
            text = f"contact is exact in mantle, and has {' and '.join(penalties)} in the file"
            notes.append(f"interfaces.{name}: {text}")
    notes += [
        f"regions.{name}: in the file E is the mean over each cell, to {ALIKE / 2:.0%}"
        for name, e in case.config.regions.items()
        if e.deforms is True and e.varies
    ]
    return notes


def _stiffness(law: InterfaceLaw) -> tuple[float, float]:
    """Pressure per penetration and shear per slip of a law in the file [MPa/mm]."""
    if law.layer is None:
        return NORMAL_STIFFNESS, TANGENTIAL_STIFFNESS
    normal, tangential = law.layer
    return normal if math.isfinite(normal) else NORMAL_STIFFNESS, tangential


def _refused(case: Case) -> list[Fault]:
    faults: list[Fault] = []

    def refuse(what: str, *at: str | int) -> None:
        faults.append(Fault(at, f"an .inp file of CalculiX cannot represent {what}"))

    for name, region in case.regions.items():
        if region.deforms is False:
            refuse(f"a region that is {type(region).__name__.lower()}", "regions", name)
        elif region.eigenstrains:
            refuse("eigenstrains", "regions", name)
        if region.thermal is not None:
            refuse("heat", "regions", name, "thermal")
    for name, law in case.interfaces.items():
        if law.kind not in ("bonded", "contact", "penalty"):
            refuse(f"the law {law.kind}", "interfaces", name)
        elif law.has_initial_gap:
            refuse("a gap or an interference", "interfaces", name)
        elif law.zone_heights:
            refuse("zones", "interfaces", name, "zones")
        if name in case.sliding_boundaries:
            refuse("finite sliding", "interfaces", name, "sliding")
    for name, support in case.supports.items():
        if support.is_spring is True or support.normal is not None:
            refuse("springs to the ground, and rollers along a normal", "supports", name)
    for k, stage in enumerate(case.stages):
        if stage.cycles > 1:
            refuse("cycles", "stages", k, "cycles")
    return faults


class _Deck:
    def __init__(self, case: Case, data: MeshData) -> None:
        self.case, self.scene = case, build_scene(case)
        self.tagged = distribute(data, MPI.COMM_SELF)
        self.bodies = bodies_of(self.tagged, self.scene.parting_interfaces, ())
        self.forms = BodyForms(self.scene, self.tagged, self.bodies, Timing())
        self.space, self.tags = self.forms.space, cell_tags(self.tagged)
        keys = self._keys(self.space.dofmap.list, self.tags)
        self.nodes, self.cells = np.unique(keys, return_inverse=True)
        self.cells = self.cells.reshape(keys.shape)[:, ORDER[: keys.shape[1]]] + 1

    def _keys(self, dofs: Ints, tags: Ints) -> Ints:
        """One number for each pair of node and body; dofs (n, k) in cells with tags (n,)."""
        return (
            dofs.astype(np.int64) * len(self.bodies.names) + self.bodies.body_of_tag[tags][:, None]
        )

    def lines(self) -> Iterator[str]:
        """Lines of the deck."""
        yield f"*HEADING\n{self.case.title or 'mantle'}; mm, N, MPa\n*NODE, NSET=ALL"
        x = self.space.tabulate_dof_coordinates()[self.nodes // len(self.bodies.names)]
        yield from (f"{k + 1}, {_real(*x[k])}" for k in range(len(x)))
        for e in self.scene.elastic:
            yield f"*ELEMENT, TYPE=C3D{self.cells.shape[1]}, ELSET={e.region}"
            rows = np.flatnonzero(self.tags == self.tagged.regions[e.region])
            yield from (f"{k + 1}, " + ", ".join(map(str, self.cells[k])) for k in rows)
            yield from self._varying(e, rows) if e.varies else _material(e)
        for name in self.tagged.boundaries:
            yield from self._surface(name, boundary_facets(self.tagged, name))
        for i in self.scene.parting_interfaces:
            sides = (("slave", i.slave, i.master), ("master", i.master, i.slave))
            for side, inside, outside in sides:
                f = facets_between(self.tagged, inside, outside)
                yield from self._surface(f"{i.name}_{side}", f)
            normal, tangential = _stiffness(i.law)
            yield f"*SURFACE INTERACTION, NAME={i.name}"
            yield f"*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n{_real(normal)}"
            if i.law.largest_friction:
                yield f"*FRICTION\n{_real(i.law.largest_friction, tangential)}"
            yield f"*CONTACT PAIR, INTERACTION={i.name}, TYPE=SURFACE TO SURFACE"
            yield f"{i.name}_slave, {i.name}_master"
        forces = [(load.history, self._forces(load)) for load in self.scene.loads]
        for k, stage in enumerate(self.scene.stages):
            yield f"** {stage.name}\n*STEP, INC=1000\n*STATIC\n{_real(1 / stage.increments, 1.0)}"
            yield from self._supports(k)
            total = sum(amplitude(h, k + 1) * f for h, f in forces) + np.zeros((len(x), 3))
            yield "*CLOAD, OP=NEW"
            for node, c in np.argwhere(total):
                yield f"{node + 1}, {c + 1}, {_real(total[node, c])}"
            yield "*NODE FILE\nU, RF\n*EL FILE\nS"
            if self.scene.parting_interfaces:
                yield "*CONTACT FILE\nCDIS, CSTR"
            yield "*END STEP"

    def _varying(self, e: Elastic, rows: Ints) -> Iterator[str]:
        """Sets of a region's cells (n,) with nearly equal mean moduli, and their materials."""
        _, ν = e.engineering_constants
        rule = basix.make_quadrature(basix.CellType.tetrahedron, IMAGE_DEGREE)
        points, weights = (np.asarray(a) for a in rule)
        relative_moduli = self.forms.relative_stiffness(e, points)
        E = e.moduli[0] * (
            relative_moduli @ weights / weights.sum()
            if relative_moduli.shape[1] > 1
            else relative_moduli[:, 0]
        )
        step = np.round(np.log(E) / ALIKE).astype(int)
        for k in np.unique(step):
            name = f"{e.region}_{k}"
            yield f"*ELSET, ELSET={name}"
            yield from (f"{row + 1}," for row in rows[step == k])
            yield f"*MATERIAL, NAME={name}\n*ELASTIC\n{_real(math.exp(ALIKE * k), ν)}"
            yield f"*SOLID SECTION, ELSET={name}, MATERIAL={name}"

    def _surface(self, name: str, f: FacetCells) -> Iterator[str]:
        yield f"*SURFACE, NAME={name}, TYPE=ELEMENT"
        yield from (f"{c + 1}, S{s}" for c, s in zip(f.cells, FACE[f.local], strict=True))

    def _forces(self, load: Load) -> Floats:
        """Forces on the nodes at full amplitude (n, 3) [N]."""
        forces: Floats = np.zeros((len(self.nodes), 3))
        for body, vector in nodal_forces(load, self.forms).items():
            of_dof = vector.array_r.reshape(-1, 3)
            dofs = np.flatnonzero(of_dof.any(axis=1))
            positions = np.searchsorted(self.nodes, dofs * len(self.bodies.names) + body)
            forces[positions] = of_dof[dofs]
        return forces

    def _supports(self, stage: int) -> Iterator[str]:
        """Lines on the components that supports hold in a stage.

        If several supports hold a component, the last one gives its displacement.
        """
        prescribed: dict[tuple[int, int], float] = {}
        for s in self.scene.supports:
            if not self.scene.is_active(s, stage):
                continue
            f = boundary_facets(self.tagged, s.boundary)
            dofs = facet_nodes(self.tagged, self.space, f)[1]
            keys = np.unique(self._keys(dofs, self.tags[f.cells]))
            x = self.space.tabulate_dof_coordinates()[keys // len(self.bodies.names)]
            u = s.values(x) * amplitude(s.history, stage + 1)
            node = np.searchsorted(self.nodes, keys) + 1
            for c in np.flatnonzero(s.components):
                prescribed |= dict(zip(((int(n), c + 1) for n in node), u[:, c], strict=True))
        yield "*BOUNDARY, OP=NEW"
        yield from (f"{n}, {c}, {c}, {_real(u)}" for (n, c), u in sorted(prescribed.items()))


def _real(*values: float) -> str:
    """Numbers as text, of which CalculiX reads 20 characters each."""
    return ", ".join(f"{value:.12e}" for value in values)


def _material(e: Elastic) -> Iterator[str]:
    """Constants of a region; the fibre is the first axis of its orientation, or the second."""
    yield f"*MATERIAL, NAME={e.region}"
    section = f"*SOLID SECTION, ELSET={e.region}, MATERIAL={e.region}"
    if e.fibre is None:
        yield f"*ELASTIC\n{_real(*e.engineering_constants)}\n{section}"
        return
    modulus_along, modulus_across, ν, ν_t, μ = e.engineering_constants
    μ_t = modulus_across / (2 * (1 + ν_t))
    constants = [modulus_along, modulus_across, modulus_across, ν, ν, ν_t, μ, μ, μ_t]
    if e.fibre.kind == "circumferential":
        constants = [
            modulus_across,
            modulus_along,
            modulus_across,
            ν * modulus_across / modulus_along,
            ν_t,
            ν,
            μ,
            μ_t,
            μ,
        ]
    yield "*ELASTIC, TYPE=ENGINEERING CONSTANTS"
    yield f"{_real(*constants[:8])},\n{_real(constants[8])}"
    axis = np.array(e.fibre.axis)
    if not e.fibre.curved:
        second_axis = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        yield f"*ORIENTATION, NAME={e.region}, SYSTEM=RECTANGULAR\n{_real(*axis, *second_axis)}"
    else:
        axis_points = [*e.fibre.through, *(e.fibre.through + axis)]
        yield f"*ORIENTATION, NAME={e.region}, SYSTEM=CYLINDRICAL\n{_real(*axis_points)}"
    yield f"{section}, ORIENTATION={e.region}"
