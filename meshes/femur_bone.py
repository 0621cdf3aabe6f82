"""The bone of the parametric femur: its outer and endosteal surfaces as r(theta, z).

Axes: z along the shaft, proximal positive, 0 at mid lesser trochanter; x medial; y anterior; theta
from x towards y. Sections are superellipses with different medial and lateral half-widths, from
the tables below by monotone cubic interpolation in z.

Medio-lateral canal widths follow the CT of 508 femora (ISTA 2014 abstract: 43.7, 35.0, 28.7, 24.0,
20.6, 16.7, 15.7 and 13.5 mm at z = 20 ... -80); so do the antero-posterior depths at z = -40 (15.2)
and -80 (12.5 mm). Noble's isthmus (12.3 by 16.9 mm, 1988) is deeper antero-posteriorly than that
sample is 30 mm above it; one sample was preferred to two that do not fit together, so the isthmus
at z = -113 is 12.3 by 12.5 mm. Cortex and trochanter are assumed.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator, make_interp_spline

from .data import Floats

# z, lateral, medial, antero-posterior half-width [mm], superellipse exponent
OUTER = np.array(
    [
        (42.0, 27.0, 27.0, 19.5, 2.3),
        (37.0, 30.5, 27.0, 21.5, 2.4),
        (30.0, 31.5, 26.5, 22.0, 2.5),
        (20.0, 28.0, 25.5, 20.5, 2.4),
        (10.0, 23.0, 24.0, 18.5, 2.2),
        (0.0, 19.5, 21.5, 17.0, 2.1),
        (-10.0, 17.3, 18.6, 16.0, 2.0),
        (-20.0, 16.0, 16.8, 15.2, 2.0),
        (-40.0, 14.9, 15.2, 14.4, 2.0),
        (-50.0, 14.5, 14.8, 14.2, 2.0),
        (-80.0, 13.8, 14.0, 13.8, 2.0),
        (-113.0, 13.5, 13.6, 13.6, 2.0),
        (-150.0, 13.8, 13.8, 14.0, 2.0),
        (-200.0, 14.5, 14.5, 14.8, 2.0),
        (-260.0, 15.5, 15.5, 16.0, 2.0),
    ]
)
CANAL = np.array(
    [
        (39.0, 26.0, 23.5, 17.5, 2.3),
        (30.0, 27.5, 23.0, 17.8, 2.4),
        (20.0, 23.2, 20.5, 15.5, 2.3),
        (10.0, 18.0, 17.0, 13.5, 2.2),
        (0.0, 14.0, 14.7, 12.0, 2.1),
        (-10.0, 11.6, 12.4, 10.6, 2.0),
        (-20.0, 10.2, 10.4, 9.4, 2.0),
        (-40.0, 8.35, 8.35, 7.6, 2.0),
        (-50.0, 7.85, 7.85, 7.2, 2.0),
        (-80.0, 6.75, 6.75, 6.25, 2.0),
        (-113.0, 6.15, 6.15, 6.25, 2.0),
        (-150.0, 6.8, 6.8, 6.9, 2.0),
        (-200.0, 8.0, 8.0, 8.0, 2.0),
        (-260.0, 9.5, 9.5, 9.5, 2.0),
    ]
)
TROCHANTER = (6.0, np.radians(-20.0), 0.40, 8.0)  # lesser: height, angle, spread in angle and z
SEAMS = (np.radians(90.0), np.radians(300.0))  # where no muscle is attached
# Insertions (physics note 4.4, from the head centre of the default femur) in model coordinates;
# vastus lateralis on the lateral shaft below the greater trochanter.
MUSCLES = {
    "gluteus_medius": (-30.0, -18.0, 28.0),
    "gluteus_minimus": (-26.0, 4.0, 27.0),
    "gluteus_maximus": (-4.0, -9.0, -49.0),
    "psoas": (28.0, -2.0, -7.0),
    "vastus_lateralis": (-15.0, 4.0, -25.0),
}
PATCH_RADIUS = 8.0


@dataclass(frozen=True)
class Tube:
    """A closed surface around the z axis between two levels.

    Attributes:
        table: Rows z, lateral, medial, antero-posterior half-width, exponent.
        bump: Height, angle, angular spread, axial spread of a Gaussian bump at z = 0.
        offset: Added to the radius [mm].
        bottom: Lowest level [mm]; the highest is the table's.
    """

    table: Floats
    bump: tuple[float, float, float, float]
    offset: float
    bottom: float

    @property
    def top(self) -> float:
        """Highest level [mm]."""
        return float(self.table[:, 0].max())

    def radius(self, theta: Floats, z: Floats) -> Floats:
        """Distance from the z axis [mm]; beyond the table the end sections continue."""
        rows = self.table[np.argsort(self.table[:, 0])]
        level = np.clip(z, rows[0, 0], rows[-1, 0])
        lateral, medial, depth, n = np.moveaxis(
            PchipInterpolator(rows[:, 0], rows[:, 1:])(level), -1, 0
        )
        width = np.where(np.cos(theta) > 0, medial, lateral)
        r = ((np.abs(np.cos(theta)) / width) ** n + (np.abs(np.sin(theta)) / depth) ** n) ** (
            -1 / n
        )
        height, angle, spread, length = self.bump
        turn = np.angle(np.exp(1j * (theta - angle)))
        return r + self.offset + height * np.exp(-((turn / spread) ** 2) - (z / length) ** 2)

    def contains(self, points: Floats) -> Any:
        """Whether points (n, 3) are inside, shape (n,)."""
        x, y, z = points.T
        within = np.hypot(x, y) < self.radius(np.arctan2(y, x), z)
        return within & (z > self.bottom) & (z < self.top)


def outer(bottom: float) -> Tube:
    """The periosteal surface, from the distal cut."""
    return Tube(OUTER, TROCHANTER, 0.0, bottom)


def canal(bottom: float, widening: float) -> Tube:
    """The endosteal surface, reamed by ``widening`` [mm]."""
    return Tube(CANAL, (0.0, 0.0, 1.0, 1.0), widening, bottom)


def solid(gmsh: Any, tube: Tube) -> int:
    """Build a tube as a solid bounded by interpolating B-spline surfaces and flat caps.

    Smooth lofts (``addThruSections``) overshoot the sections by millimetres without an error;
    interpolation of dense sections does not.

    Returns:
        The volume's tag.
    """
    occ = gmsh.model.occ
    levels = _levels(tube)
    turns = [SEAMS[0], SEAMS[1], SEAMS[0] + 2 * np.pi]
    sides = []
    for start, end in itertools.pairwise(turns):
        count = int(np.ceil((end - start) / np.radians(8.0))) + 1
        sides.append(_surface(gmsh, tube, np.linspace(start, end, count), levels))
    occ.synchronize()
    caps = []
    for level in (levels[0], levels[-1]):
        rim = [
            edge
            for side in sides
            for _, edge in gmsh.model.getBoundary([(2, side)], oriented=False)
            if _flat_at(gmsh, edge, level)
        ]
        caps.append(occ.addPlaneSurface([occ.addWire(rim, checkClosed=True)]))
    return int(occ.addVolume([occ.addSurfaceLoop([*sides, *caps], sewing=True)]))


def _levels(tube: Tube) -> Floats:
    """Section levels: denser where the bone changes quickly."""
    knots = np.unique(np.concatenate([[tube.bottom, tube.top], tube.table[:, 0]]))
    knots = knots[(knots >= tube.bottom) & (knots <= tube.top)]
    parts: list[Floats] = []
    for low, high in itertools.pairwise(knots):
        step = 3.0 if low >= -25 else 12.0
        parts.append(np.linspace(low, high, int(np.ceil((high - low) / step)), endpoint=False))
    return np.concatenate([*parts, [tube.top]])


def _surface(gmsh: Any, tube: Tube, angles: Floats, levels: Floats) -> int:
    """A B-spline surface through r(angle, level)."""
    theta, z = np.meshgrid(angles, levels, indexing="ij")
    r = tube.radius(theta, z)
    grid = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1)
    along = make_interp_spline(angles, grid, k=3, axis=0)
    across = make_interp_spline(levels, np.moveaxis(along.c, 1, 0), k=3, axis=0)
    knots_u, times_u = _knots(along.t)
    knots_v, times_v = _knots(across.t)
    # u runs fastest in gmsh's list of control points
    points = [gmsh.model.occ.addPoint(*p) for p in across.c.reshape(-1, 3)]
    return int(
        gmsh.model.occ.addBSplineSurface(
            points,
            len(angles),
            degreeU=3,
            degreeV=3,
            knotsU=knots_u,
            knotsV=knots_v,
            multiplicitiesU=times_u,
            multiplicitiesV=times_v,
        )
    )


def _knots(t: Floats) -> tuple[list[float], list[int]]:
    """Distinct knots and their multiplicities."""
    knots, times = np.unique(t, return_counts=True)
    return [float(k) for k in knots], [int(n) for n in times]


def _flat_at(gmsh: Any, edge: int, level: float) -> bool:
    """Whether an edge lies in the plane z = level."""
    low, high = gmsh.model.getParametrizationBounds(1, edge)
    at = np.array(gmsh.model.getValue(1, edge, np.linspace(low[0], high[0], 5))).reshape(-1, 3)
    return bool(np.all(np.abs(at[:, 2] - level) < 1e-6))


def insertions(bone: Tube) -> dict[str, Floats]:
    """Where each muscle's insertion, moved radially, meets the outer surface [mm]."""
    centres = {}
    for name, (x, y, z) in MUSCLES.items():
        theta = np.arctan2(y, x)
        r = float(bone.radius(np.array(theta), np.array(z)))
        centres[name] = np.array([r * np.cos(theta), r * np.sin(theta), z])
    return centres


