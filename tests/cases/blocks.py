"""Blocks on blocks: cases on boxes, and meshes of boxes made by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import permutations
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from app.foundation.arrays import Floats
from app.mechanics.contact import ContactInterfaces
from meshes.data import MeshData, exterior_facets, mesh_data_of
from meshes.distribute import TaggedMesh, distribute
from tests import support

BLOCKS = """\
geometry:
  kind: blocks
  blocks: [{name: lower, size: [4 mm, 4 mm, 4 mm]}, {name: upper, size: [4 mm, 4 mm, 4 mm]}]
mesh: {order: 1, size: 4 mm}
regions:
  lower: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}
interfaces:
  lower_upper: {kind: contact, friction_coefficient: 1.0}
supports:
  base: {kind: fixed, boundary: bottom}
loads:
  push: {kind: force, boundary: top, force: [3 N, 0 N, -4 N]}
  press: {kind: pressure, boundary: top, pressure: 2 MPa}
"""
# Held blocks with a gap that a second stage halves.
GAP = f"""{support.TWO_BLOCKS}regions:
  lower: {{youngs_modulus: 1000 MPa, poisson_ratio: 0.3}}
  upper: {{youngs_modulus: 500 MPa, poisson_ratio: 0.3}}
interfaces:
  lower_upper: {{kind: contact, friction_coefficient: 0.4, gap: 0.02 mm, gap_history: [1, 0.5]}}
supports:
  floor: {{kind: fixed, boundary: bottom}}
  lid: {{kind: fixed, boundary: top}}
stages: [{{name: first}}, {{name: second}}]
"""
# A bar of two halves, each 2 mm long on 16 mm2, without interface, supports and loads.
HALVES = """\
geometry: {kind: blocks, blocks: [{name: lower, size: [4 mm, 4 mm, 2 mm]},
                                  {name: upper, size: [4 mm, 4 mm, 2 mm]}]}
mesh: {order: 1, size: 2 mm}
regions:
  lower: {youngs_modulus: 2 GPa, poisson_ratio: 0, tissue: other}
  upper: {youngs_modulus: 1 GPa, poisson_ratio: 0, tissue: other}
