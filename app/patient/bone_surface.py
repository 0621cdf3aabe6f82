"""Surface of a bone as triangles from a file, checked and oriented outwards.

A surface may be open at an end of its long axis, where a scan ends.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import GeometryError
from app.foundation.layout import alternatives, two_digits
from app.patient import label_surface, surface_files, welding
from app.patient.welding import Welded
from meshes.data import connected
from meshes.plane_sections import lines_at_height

LENGTH_UNITS = {"mm": 1.0, "m": 1000.0, "cm": 10.0, "inch": 25.4}
EXTENT = (65.0, 600.0)  # mm that a femur, or a proximal part of one, is long
LEAST_CANAL = 20.0  # mm that a part of a canal is long
MOST_TRIANGLES = 400_000  # number of triangles above which surfaces are thinned
THINNING_SIZE = 0.7  # mm: edge of the boxes whose corners then become one
# A corner is a spike if it stands out of its neighbours by more than this [mm],
SPIKE_HEIGHT = 3.0
# and by more than this part of their distance from their middle.
SPIKE_RATIO = 2.0
RIM_DISTANCE = 25.0  # mm: an open end is within this distance of the bone's
DAMAGED_FROM = 1e9  # units: numbers beyond it are damaged
# mm: places in a scanner are nearer to the origin. Beyond it corners of STL files, which have seven
# digits, are rounded to more than 0.01 mm.
FARTHEST = 2e5


@dataclass(frozen=True)
class BoneSurface:
    """Outward triangles that enclose a body; they may be open at one end.

    Attributes:
        points: Corners (n, 3) [mm].
        triangles: Their rows (m, 3).
        notes: What was read and repaired, in words.
        rim: Middles of its open edges (k, 3), in the axes of the file [mm].
        borders: Places where the image of a label cuts it, for each side of the image (k, 3), in
            the axes of the file [mm].
        doubts: Doubts about the file.
    """

    points: Floats
    triangles: Ints
    notes: tuple[str, ...] = ()
    rim: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    borders: tuple[Floats, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def corners(self) -> Floats:
        """Corners of each triangle (m, 3, 3) [mm]."""
        return self.points[self.triangles]

    def level(self, z: float) -> Floats:
        """Lines (k, 2, 2) in which it meets a level [mm]."""
        return lines_at_height(self.points[:, :2], self.points[:, 2] - z, self.triangles)


def read(
    path: Path, unit: str | None = None, label: int | None = None, least_length: float = EXTENT[0]
) -> BoneSurface:
    """Read the surface of a bone from a file, or from a label of an image, which is in mm.

    Without a unit, the one that yields the length of a femur is used, and a note says so.

    Args:
        path: The file.
        unit: Unit of its coordinates.
        label: Number of the voxels in an image.
        least_length: Least length of the surface [mm].

    Raises:
        InputError: The image cannot be read.
        GeometryError: The file is damaged, or its triangles are not the surface of one body.
    """
    body = None
    if label is None:
        corners, notes = surface_files.read(path)
    else:
        corners, body = label_surface.read(path, label)
        notes = list(body.notes)
        unit = "mm"
    if not len(corners):
        raise GeometryError(f"{path}: has no triangles")
    is_lost = ~np.isfinite(corners).all(axis=(1, 2))
    if is_lost.any():
        fault = (
            f"{int(is_lost.sum()):,} of its {len(corners):,} triangles have corners that are not"
        )
        raise GeometryError(
            f"{path}: {fault} numbers; the first is triangle {int(is_lost.argmax()) + 1:,}"
        )
    if np.abs(corners).max() > DAMAGED_FROM:
        reach = f"{np.abs(corners).max():.0e}"
        raise GeometryError(f"{path}: its coordinates reach {reach}; is the file damaged?")
    extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    fitting_units = [
        name for name, scale in LENGTH_UNITS.items() if least_length <= extent * scale <= EXTENT[1]
    ]
    if unit not in (None, *fitting_units) or not (unit or len(fitting_units) == 1):
        content, remedy = "", f"set its unit to {alternatives(fitting_units or [*LENGTH_UNITS])}"
        if label is not None:
            content, remedy = f"label {label} ", "give the label of the femur"
            if fitting_units:
                names = alternatives(fitting_units)
                remedy = f"is the unit of the image {names}? Write it in mm, or {remedy}"
        raise GeometryError(
            f"{path}: {content}is {extent:.4g} {unit or 'units'} long, but a proximal femur is"
            f" {least_length:g} to {EXTENT[1]:g} mm long; {remedy}"
        )
    if unit is None:
        notes = [*notes, f"unit: {fitting_units[0]}, as the surface is {extent:.4g} long"]
    corners = corners * LENGTH_UNITS[unit or fitting_units[0]]
    farthest = float(np.abs(corners).max())
    if farthest > FARTHEST:
        fault = f"its coordinates reach {farthest:.0e} mm, where single precision is too coarse"
        raise GeometryError(f"{path}: {fault}; move it to the origin in the program that wrote it")
    surface = welding.weld(corners)
    thinned = len(surface.triangles) > MOST_TRIANGLES
    if thinned:
        surface = welding.thin(surface, THINNING_SIZE)
    if len(surface.triangles) < 4:
        count = len(surface.triangles)
        raise GeometryError(f"{path}: only {count} of its triangles have an area; expected a body")
    checked = _checked(path, surface, [*notes, *surface.notes], thinned)
    if body is None:
        return checked
    return replace(checked, borders=body.borders, doubts=(*body.doubts, *checked.doubts))


@dataclass(frozen=True)
class _Edges:
    """Edges of a surface. A half edge is a side of a triangle; an edge has one or more of them.

    Attributes:
        half_edges: Ends of the half edges (3 m, 2), three for each triangle.
        first: One half edge of each edge (k,).
        counts: Number of half edges of each edge (k,).
        pairs: Both half edges of the edges that have two (2, l).
    """

    half_edges: Ints
    first: Ints
    counts: Ints
    pairs: Ints

    @classmethod
    def of(cls, triangles: Ints, point_count: int) -> _Edges:
        """Edges of triangles (m, 3)."""
        half_edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        keys = np.sort(half_edges, axis=1) @ [point_count, 1]
        order = np.argsort(keys, kind="stable")
        starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
        counts = np.diff(starts, append=len(keys))
        paired = starts[counts == 2]
        return cls(half_edges, order[starts], counts, np.stack([order[paired], order[paired + 1]]))

    @property
    def neighbours(self) -> Ints:
        """Triangles on both sides of the edges that have two (2, l)."""
        return self.pairs // 3

    @property
    def are_followed_backwards(self) -> Bools:
        """True for pairs whose triangles have the same orientation (l,)."""
        is_ascending = (self.half_edges[:, 0] < self.half_edges[:, 1])[self.pairs]
        return is_ascending[0] != is_ascending[1]


def _checked(path: Path, surface: Welded, notes: list[str], thinned: bool) -> BoneSurface:
    """The surface turned outwards; refused if it is open on a side, or not of one body.

    Thinning leaves edges of four triangles and small bodies; open edges stay as they are.
    """
    x, triangles = surface.points, surface.triangles
    edges = _Edges.of(triangles, len(x))
    if 2 * int((edges.counts == 1).sum()) > len(edges.counts):
        raise GeometryError(f"{path}: its triangles are not joined: {_unjoined(surface, edges)}")
    body_of_triangle = connected(len(triangles), *edges.neighbours)
    if body_of_triangle.any() and not thinned:
        raise GeometryError(f"{path}: has {_several_bodies(x[triangles], body_of_triangle)}")
    is_open = edges.counts % 2 == 1 if thinned else edges.counts != 2
    open_ends = edges.half_edges[edges.first[is_open]]
    is_aside = _are_aside(x, x[open_ends])
    if is_aside.any():
        most_triangles = int(edges.counts[edges.counts != 2].max())
        fault = (
            "is open" if most_triangles == 1 else f"has edges of up to {most_triangles} triangles"
        )
        place = f"{mean_point_text(x[open_ends][is_aside])} ({int(is_aside.sum())} edges)"
        raise GeometryError(
            f"{path}: {fault} at {place}, not at an end; repair it in the program that wrote it"
        )
    if len(open_ends):
        notes.append(f"open at an end: {len(open_ends)} edges")
    if not thinned:
        triangles, turned_count = _turned_alike(triangles, edges)
        if turned_count:
            notes.append(f"{turned_count} triangles with the wrong orientation turned over")
    return BoneSurface(
        x,
        outward(x, triangles),
        tuple(notes),
        rim=x[open_ends].mean(axis=1),
        doubts=tuple(_spikes(x, edges.half_edges, open_ends)),
    )


def _unjoined(surface: Welded, edges: _Edges) -> str:
    """Distance between the corners of triangles that should be joined, and the remedy, in words."""
    single_count = int((edges.counts == 1).sum())
    return (
        f"{single_count:,} of {len(edges.counts):,} edges belong to one triangle only, and their"
        f" corners are {two_digits(welding.apart(surface))} mm from the next; merge"
        " close vertices in the program that wrote it"
    )


def _several_bodies(corners: Floats, body_of_triangle: Ints) -> str:
    """The bodies of triangles (m, 3, 3) [mm], and which of them to keep."""
    sizes = np.bincount(body_of_triangle)
    largest, second = (
        corners[body_of_triangle == body] for body in np.argsort(sizes, kind="stable")[:-3:-1]
    )
    nested = _contains(largest, second) or _contains(second, largest)
    arrangement, remedy = "", "keep the femur alone"
    if nested:
        arrangement = ", one inside the other, like bone and canal"
        remedy = "keep the bone, and give the canal as a separate file (geometry.canal)"
    return (
        f"{len(sizes)} bodies{arrangement}; the largest have {len(largest):,} and"
        f" {len(second):,} triangles, the second is at {mean_point_text(second)}; {remedy}"
    )


def _are_aside(x: Floats, open_edges: Floats) -> Bools:
    """True for edges (k, 2, 3) not at an end of the points (n, 3) along their long axis (k,)."""
    axis = np.linalg.svd(x[:: 1 + len(x) // 20_000] - x.mean(axis=0), full_matrices=False)[2][0]
    axial, edge_axial = x @ axis, open_edges.mean(axis=1) @ axis
    return np.minimum(edge_axial - axial.min(), axial.max() - edge_axial) > RIM_DISTANCE


def _turned_alike(triangles: Ints, edges: _Edges) -> tuple[Ints, int]:
    """Triangles of one body turned so that neighbours agree (m, 3), and how many were turned.

    Each triangle has two copies, as it is and turned over. Neighbours of the same orientation join
    copies of the same kind, others a copy of each kind. The copies joined to the first triangle
    then agree.
    """
    m = len(triangles)
    first, second = edges.neighbours
    other_kind = m * ~edges.are_followed_backwards
    joined_copies = np.r_[second + other_kind, second + m - other_kind]
    copy = connected(2 * m, np.r_[first, first + m], joined_copies)
    is_turned = copy[:m] != copy[0]
    turned_count = min(int(is_turned.sum()), m - int(is_turned.sum()))
    return np.where(is_turned[:, None], triangles[:, ::-1], triangles), turned_count


def _spikes(x: Floats, edge_ends: Ints, open_ends: Ints) -> Iterator[str]:
    """Doubts about corners that stand out of their neighbours, as a damaged number leaves them.

    Args:
        x: Corners (n, 3) [mm].
        edge_ends: Ends of the edges of all triangles (k, 2).
        open_ends: Ends of open edges (l, 2), where neighbours are on one side only.
    """
    n = len(x)
    corner, neighbour = edge_ends.T
    neighbour_counts = np.bincount(corner, minlength=n)
    sums = np.stack([np.bincount(corner, x[neighbour, i], n) for i in range(3)], axis=1)
    neighbour_means: Floats = sums / np.maximum(neighbour_counts, 1)[:, None]
    height = np.linalg.norm(x - neighbour_means, axis=1)
    width = np.zeros(n)
    np.maximum.at(width, corner, np.linalg.norm(x[neighbour] - neighbour_means[corner], axis=1))
    spikes = (neighbour_counts > 0) & (height > SPIKE_HEIGHT) & (height > SPIKE_RATIO * width)
    spikes[open_ends.ravel()] = False
    if spikes.any():
        highest = int(np.where(spikes, height, 0.0).argmax())
        note = f"{int(spikes.sum()):,} corners stick out from their neighbours, the farthest by"
        location = mean_point_text(x[highest])
        yield f"{note} {height[highest]:.0f} mm at {location}; is the file damaged?"


def _contains(outer: Floats, inner: Floats) -> bool:
    """Return True if the box of triangles (m, 3, 3) contains others that are as long as a canal."""
    (outer_low, outer_high), (inner_low, inner_high) = (
        (x.min(axis=(0, 1)), x.max(axis=(0, 1))) for x in (outer, inner)
    )
    inside = (inner_low > outer_low).all() and (inner_high < outer_high).all()
    return bool(inside and (inner_high - inner_low).max() > LEAST_CANAL)


def outward(points: Floats, triangles: Ints) -> Ints:
    """Triangles (m, 3) of a closed surface, all turned over if they face inwards."""
    a, b, c = points[triangles].transpose(1, 0, 2) - points.mean(axis=0)
    volume = float((np.cross(a, b) * c).sum())
    return triangles if volume > 0 else triangles[:, ::-1]


def mean_point_text(x: Floats) -> str:
    """Mean of points (..., 3) in words."""
    return "({:.0f}, {:.0f}, {:.0f}) mm in the file".format(*x.reshape(-1, 3).mean(axis=0))
