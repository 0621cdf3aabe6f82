"""The reference body of a hip, by gmsh: a straight stack of rings about a core.

The cross-section is a polygon, the *core*, in rings between larger ones of the same shape; gmsh
triangulates the core, divides the rings and extrudes all of it in layers. A segment of layers may
end at an inner ring: the stem goes on alone above the neck cut. Each volume is in the physical
group of its region. `swept` makes an anatomy of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from scipy.spatial import cKDTree

from app.foundation.arrays import Floats, Ints
from meshes.gmsh_session import elements, grade, nodes, session

# Part of y that x is sheared by: mirrored cells would be cut by either diagonal equally well, and
# rounding would decide.
SHEAR = 0.03
COARSENING_OF_CORE = 2.0  # size inside the core over its edges
PRISM = 6  # gmsh's number of the type


@dataclass(frozen=True)
class Segment:
    """Layers with the same regions.

    Attributes:
        steps: Number of layers.
        regions: Region of the core and of each ring outwards; fewer where outer rings end.
    """

    steps: int
    regions: tuple[str, ...]


@dataclass(frozen=True)
class ReferenceBody:
    """Prisms on a grid of columns and stations.

    Columns are those of the first line from the core's edge outwards, of the second, ..., then
    those inside the core.

    Attributes:
        rho: Place of the columns of a line, that of the first surface at the edge of the core, then
            one more a ring (r,).
        weights: Columns inside the core as means of those at its edge (q, around).
        section: Section of the columns, before shearing (c, 2).
        columns: Columns of the prisms (p, 3).
        slab: Their layer (p,).
        region: Number of their region in `names` (p,).
        names: Regions.
    """

    rho: Floats
    weights: Floats
    section: Floats
    columns: Ints
    slab: Ints
    region: Ints
    names: tuple[str, ...]


def make(
    outline: Floats,
    through: Sequence[int],
    segments: Sequence[Segment],
    coarser: float = COARSENING_OF_CORE,
    first: int = 1,
) -> ReferenceBody:
    """Mesh the body.

    Args:
        outline: The core's corners, one a line, around 0 (around, 2) [mm].
        through: Cells through each ring, from the core outwards.
        segments: From the bottom up; the first has all rings.
        coarser: Size inside the core over its edges.
        first: Number of the surface at the edge of the core.
    """
    corners = outline + np.outer(outline[:, 1], [SHEAR, 0.0])
    names = tuple(dict.fromkeys(name for segment in segments for name in segment.regions))
    with session("reference body") as gmsh:
        _extruded(gmsh, corners, through, segments, names)
        edge = np.sqrt(((corners - np.roll(corners, 1, axis=0)) ** 2).sum(axis=1)).mean()
        grade(gmsh, (), coarser * edge, coarser * edge)
        gmsh.model.mesh.generate(3)
        x, row = nodes(gmsh)
        groups = [gmsh.model.getEntitiesForPhysicalGroup(3, k + 1) for k in range(len(names))]
        prisms = [elements(gmsh, PRISM, volumes, row) for volumes in groups]
    rho = np.concatenate(
        [
            [float(first)],
            *(first + ring + np.arange(1, k + 1) / k for ring, k in enumerate(through)),
        ]
    )
    scale = rho - first + 1.0
    lines = (scale[None, :, None] * corners[:, None]).reshape(-1, 2)
    lowest = x[np.round(x[:, 2]) == 0, :2]
    core_points = lowest[cKDTree(lines).query(lowest)[0] > 1e-6 * np.abs(corners).max()]
    core_points = core_points[np.lexsort(np.round(core_points, 6).T)]
    section = np.concatenate([lines, core_points])
    column = cKDTree(section).query(x[:, :2])[1]
    prism = np.concatenate(prisms)
    return ReferenceBody(
        rho=rho,
        weights=_mean_values(core_points, corners),
        section=section - np.outer(section[:, 1], [SHEAR, 0.0]),
        columns=column[prism[:, :3]],
        slab=np.round(x[prism[:, 0], 2]).astype(np.int64),
        region=np.repeat(np.arange(len(names)), [*map(len, prisms)]),
        names=names,
    )


def _extruded(
    gmsh: ModuleType,
    corners: Floats,
    through: Sequence[int],
    segments: Sequence[Segment],
    names: Sequence[str],
) -> None:
    """Draw the section, extrude it segment by segment, and group the volumes by region."""
    geo = gmsh.model.geo
    n, half_count = len(corners), (len(corners) + 1) // 2
    rings = [
        [geo.addPoint(*map(float, (ring * corner)), 0.0) for corner in corners]
        for ring in range(1, len(through) + 2)
    ]
    edges = [[geo.addLine(ring[i], ring[(i + 1) % n]) for i in range(n)] for ring in rings]
    faces = [[geo.addPlaneSurface([geo.addCurveLoop(edges[0])])]]
    for edge in np.ravel(edges):
        geo.mesh.setTransfiniteCurve(edge, 2)
    for k, cells in enumerate(through):
        ends = [0, half_count]
        rays = [geo.addLine(rings[k][i], rings[k + 1][i]) for i in ends]
        for ray in rays:
            geo.mesh.setTransfiniteCurve(ray, cells + 1)
        faces.append([])
        for side, part in enumerate((slice(half_count), slice(half_count, n))):
            outer = [-edge for edge in edges[k + 1][part][::-1]]
            loop = [*edges[k][part], rays[1 - side], *outer, -rays[side]]
            faces[-1].append(geo.addPlaneSurface([geo.addCurveLoop(loop)]))
            start, end = ends[side], ends[1 - side]
            quadrangle = [rings[k][start], rings[k][end], rings[k + 1][end], rings[k + 1][start]]
            geo.mesh.setTransfiniteSurface(faces[-1][-1], ("Left", "Right")[side], quadrangle)
    volumes: dict[str, list[int]] = {name: [] for name in names}
    for segment in segments:
        faces = faces[: len(segment.regions)]
        all_faces = [(2, face) for layer in faces for face in layer]
        extruded = geo.extrude(
            all_faces, 0, 0, segment.steps, numElements=[segment.steps], recombine=True
        )
        volume_rows = [k for k, (dim, _) in enumerate(extruded) if dim == 3]
        tops = iter([extruded[k - 1][1] for k in volume_rows])
        bodies = iter([extruded[k][1] for k in volume_rows])
        for name, layer in zip(segment.regions, faces, strict=True):
            volumes[name] += [next(bodies) for _ in layer]
        faces = [[next(tops) for _ in layer] for layer in faces]
    geo.synchronize()
    for tag, (name, entities) in enumerate(volumes.items(), start=1):
        gmsh.model.addPhysicalGroup(3, entities, tag, name)


def _mean_values(points: Floats, polygon: Floats) -> Floats:
    """Mean value coordinates of points (q, 2) inside a polygon (n, 2); shape (q, n).

    Floater, Computer Aided Geometric Design 20 (2003).
    """
    vectors = polygon[None] - points[:, None]
    next_vectors = np.roll(vectors, -1, axis=1)
    lengths = np.sqrt((vectors**2).sum(axis=2))
    cross = vectors[..., 0] * next_vectors[..., 1] - vectors[..., 1] * next_vectors[..., 0]
    dot = (vectors * next_vectors).sum(axis=2)
    half_tangents = (lengths * np.roll(lengths, -1, axis=1) - dot) / cross  # tan of half the angle
    weights = (half_tangents + np.roll(half_tangents, 1, axis=1)) / lengths
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
