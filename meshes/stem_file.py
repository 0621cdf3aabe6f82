"""A stem from a file of CAD: read by OpenCASCADE, triangulated, and laid along its axis.

Runs in a separate process (`app.foundation.confined`), which damaged files may crash. Axes of
the answer: z along the stem, proximal, 0 at the end of its tip; x towards the head; y across.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TypedDict

import numpy as np

from app.foundation.arrays import FloatOrFloats, Floats, Ints
from app.foundation.errors import GeometryError
from meshes.cad_stem import INSIDE, around, outline
from meshes.data import facet_areas
from meshes.femur_stem import unit
from meshes.gmsh_child import MILLIMETRES, elements, nodes, session
from meshes.mantle import triangles
from meshes.plane_sections import section

# A circle of 6 mm is met to 0.008 mm.
TURN = 15  # second-order triangles in a full turn
PARTS = 4  # parts into which their edges are divided
SEWN = 1e-3  # mm between edges of faces that are one
SHARP = 0.5  # mm: an end that is oblique, or rounded by less, is flat
FLATTEST = 1.0  # mm: least rounding that is kept
FLAT = 1e-3  # mm that nodes of a planar face may be off its plane
LONG = (60.0, 400.0)  # mm that a stem may be long
STRAIGHT = (0.05, 0.5)  # of its length: where sections show the axis
WHOLE = (0.05, 0.75)  # of the height of its shoulder: where the axis is within the metal
TOP = 0.9  # of the height of its shoulder: where the shoulder is
BLUNT = 6.0  # mm above the tip, where its rounding has ended
WIDE = 0.4  # of the length around there: where the tip's end is
FULL = 0.9  # of that length: where the rounding ends
TAPER = (25.0, 80.0)  # deg between axis and neck
ASIDE = 10.0  # mm of the neck's end from the axis, at least


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
        * ``end``: centre of the neck's end (3,), ``radius``: that of a circle of its area.
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
    if not LONG[0] <= size <= LONG[1]:
        raise GeometryError(
            f"{path}: {size:.3g} mm from end to end; a stem has {LONG[0]:g} to {LONG[1]:g} mm: the"
            f" file names no unit or a wrong one, or `unit: {request['unit']}` is wrong"
        )
    coarse = points[np.concatenate(faces)[:, :3]]
    if request["axis"] is None:
        origin, axis = _axis(coarse)
    else:
        origin, high = np.array(request["axis"])
        axis = unit(high - origin)
    end, normal, radius = _taper(path, points, faces, origin, axis, request["taper_face"])
    head = end if request["head_centre"] is None else np.array(request["head_centre"])
    medial = unit(head - origin - axis * (axis @ (head - origin)))
    turn = np.stack([medial, np.cross(axis, medial), axis])
    x = (triangles(points, np.concatenate(faces), PARTS) - origin) @ turn.T
    low, full = (_tip(x, part) for part in (WIDE, FULL))
    low = full if full - low < SHARP else low
    tip, rounding = np.array([0.0, 0.0, low]), max(full - low, FLATTEST) if full > low else 0.0
    x -= tip
    shoulder = x[x[..., 0] <= 0][:, 2].max()
    ends = origin + np.outer([tip[2], tip[2] + shoulder], axis)
    return {
        "x": x,
        "coarse": (coarse - origin) @ turn.T - tip,
        "head": turn @ (head - origin) - tip,
        "end": turn @ (end - origin) - tip,
        "neck": turn @ normal,
        "radius": radius,
        "shoulder": shoulder,
        "rounding": rounding,
        "lateral": -x[x[..., 2] > TOP * shoulder][:, 0].min(),
        "around": around(_whole(path, x, shoulder)),
        "in_file": np.stack([*ends, head, end, medial]),
    }


def _faces(request: StemRequest) -> tuple[Floats, list[Ints]]:
    """Nodes (n, 3) [mm], and the second-order triangles of each face (m, 6)."""
    path = Path(request["path"])
    with session(path.name) as gmsh:
        occ, mesh = gmsh.model.occ, gmsh.model.mesh
        try:
            if all(dim < 3 for dim, _ in occ.importShapes(path.name)):
                occ.healShapes([], SEWN)  # IGES has faces alone
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
        for option, value in (("FromCurvature", TURN), ("Max", size / 20), ("Min", size / 2000)):
            gmsh.option.setNumber(f"Mesh.MeshSize{option}", value)
        mesh.generate(2)
        mesh.setOrder(2)
        points, row = nodes(gmsh)
        # `triangles` has the middle of 12 before that of 20 and 01.
        return points, [elements(gmsh, 9, [face], row) for _, face in gmsh.model.getEntities(2)]


def _level(x: Floats, z: float) -> Floats:
    """Outline of a section across the axis (r, 3) [mm]."""
    return outline(x, np.array([0.0, 0.0, z]), np.eye(3)[:2])


def _tip(x: Floats, part: float) -> float:
    """Level of the lowest section that has a part of the full outline [mm]."""
    low = float(x[..., 2].min())
    for z in low + np.linspace(INSIDE, BLUNT, 120):
        with suppress(ValueError):
            if around(_level(x, z)) > part * around(_level(x, low + BLUNT)):
                return float(z)
    return low


def _whole(path: str, x: Floats, shoulder: float) -> Floats:
    """Outline of the highest section of the body (r, 3) [mm].

    Raises:
        GeometryError: The axis leaves the metal there or below.
    """
    outline_points: Floats = np.zeros(0)
    for z in np.linspace(*WHOLE, 20) * shoulder:
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
    rough = np.linalg.svd(middle - middle.mean(axis=0), full_matrices=False)[2][0]
    axes = []
    for axis in (rough, -rough):
        for _ in range(5):
            along = x @ axis
            middles = []
            for part in np.linspace(*STRAIGHT, 24):
                height = along - (1 - part) * along.min() - part * along.max()
                ends = section(x.reshape(-1, 3), height.ravel())
                length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
                middles.append(length @ ends.mean(axis=1) / length.sum())
            origin = np.mean(middles, axis=0)
            _, size, ways = np.linalg.svd(middles - origin)
            axis = ways[0] * np.sign(ways[0] @ axis)
        axes.append((float(size[1]), origin, axis))
    return min(axes, key=lambda one: one[0])[1:]


def _taper(
    path: str, points: Floats, faces: list[Ints], origin: Floats, axis: Floats, given: Vector | None
) -> tuple[Floats, Floats, float]:
    """Centre of the planar face that ends the neck, its normal, radius of a circle as large."""
    candidates = []
    for face in faces:
        x = points[np.unique(face)]
        normal = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[2][2]
        if np.abs((x - x.mean(axis=0)) @ normal).max() > FLAT:
            continue
        normal *= 1.0 if normal @ axis > 0 else -1.0
        fine = triangles(points, face, PARTS)
        area = facet_areas(fine.reshape(-1, 3), np.arange(3 * len(fine)).reshape(-1, 3))
        centre = area @ fine.mean(axis=1) / area.sum()
        high = (centre - origin) @ axis
        aside = np.linalg.norm(centre - origin - high * axis)
        rank = high + aside
        if given is not None:
            rank = -np.linalg.norm(fine - given, axis=2).min()
        elif not (
            aside > ASIDE
            and high > 0
            and TAPER[0] <= np.degrees(np.arccos(min(1.0, normal @ axis))) <= TAPER[1]
        ):
            continue
        candidates.append((rank, centre, normal, float(np.sqrt(area.sum() / np.pi))))
    if not candidates:
        raise GeometryError(
            f"{path}: no planar face at the end of a neck ({TAPER[0]:g} to {TAPER[1]:g} deg to the"
            f" axis, more than {ASIDE:g} mm from it); set `taper_face` to a point of that face"
        )
    return max(candidates, key=lambda one: one[0])[1:]