"""
# A wall of two layers between a stove and air: 60 K over L1/k1 + 1/h + L2/k2 + 1/a, on 16 mm2.
WALL = """
geometry: {kind: blocks, blocks: [{name: hot, size: [4 mm, 4 mm, 5 mm]},
                                  {name: cold, size: [4 mm, 4 mm, 3 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions:
  hot:
    kind: conductor
    tissue: other
    thermal: &heat
      {conductivity: 2 W/(m K), density: 1000 kg/m^3, specific_heat: 1000 J/(kg K),
       initial_temperature: 37 degC}
  cold: {kind: conductor, tissue: other, thermal: {<<: *heat, conductivity: 0.5 W/(m K)}}
interfaces: {hot_cold: {kind: bonded, conductance: 400 W/(m^2 K)}}
heat:
  stove: {kind: temperature, boundary: bottom, temperature: 80 degC}
  air: {kind: convection, boundary: top, coefficient: 200 W/(m^2 K), ambient: 20 degC}
stages: [{name: rest, steady: true}]
"""
STACK = """
geometry: {kind: blocks, blocks: [{name: lower, size: [4 mm, 4 mm, 2 mm]},
                                  {name: upper, size: [4 mm, 4 mm, 2 mm]}]}
mesh: {size: 1 mm, order: 2}
regions:
  lower: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 2 GPa, poisson_ratio: 0.3}
interfaces: {lower_upper: {kind: contact, friction_coefficient: 0.3}}
supports: {floor: {kind: fixed, boundary: bottom}}
loads: {press: {kind: pressure, boundary: top, pressure: 2 MPa}}
stages: [{name: press}]
output: {error: true}
"""
PULLED = """
geometry: {kind: blocks, blocks: [{name: bar, size: [1 mm, 1 mm, 10 mm]}]}
mesh: {size: 1 mm}
regions: {bar: {youngs_modulus: [[2 mm, 100 MPa], [8 mm, 1 GPa]], poisson_ratio: 0, tissue: bone}}
supports: {floor: {kind: fixed, boundary: bottom}}
loads: {pull: {kind: pressure, boundary: top, pressure: -10 MPa}}
"""
# Bone below metal: pressed, then pushed, both from day to day.
REMODELLED = (
    support.TWO_BLOCKS
    + """
regions:
  lower: {youngs_modulus: 64 MPa, poisson_ratio: 0.3, tissue: bone}
  upper: {youngs_modulus: 2 GPa, poisson_ratio: 0.3}
interfaces:
  lower_upper: {kind: contact, friction_coefficient: 0.3}
supports:
  floor: {kind: fixed, boundary: bottom}
  bed: {kind: foundation, boundary: top, stiffness: 1 MPa/mm}
loads:
  press: {kind: pressure, boundary: top, pressure: 3 MPa}
  push: {kind: force, boundary: upper_x_max, force: [-9 N, 0 N, 0 N], history: [0, 1, 1, 0]}
stages:
  - {name: press}
  - {name: push, increments: 2}
  - {name: time, remodels: 3 s, increments: 2}
  - {name: release}
remodelling:
  law: {density: apparent, ranges: [[0 g/cm^3, 0 MPa, 100 MPa, 2]]}
  load_cases: [press, push]
  stimulus: 0.1 J/g
  rate: 6 g^2/(cm^6 MPa s)
  lazy_zone: 0.35
  density: [0.01 g/cm^3, 1.74 g/cm^3]
"""
)


def bar(layers: int) -> TaggedMesh:
    """Layers of one cuboid of six cells."""
    axes = np.meshgrid([0, 1], [0, 1], np.linspace(0, 10, layers + 1), indexing="ij")
    points, steps = np.stack(axes, axis=-1).reshape(-1, 3), [2 * layers + 2, layers + 1, 1]
    paths = np.cumsum([(0, *p) for p in permutations(steps)], axis=1)
    cells = (np.arange(layers)[:, None, None] + paths).reshape(-1, 4)
    facets, _ = exterior_facets(cells)
    ends = {k: (points[facets, 2] == z).all(axis=1) for k, z in (("bottom", 0), ("top", 10))}
    data = mesh_data_of(points, cells, np.ones(6 * layers), {"bar": 1}, {}, ends, facets)
    return distribute(data, MPI.COMM_WORLD)


Blocks = Callable[[Floats], NDArray[np.bool_]]


def box(blocks: dict[str, Any], size: Sequence[float], cells: Sequence[int]) -> MeshData:
    """A box of blocks. Each cube is six tetrahedra about a diagonal."""
    axes = [np.linspace(0, s, n + 1) for s, n in zip(size, cells, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    shape = [n + 1 for n in cells]
    starts = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, 3)
    tets = []
    for order in permutations(range(3)):
        corner = [starts]
        for axis in order:
            corner.append(corner[-1] + np.eye(3, dtype=int)[axis])
        if np.linalg.det(np.eye(3)[list(order)]) < 0:
            corner[1], corner[2] = corner[2], corner[1]
        tets.append(np.stack([np.ravel_multi_index(tuple(c.T), shape) for c in corner], axis=1))
    tetrahedra = np.concatenate(tets)
    middle = points[tetrahedra].mean(axis=1)
    tags = np.zeros(len(tetrahedra), dtype=np.int32)
    for tag, inside in enumerate(blocks.values(), 1):
        tags[inside(middle)] = tag
    assert tags.all()
    faces = tetrahedra[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3)
    facets, facet_tags = [], []
    sides = {f"{'xyz'[axis]}{end}": (axis, end) for axis in range(3) for end in (0, 1)}
    boundaries: dict[str, tuple[int, ...]] = {}
    x = points[faces]
    low = x[:, :, 2].mean(axis=1) < size[2] / 2
    for name, (axis, end) in sides.items():
        on = (np.abs(x[:, :, axis] - end * size[axis]) < 1e-9).all(axis=1)
        for half, there in (("low", on & low), ("top", on & ~low)):
            if there.any():
                tag = len(facets) + 1
                facets.append(faces[there])
                facet_tags.append(np.full(there.sum(), tag, dtype=np.int32))
                boundaries[f"{half}_{name}"] = (tag,)
                boundaries[name] = (*boundaries.get(name, ()), tag)
    return MeshData(
        points=points,
        cells=tetrahedra,
        cell_tags=tags,
        facets=np.concatenate(facets),
        facet_tags=np.concatenate(facet_tags),
        regions={name: tag for tag, name in enumerate(blocks, 1)},
        boundaries=boundaries,
        interfaces={},
    )


# Torn from one side.
TORN = (
    *(f"geometry.blocks.{k}.size=[4 mm, 4 mm, 2 mm]" for k in (0, 1)),
    *("mesh.size=2 mm", "supports.pull.z=0.015 + 0.005 * (x - 2)"),
    *("stages.0.increments=2", "stages.0.fracture_step=0.1 N mm", "solver.tolerance=1e-12"),
)


def contact_of_blocks(*changes: str) -> ContactInterfaces:
    """Contact of the blocks with a gap, at rest."""
    problem, _ = support.assemble(support.case(GAP, *changes))
    assert problem.contact is not None
    return problem.contact