def resection(geometry: Any) -> tuple[Floats, float]:
    """Unit normal n and level c of the resection: bone is kept where n.x < c."""
    angle = geometry.resection_angle
    normal = np.array([math.sin(angle), 0.0, math.cos(angle)])
    edge = outer(geometry.distal_cut_z).radius(np.array(0.0), np.array(geometry.resection_height))
    return normal, float(normal @ [float(edge), 0.0, geometry.resection_height])


def patches(gmsh: Any, bone: Tube, solids: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Faces of the outer surface inside a sphere about each insertion.

    Args:
        gmsh: The open session.
        bone: The outer surface.
        solids: It as a solid.
    """
    occ = gmsh.model.occ
    occ.synchronize()
    faces = gmsh.model.getBoundary(solids, oriented=False)
    found: list[tuple[int, int]] = []
    for centre in insertions(bone).values():
        ball = [(3, occ.addSphere(*centre, PATCH_RADIUS))]
        made, _ = occ.intersect(occ.copy(faces), ball)
        found += [entity for entity in made if entity[0] == 2]
    return found


def grade(gmsh: Any, geometry: Any, volumes: list[int], size: float, far_size: float) -> None:
    """Elements of ``size`` around volumes, growing to ``far_size``; half of it where loads act.

    Args:
        gmsh: The open session.
        geometry: The femur, for the places of its loads.
        volumes: The mantle, or what is inside the endosteal surface.
        size: At the surface of these [mm].
        far_size: Far from it [mm].
    """
    field = gmsh.model.mesh.field
    faces = gmsh.model.getBoundary([(3, v) for v in volumes], combined=True, oriented=False)
    distance = field.add("Distance")
    field.setNumbers(distance, "SurfacesList", sorted({abs(t) for _, t in faces}))
    field.setNumber(distance, "Sampling", 100)
    threshold = field.add("Threshold")
    for name, value in (
        ("InField", distance),
        ("SizeMin", size),
        ("SizeMax", far_size),
        ("DistMin", 0.5 * size),
        ("DistMax", 0.5 * size + (far_size - size) / 0.4),
    ):
        field.setNumber(threshold, name, value)
    fields = [threshold]
    centres = list(insertions(outer(geometry.distal_cut_z)).values())
    centres.append(np.array([geometry.head_offset, 0.0, geometry.head_height]))
    for x, y, z in centres:
        ball = field.add("Ball")
        for name, value in (
            ("XCenter", x),
            ("YCenter", y),
            ("ZCenter", z),
            ("Radius", PATCH_RADIUS + 1),
            ("Thickness", far_size),
            ("VIn", max(size, 0.45 * far_size)),
            ("VOut", far_size),
        ):
            field.setNumber(ball, name, float(value))
        fields.append(ball)
    smallest = field.add("Min")
    field.setNumbers(smallest, "FieldsList", fields)
    field.setAsBackgroundMesh(smallest)
