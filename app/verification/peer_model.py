"""A case as plain arrays that any finite element program can be given, and what contact is in them.

First order, linear isotropic elasticity, fixed supports, forces spread evenly, contact with
Coulomb friction, one step. Nodes on an interface are there once for each body, so that the
displacement of the nodes is all that is needed to compare programs: `contact_numbers` takes slip
and penetration from it, of whichever program.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import meshes
from app.arrays import Bools, Floats, Ints
from app.case.case import Case, load
from app.errors import InputError
from app.laws.interface_laws import Bonded, Contact
from app.laws.loads import Fixed, Force
from app.laws.materials import Isotropic
from app.results.percentiles import SurfaceField
from app.system import folders
from meshes.data import (
    MeshData,
    distinct,
    exterior_facets,
    facet_areas,
    interface_facets,
)

# A node with a larger gap is open, and does not slip [mm]. Where contact is enforced between the
# nodes of facets that are not quite parallel to the slip, nodes are some micrometres apart.
OPEN = 0.01


@dataclass(frozen=True)
class PeerInterface:
    """A contact interface: the same facets as seen by either body.

    Attributes:
        name: Its name.
        friction: Coulomb's coefficient.
        first: Nodes of the facets on the first body, outward from it (k, 3).
        second: Their copies on the second body, in the same order (k, 3).
        first_cells: Cell of each facet on the first body (k,).
        second_cells: Cell of each facet on the second body (k,).
    """

    name: str
    friction: float
    first: Ints
    second: Ints
    first_cells: Ints
    second_cells: Ints

    def nodes(self) -> tuple[Ints, Ints]:
        """Its nodes on the first body and their copies on the second, each once (p,)."""
        nodes, where = np.unique(self.first, return_index=True)
        return nodes, self.second.ravel()[where]


@dataclass(frozen=True)
class PeerModel:
    """A case as arrays.

    Attributes:
        points: Nodes (n, 3) [mm].
        cells: Nodes of the tetrahedra, of positive volume (m, 4).
        region: Region of each cell, from 0 (m,).
        body: Body of each cell, from 0: regions that are bonded are one (m,).
        young: Young's modulus of each region [MPa].
        poisson: Poisson's ratio of each region.
        fixed: Nodes that do not move.
        forces: Force at each node (n, 3) [N].
        interfaces: The contact interfaces.
    """

    points: Floats
    cells: Ints
    region: Ints
    body: Ints
    young: Floats
    poisson: Floats
    fixed: Ints
    forces: Floats
    interfaces: tuple[PeerInterface, ...]

    @property
    def unknowns(self) -> int:
        """Components of displacement."""
        return self.points.size

    def normals(self, interface: PeerInterface) -> Floats:
        """Unit normals at the nodes of an interface, outward from the first body (p, 3).

        Means of those of the facets around each node by area.
        """
        x = self.points[interface.first]
        twice = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        nodes, corner = np.unique(interface.first, return_inverse=True)
        sums = np.zeros((len(nodes), 3))
        np.add.at(sums, corner.ravel(), np.repeat(twice, 3, axis=0))
        return np.asarray(sums / np.linalg.norm(sums, axis=1, keepdims=True))


def build(path: Path, overrides: tuple[str, ...] = ()) -> PeerModel:
    """The arrays of a case, on the mesh that mantle solves it on.

    Args:
        path: The case file.
        overrides: As after ``--set``.

    Raises:
        InputError: The case is wrong, or has something that other programs are not given.
        GeometryError: It cannot be meshed.
    """
    case = load(path, overrides).config
    refuse(case)
    data = meshes.build(case.geometry, case.mesh, folders.cache("meshes"))
    tags = np.array([data.regions[name] for name in case.regions])
    region = np.argmax(data.cell_tags[:, None] == tags, axis=1)
    contacts = {n: law for n, law in case.interfaces.items() if isinstance(law, Contact)}
    names = list(data.regions)
    own = np.array([names.index(name) for name in case.regions])
    body = _bodies(data, contacts)[own][region]
    count = int(body.max()) + 1
    pairs, cells = distinct((data.cells * count + body[:, None]).ravel())
    node = pairs // count

    def copies(nodes: Ints, cell: Ints) -> Ints:
        return np.searchsorted(pairs, nodes * count + body[cell][:, None])

    facets, behind = _exterior(data)
    fixed: list[Ints] = []
    for support in case.supports.values():
        here = np.isin(data.facet_tags, data.boundaries[support.boundary])
        fixed.append(copies(facets[here], behind[here]).ravel())
    forces = np.zeros((len(pairs), 3))
    for push in case.loads.values():
        here = np.isin(data.facet_tags, data.boundaries[push.place[1]])
        area = facet_areas(data.points, facets[here])
        share = np.repeat(area / area.sum() / 3, 3)
        at = copies(facets[here], behind[here]).ravel()
        np.add.at(forces, at, share[:, None] * np.array(push.resultant))
    interfaces = []
    for name, law in contacts.items():
        nodes, one, two = interface_facets(data, name)
        if np.any(body[one] == body[two]):
            raise InputError(f"interfaces.{name}: its sides are one body elsewhere")
        first, second = copies(nodes, one), copies(nodes, two)
        interfaces.append(PeerInterface(name, law.friction_coefficient, first, second, one, two))
    solids = [case.regions[name] for name in case.regions]
    return PeerModel(
        points=data.points[node],
        cells=cells.reshape(-1, 4),
        region=region,
        body=body,
        young=np.array([s.youngs_modulus for s in solids]),  # type: ignore[union-attr]
        poisson=np.array([s.poisson_ratio for s in solids]),  # type: ignore[union-attr]
        fixed=np.unique(np.concatenate(fixed)),
        forces=forces,
        interfaces=tuple(interfaces),
    )


def refuse(case: Case) -> None:
    """Refuse what other programs are not given.

    Raises:
        InputError: All that there is of it.
    """
    faults = []
    if case.mesh.order != 1:
        faults.append("mesh.order: other programs are given first order alone; expected 1")
    if case.heat or case.conducts or len(case.stages) != 1:
        faults.append("stages: other programs are given one stage without heat")
    for name, region in case.regions.items():
        if not isinstance(region, Isotropic) or region.eigenstrains:
            faults.append(f"regions.{name}: expected kind: isotropic, without eigenstrains")
    for name, law in case.interfaces.items():
        plain = isinstance(law, Contact) and not law.gap
        if not (plain or isinstance(law, Bonded)):
            faults.append(f"interfaces.{name}: expected kind: contact without a gap, or bonded")
    for name, support in case.supports.items():
        if not isinstance(support, Fixed):
            faults.append(f"supports.{name}: expected kind: fixed")
    for name, push in case.loads.items():
        if not isinstance(push, Force) or push.at is not None or push.history:
            faults.append(f"loads.{name}: expected kind: force, without at and history")
    if not any(isinstance(law, Contact) for law in case.interfaces.values()):
        faults.append("interfaces: none of kind: contact")
    if faults:
        raise InputError(faults)


def _bodies(data: MeshData, contacts: Mapping[str, object]) -> Ints:
    """Body of each region in the mesh's order: those that touch are one, unless in contact."""
    row = {tag: k for k, tag in enumerate(data.regions.values())}
    apart = {
        frozenset((row[data.regions[a]], row[data.regions[b]]))
        for name in contacts
        for a in data.interfaces[name][0]
        for b in data.interfaces[name][1]
    }
    cell, _, behind = data.between
    found = np.arange(len(row))
    for a, b in np.unique(np.stack([data.cell_tags[cell], data.cell_tags[behind]], 1), axis=0):
        one, two = row[int(a)], row[int(b)]
        if frozenset((one, two)) not in apart:
            found[found == found[two]] = found[one]
    return np.asarray(np.unique(found, return_inverse=True)[1].ravel(), dtype=np.int64)


