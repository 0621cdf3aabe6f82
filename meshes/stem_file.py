"""A stem from a file of CAD: read by OpenCASCADE, triangulated, and laid along its axis.

Runs in a separate process (`app.foundation.confined`), which damaged files may crash. Axes of
the answer: z along the stem, proximal, 0 at the end of its tip; x towards the head; y across.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TypedDict

import numpy as np

from app.foundation.arrays import FloatOrFloats, Floats, Ints, unit_vectors
from app.foundation.errors import GeometryError
from meshes.cad_stem import NECK_INSET, outline, outline_length
from meshes.data import facet_areas
from meshes.gmsh_session import MILLIMETRES, elements, nodes, session
from meshes.nearest_facets import triangles
from meshes.plane_sections import lines_at_height

# A circle of 6 mm is met to 0.008 mm.
TRIANGLES_PER_TURN = 15  # second-order triangles in a full turn
EDGE_PARTS = 4  # parts into which their edges are divided
SEWING_TOLERANCE = 1e-3  # mm between edges of faces that are one
SHARPEST = 0.5  # mm: an end that is oblique, or rounded by less, is flat
FLATTEST = 1.0  # mm: least rounding that is kept
FLATNESS = 1e-3  # mm that nodes of a planar face may be off its plane
LENGTH_RANGE = (60.0, 400.0)  # mm that a stem may be long
AXIS_RANGE = (0.05, 0.5)  # of its length: where sections show the axis
METAL_RANGE = (0.05, 0.75)  # of the height of its shoulder: where the axis is within the metal
SHOULDER_LEVEL = 0.9  # of the height of its shoulder: where the shoulder is
BLUNT_HEIGHT = 6.0  # mm above the tip, where its rounding has ended
TIP_SHARE = 0.4  # of the length around there: where the tip's end is
ROUNDING_SHARE = 0.9  # of that length: where the rounding ends
TAPER_RANGE = (25.0, 80.0)  # deg between axis and neck
LEAST_ASIDE = 10.0  # mm of the neck's end from the axis, at least


Vector = tuple[float, float, float]


class StemRequest(TypedDict):
    """The file of a stem, and its landmarks in the file's coordinates [mm]; None: not given."""

    path: str
    unit: str
    head_centre: Vector | None
    axis: tuple[Vector, Vector] | None
    taper_face: Vector | None


def read(request: StemRequest) -> dict[str, FloatOrFloats]:
    """The stem of a file: its surface and landmarks.

    Args:
        request: ``path``, ``unit`` and, in the file's coordinates [mm] or None, ``head_centre``
            (3,), two points of the ``axis`` from distal (2, 3), ``taper_face``: a point of it (3,).

    Returns:
        Arrays by name, lengths in mm:

        * ``x``: triangles (m, 3, 3), ``coarse``: fewer of them.
        * ``head``: centre of the head (3,).
        * ``neck``: unit vector along the neck (3,).
        * ``end``: centre of the neck's end (3,), ``radius``: radius of a circle of its area.
        * ``shoulder``: height of the highest point lateral to the axis.
        * ``lateral``: lateral extent of the stem at the shoulder.
        * ``rounding``: height of the rounded tip.
        * ``around``: length of a section at 3/4 of the shoulder's height.
        * ``in_file``: in coordinates of the file, two points of the axis, the centres of the head
          and of the neck's end, and the direction to medial (5, 3).

    Raises:
        GeometryError: It is no file of one solid, or no stem.
    """
    path = request["path"]
    points, faces = _faces(request)
    points *= MILLIMETRES[request["unit"]]
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if not LENGTH_RANGE[0] <= size <= LENGTH_RANGE[1]:
        raise GeometryError(
            f"{path}: {size:.3g} mm from end to end; a stem has"
            f" {LENGTH_RANGE[0]:g} to {LENGTH_RANGE[1]:g} mm: the"
            f" file names no unit or a wrong one, or `unit: {request['unit']}` is wrong"
        )
    coarse = points[np.concatenate(faces)[:, :3]]
    if request["axis"] is None:
        origin, axis = _axis(coarse)
    else:
        origin, high = np.array(request["axis"])
        axis = unit_vectors(high - origin)
    end, normal, radius = _taper(path, points, faces, origin, axis, request["taper_face"])
    head = end if request["head_centre"] is None else np.array(request["head_centre"])
    medial = unit_vectors(head - origin - axis * (axis @ (head - origin)))
    rotation = np.stack([medial, np.cross(axis, medial), axis])
    x = (triangles(points, np.concatenate(faces), EDGE_PARTS) - origin) @ rotation.T
    tip_level, rounding_level = (_tip(x, share) for share in (TIP_SHARE, ROUNDING_SHARE))
    tip_level = rounding_level if rounding_level - tip_level < SHARPEST else tip_level
    tip = np.array([0.0, 0.0, tip_level])
    rounding = max(rounding_level - tip_level, FLATTEST) if rounding_level > tip_level else 0.0
    x -= tip
    shoulder = x[x[..., 0] <= 0][:, 2].max()
    ends = origin + np.outer([tip[2], tip[2] + shoulder], axis)
    return {
        "x": x,
        "coarse": (coarse - origin) @ rotation.T - tip,
        "head": rotation @ (head - origin) - tip,
        "end": rotation @ (end - origin) - tip,
        "neck": rotation @ normal,
        "radius": radius,
        "shoulder": shoulder,
        "rounding": rounding,
        "lateral": -x[x[..., 2] > SHOULDER_LEVEL * shoulder][:, 0].min(),
        "around": outline_length(_highest_outline(path, x, shoulder)),
        "in_file": np.stack([*ends, head, end, medial]),
    }


def _faces(request: StemRequest) -> tuple[Floats, list[Ints]]:
    """Nodes (n, 3) [mm], and the second-order triangles of each face (m, 6)."""
    path = Path(request["path"])
    with session(path.name) as gmsh:
        occ, mesh = gmsh.model.occ, gmsh.model.mesh
        try:
            if all(dim < 3 for dim, _ in occ.importShapes(path.name)):
                occ.healShapes([], SEWING_TOLERANCE)  # IGES has faces alone
            occ.synchronize()
        except Exception as error:
            raise GeometryError(
                f"{path}: cannot be read as STEP, IGES or BREP; export it again ({error})"
            ) from error
        solids = len(gmsh.model.getEntities(3))
        if solids != 1:
            count = f"{solids} solids" if solids else "no solid"
            raise GeometryError(
                f"{path}: {count}; a stem must be one:"
                f" {'fuse them, or remove parts' if solids else 'close its surface'}"
            )
        box = np.array(gmsh.model.getBoundingBox(-1, -1))
        size = float(np.linalg.norm(box[3:] - box[:3]))
        for option, value in (
            ("FromCurvature", TRIANGLES_PER_TURN),
            ("Max", size / 20),
            ("Min", size / 2000),
        ):
            gmsh.option.setNumber(f"Mesh.MeshSize{option}", value)
        mesh.generate(2)
        mesh.setOrder(2)
        points, row = nodes(gmsh)
        # `triangles` has the middle of 12 before that of 20 and 01.
        return points, [elements(gmsh, 9, [face], row) for _, face in gmsh.model.getEntities(2)]


def _level(x: Floats, z: float) -> Floats:
    """Outline of a section across the axis (r, 3) [mm]."""
    return outline(x, np.array([0.0, 0.0, z]), np.eye(3)[:2])


def _tip(x: Floats, share: float) -> float:
    """Level of the lowest section that has a part of the full outline [mm]."""
    lowest = float(x[..., 2].min())
    for z in lowest + np.linspace(NECK_INSET, BLUNT_HEIGHT, 120):
        with suppress(ValueError):
            if outline_length(_level(x, z)) > share * outline_length(
                _level(x, lowest + BLUNT_HEIGHT)
            ):
                return float(z)
    return lowest


def _highest_outline(path: str, x: Floats, shoulder: float) -> Floats:
    """Outline of the highest section of the body (r, 3) [mm].

    Raises:
        GeometryError: The axis leaves the metal there or below.
    """
    outline_points: Floats = np.zeros(0)
    for z in np.linspace(*METAL_RANGE, 20) * shoulder:
        try:
            outline_points = _level(x, z)
        except ValueError:
            raise GeometryError(
                f"{path}: {z:.0f} mm above the tip the axis is outside the metal, or the"
                " section has holes: fill the holes, or set `axis` of the stem"
            ) from None
    return outline_points


def _axis(x: Floats) -> tuple[Floats, Floats]:
    """Point and direction to proximal of the line through sections of triangles.

    Of the two halves of the length the straighter one is distal.
    """
    middle = x.mean(axis=1)
    first_axis = np.linalg.svd(middle - middle.mean(axis=0), full_matrices=False)[2][0]
    axes = []
    for axis in (first_axis, -first_axis):
        for _ in range(5):
            heights = x @ axis
            centres = []
            for fraction in np.linspace(*AXIS_RANGE, 24):
                height = heights - (1 - fraction) * heights.min() - fraction * heights.max()
                ends = lines_at_height(x.reshape(-1, 3), height.ravel())
                length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
                centres.append(length @ ends.mean(axis=1) / length.sum())
            origin = np.mean(centres, axis=0)
            _, singular_values, directions = np.linalg.svd(centres - origin)
            axis = directions[0] * np.sign(directions[0] @ axis)
        axes.append((float(singular_values[1]), origin, axis))
    return min(axes, key=lambda candidate: candidate[0])[1:]


def _taper(
    path: str,
    points: Floats,
    faces: list[Ints],
    origin: Floats,
    axis: Floats,
    given_point: Vector | None,
) -> tuple[Floats, Floats, float]:
    """Centre and normal of the planar face that ends the neck, and radius of a circle as large."""
    candidates = []
    for face in faces:
        x = points[np.unique(face)]
        normal = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[2][2]
        if np.abs((x - x.mean(axis=0)) @ normal).max() > FLATNESS:
            continue
        normal *= 1.0 if normal @ axis > 0 else -1.0
        fine = triangles(points, face, EDGE_PARTS)
        area = facet_areas(fine.reshape(-1, 3), np.arange(3 * len(fine)).reshape(-1, 3))
        centre = area @ fine.mean(axis=1) / area.sum()
        height = (centre - origin) @ axis
        distance = np.linalg.norm(centre - origin - height * axis)
        rank = height + distance
        if given_point is not None:
            rank = -np.linalg.norm(fine - given_point, axis=2).min()
        elif not (
            distance > LEAST_ASIDE
            and height > 0
            and TAPER_RANGE[0] <= np.degrees(np.arccos(min(1.0, normal @ axis))) <= TAPER_RANGE[1]
        ):
            continue
        candidates.append((rank, centre, normal, float(np.sqrt(area.sum() / np.pi))))
    if not candidates:
        raise GeometryError(
            f"{path}: no planar face at the end of a neck ({TAPER_RANGE[0]:g} to"
            f" {TAPER_RANGE[1]:g} deg to the"
            f" axis, more than {LEAST_ASIDE:g} mm from it); set `taper_face` to a"
            " point of that face"
        )
    return max(candidates, key=lambda candidate: candidate[0])[1:]