def _exterior(data: MeshData) -> tuple[Ints, Ints]:
    """The tagged facets and the cell of each."""
    outside, cell = exterior_facets(data.cells)
    n = len(data.points)
    sides = (np.sort(nodes, axis=1) for nodes in (outside, data.facets))
    keys = [(f[:, 0] * n + f[:, 1]) * n + f[:, 2] for f in sides]
    by = np.argsort(keys[0])
    return data.facets, cell[by[np.searchsorted(keys[0][by], keys[1])]]


def contact_numbers(
    model: PeerModel, displacement: Floats, open_from: float = OPEN
) -> dict[str, dict[str, float]]:
    """Slip and penetration of each interface by its name, from the displacement of the nodes.

    Args:
        model: The model.
        displacement: Of its nodes (n, 3) [mm].
        open_from: Gap from which a node is open [mm].

    Returns:
        Of each interface ``slip_mean`` and ``slip_p99``, the mean by area and the percentile of
        the tangential jump where it is closed, ``penetration``, the largest at a node, and
        ``open``, the largest gap [mm].
    """
    found = {}
    for interface in model.interfaces:
        first, second = interface.nodes()
        normals = model.normals(interface)
        jump = displacement[second] - displacement[first]
        gap = np.einsum("pi,pi->p", jump, normals)
        closed: Bools = gap <= open_from
        slip = np.linalg.norm(jump - gap[:, None] * normals, axis=1) * closed
        corners = np.searchsorted(first, interface.first)
        field = SurfaceField(slip[corners], facet_areas(model.points, interface.first))
        found[interface.name] = {
            "slip_mean": field.mean(),
            "slip_p99": field.percentile(),
            "penetration": float(max(0.0, -gap.min())),
            "open": float(max(0.0, gap.max())),
        }
    return found
