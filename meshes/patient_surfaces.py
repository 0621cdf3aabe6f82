"""The nested surfaces of a patient's femur: radii by rays in the turned sections of the mesh.

In those sections, parallel to the neck cut near it, a ray meets the bone once, trochanters
included, where at a level of z it would meet it several times. Below the plug the shaft bows away
from the stem's axis: there the centre of the rays goes over to the canal's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter

from app.arrays import Floats, Ints
from app.errors import GeometryError
from meshes import femur_bone, femur_stem, femur_surfaces
from meshes.bone_surface import Surface, centroid, exits, section
from meshes.femur_surfaces import CORE_OVER, LEAST_MANTLE, SPREAD, FemurSurfaces, root
from meshes.layers import Lines
from meshes.placement import Placement

ANGLES, EVERY = 96, 2.0  # rays around; mm between sections
BEYOND = 4.0  # mm above the cut up to which radii are taken
GROOVE = 4.0  # mm: narrower gaps in the bone do not end a ray
STEEPEST = 1.2  # slope of a surface along and around
BLUR = 0.7  # samples
THINNING, THIN = 35.0, 2.0  # mm above the canal's end over which the cortex becomes so thin
CORTEX, LEAST_CORTEX = 2.5, 1.5  # mm that reaming leaves, or the patient's own down to the second
BROACH = 0.3  # mm that a broach is wider than stem and mantle
CORE = 0.7  # of the canal: the innermost surface below the plug
LID = 0.9  # of the normal along the shaft: the flat end of a canal's surface
WIDE, OVER = 12.0, 2.0  # mm of an edge around the metaphysis, and over the size
SIDES = ("medially", "antero-medially", "anteriorly", "antero-laterally")
SIDES += ("laterally", "postero-laterally", "posteriorly", "postero-medially")


class Sheet:
    """A surface around the stem as a periodic bicubic spline of its radii.

    Attributes:
        zeta: Sections (n,) [mm].
        radii: Radii (n, `ANGLES`) [mm].
    """

    def __init__(self, zeta: Floats, radii: Floats) -> None:
        self.zeta, self.radii = zeta, radii

    @cached_property
    def _spline(self) -> RectBivariateSpline:
        turn = 2 * np.pi / ANGLES
        angles = turn * np.arange(-4, ANGLES + 4)
        wrapped = np.take(self.radii, np.arange(-4, ANGLES + 4) % ANGLES, axis=1)
        return RectBivariateSpline(self.zeta, angles, wrapped)

    def __call__(self, theta: Floats, zeta: Floats) -> Floats:
        """Radii at angles and sections (n,) [mm]."""
        return np.asarray(self._spline.ev(zeta, np.mod(theta, 2 * np.pi)))


@dataclass(frozen=True)
class Leaning:
    """A stem's body in planes that are not across its medial plane: z = zeta - slope (x + lean y).

    Attributes:
        body: The body.
        lean: Slope of the planes along y over that along x.
    """

    body: Any
    lean: float

    def section(self, z: Any) -> Any:
        """Of the body."""
        return self.body.section(z)

    def point(self, phi: Floats, zeta: Any, slope: Any) -> Floats:
        """Points of the outline in the planes (n, 3) [mm]."""
        z = zeta + np.zeros(len(phi))
        for _ in range(12):  # the body tapers: each time the error is a few percent of what it was
            x = self.body.point(phi, z, 0.0)
            z = zeta - slope * (x[:, 0] + self.lean * x[:, 1])
        x[:, 2] = z
        return x


class PatientSurfaces(FemurSurfaces):
    """Nested surfaces in the stem's axes of a bone that is known by triangles."""

    def __init__(self, geometry: Any, mesh: Any, placed: Placement) -> None:
        self.mesh, self._placed, implant = mesh, placed, geometry.implant
        body = femur_stem.body(implant)
        self._top, (self._steepest, self._lean) = placed.top, placed.slopes
        self._body = Leaning(body, self._lean)
        tip, thickness = -implant.stem_length, geometry.cement_thickness
        self._grown = body.offset(thickness)
        self._plug = tip - implant.plug_length
        distal = placed.top + (geometry.distal_level(placed) - placed.foot[2]) / placed.turn[2, 2]
        below = femur_surfaces._distances(mesh, self._plug - distal, "below")
        above = femur_surfaces._distances(mesh, self._top - tip, "stem")
        steps, start = mesh.steps(implant.plug_length), len(below) - 1
        inside = self._plug + implant.plug_length * np.arange(1, steps + 1) / steps
        parts = [(self._plug - below)[::-1], inside, (self._top - above)[-2::-1]]
        self._zeta = np.concatenate(parts)
        self.tip, self.mantle = start + steps, (start, len(self._zeta) - 1)
        self._middle = 0.25 * tip + 0.75 * self._top
        self.told: list[str] = []
        self._measure(geometry)
        wide = 2 * np.pi * float(self._outer.radii[self._outer.zeta < self._top].mean(axis=1).max())
        least = 0 if mesh.size > 10.0 or mesh.around else int(np.ceil(wide / min(WIDE, OVER * mesh.size)))
        self.around = max(mesh.lines_around(body.section(self._middle), thickness), least)
        self.through, self.cement = mesh.cells_through(thickness), mesh.along_cement(thickness)
        self._refuse()
        self._continue(implant)

    # Measuring

    def _slope(self, zeta: Floats) -> Floats:
        t = np.clip((zeta - self._top + femur_surfaces.TURN) / femur_surfaces.TURN, 0.0, 1.0)
        return np.asarray(self._steepest * t * t * (2 - t))

    def _centre(self, zeta: Floats) -> Floats:
        """Centre of the rays of sections (n, 2) [mm]: straight between stations."""
        return np.stack([np.interp(zeta, self._zeta, c) for c in self._centres.T], axis=1)

    def _rays(self, surface: Surface, zeta: Floats) -> tuple[Floats, Ints]:
        """Radii of a surface in the stem's axes in sections, and how often rays meet it."""
        x, angles = surface.points, 2 * np.pi * np.arange(ANGLES) / ANGLES
        across = x[:, 0] + self._lean * x[:, 1]
        found = []
        for z, slope, centre in zip(zeta, self._slope(zeta), self._centre(zeta), strict=True):
            lines = section(x[:, :2], x[:, 2] + slope * across - z, surface.triangles)
            found.append(exits(lines - centre, angles, GROOVE))
        return np.array([r for r, _ in found]), np.array([n for _, n in found])

    def _measure(self, geometry: Any) -> None:
        """Take the radii of periosteum and endosteum."""
        placed = self._placed
        bone = Surface(placed.to_stem(placed.bone.points), placed.bone.triangles)
        canal = placed.canal and Surface(
            placed.to_stem(placed.canal.points), placed.canal.triangles
        )
        self._centres = np.zeros((len(self._zeta), 2))
        below = self._zeta[: self.mantle[0]]
        part = np.minimum((self._plug - below) / CORE_OVER, 1.0)
        inner = canal or bone
        for k, z in enumerate(below):
            lines = section(inner.points[:, :2], inner.points[:, 2] - z, inner.triangles)
            if not len(lines):
                at = placed.where(placed.to_model(np.array([0.0, 0.0, z])))
                what = "canal.surface: ends" if canal else "bone.surface: ends"
                raise GeometryError(f"geometry.{what} above the distal cut, at {at}; cut higher")
            self._centres[k] = part[k] ** 2 * (3 - 2 * part[k]) * centroid(lines)[0]
        low, high = self._zeta[0] - EVERY, self._top + BEYOND
        zeta = np.linspace(low, high, int((high - low) / EVERY) + 1)
        radii, times = self._rays(bone, zeta)
        inside = zeta < self._top
        if (missed := np.isnan(radii)[inside].any(axis=1)).any():
            at = np.array([0.0, 0.0, zeta[inside][missed].max()])
            raise GeometryError(
                "geometry: the stem's axis is outside of the bone at"
                f" {placed.where(placed.to_model(at))}; cut lower or flatter (resection), or move"
                " the stem (insertion)"
            )
        twice = float((times[inside] > 2).mean())
        if twice > 0.02:
            raise GeometryError(
                f"geometry: {100 * twice:.0f} % of rays across the bone meet its surface more than"
                " once: it crosses itself or has cavities; repair it where it was made"
            )
        if twice:
            self.told.append(f"{100 * twice:.1f} % of rays meet the bone more than once")
        outer = _limited(_filled(radii), EVERY)
        self._outer = Sheet(zeta, gaussian_filter(outer, BLUR, mode=("nearest", "wrap")))
        own = self._own_canal(geometry, canal)
        self._canal_ = Sheet(zeta, self._reamed(geometry, own))

    def _own_canal(self, geometry: Any, canal: Surface | None) -> Floats:
        """Radii of the endosteum before reaming (n, `ANGLES`) [mm]."""
        zeta, outer = self._outer.zeta, self._outer.radii
        if canal is None:
            x = self._places(outer)
            size = float(self._placed.frame.to_model(self._placed.frame.head)[2]) / 54.0
            theta, z = np.arctan2(x[..., 1], x[..., 0]), x[..., 2] / size
            table = femur_bone.endosteum(0.0)(theta, z) / femur_bone.PERIOSTEUM.radius(theta, z)
            self.told.append("canal: by mantle's table of ratios, over the whole length")
            return np.asarray(outer * table)
        lid = self._lid(canal)
        radii, times = self._rays(canal, zeta)
        rows = np.flatnonzero((times > 0).all(axis=1) & (zeta < lid))
        if not len(rows) or zeta[rows[-1]] < -0.6 * geometry.implant.stem_length:
            text = "does not surround the stem; is it in the same axes as the bone?"
            raise GeometryError(f"geometry.canal.surface: {text}")
        if zeta[rows[0]] > self._plug - CORE_OVER:
            at = self._placed.where(self._placed.to_model(np.array([0.0, 0.0, zeta[rows[0]]])))
            raise GeometryError(
                f"geometry.canal.surface: ends at {at}, beside the stem or its plug; shorten the"
                " stem or give a longer canal"
            )
        part = gaussian_filter(
            _limited(_filled(radii[rows]), EVERY), BLUR, mode=("nearest", "wrap")
        )
        wall = outer[rows] - part
        if (worst := float(wall.min())) < 0.0:
            i, j = np.unravel_index(wall.argmin(), wall.shape)
            at = self._placed.where(self._places(outer)[rows[i], j])
            raise GeometryError(
                f"geometry.canal.surface: is {-worst:.1f} mm outside of the bone at {at}; expected"
                " it within the bone, in the same axes"
            )
        own = np.empty_like(outer)
        own[rows] = part
        own[: rows[0]] = outer[: rows[0]] * (part[0] / outer[rows[0]])
        above = np.clip((zeta[rows[-1] :] - zeta[rows[-1]]) / THINNING, 0.0, 1.0)[:, None]
        own[rows[-1] :] = outer[rows[-1] :] - (wall[-1] + above * (THIN - wall[-1]))
        top = self._placed.to_model(np.array([0.0, 0.0, zeta[rows[-1]]]))[2]
        self.told.append(
            f"canal: measured up to z = {top:.0f} mm; above, the cortex thins to {THIN:g} mm"
        )
        return own

    def _lid(self, canal: Surface) -> float:
        """Lowest section that meets the flat proximal end of a canal's surface [mm]."""
        a, b, c = canal.corners.transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        size = np.sqrt((normal**2).sum(axis=1))
        flat = normal[:, 2] > LID * size
        x = canal.points[canal.triangles[flat]].reshape(-1, 3) if flat.any() else canal.points
        x = x[x[:, 2] > x[:, 2].max() - 15.0]
        zeta = x[:, 2].copy()
        for _ in range(40):
            zeta = x[:, 2] + self._slope(zeta) * (x[:, 0] + self._lean * x[:, 1])
        return float(zeta.min() if flat.any() else zeta.max()) - EVERY

    def _reamed(self, geometry: Any, own: Floats) -> Floats:
        """Radii of the endosteum after reaming; what it takes of the cortex is told."""
        outer, zeta, ream = self._outer.radii, self._outer.zeta, geometry.canal.ream
        wanted = own
        if ream == "broach":
            wide = femur_stem.body(geometry.implant).offset(geometry.cement_thickness + BROACH)
            theta = np.broadcast_to(2 * np.pi * np.arange(ANGLES) / ANGLES, own.shape)
            slope = self._slope(zeta)[:, None] * (np.cos(theta) + self._lean * np.sin(theta))
            r = np.zeros_like(own)
            for _ in range(12):
                r = wide.radius(theta, zeta[:, None] - slope * r)
            wanted = np.maximum(own, r)
        elif ream != "none":
            wanted = own + geometry.canal.ream_by
        most = outer - np.maximum(LEAST_CORTEX, np.minimum(CORTEX, outer - own))
        made = np.minimum(wanted, most)
        # Below the plug the reamed canal goes over to the patient's own.
        depth = np.clip((self._plug - zeta) / CORE_OVER, 0.0, 1.0)[:, None]
        at = int(np.searchsorted(zeta, self._plug))
        loft = own + (made[at] - own[at]) * (1 - depth * depth * (3 - 2 * depth))
        made = np.where(zeta[:, None] < self._plug, np.minimum(loft, most), made)
        within = (zeta > self._plug) & (zeta < self._top)
        taken = np.where(within[:, None], made - own, 0.0)
        if (deep := float(taken.max())) > 0.05:
            i, j = np.unravel_index(taken.argmax(), taken.shape)
            at_ = self._placed.where(self._places(made)[i, j])
            self.told.append(f"reaming takes up to {deep:.1f} mm of the bone within, at {at_}")
        left = np.where(within[:, None], outer - made, np.inf)
        i, j = np.unravel_index(left.argmin(), left.shape)
        at_ = self._placed.where(self._places(outer)[i, j])
        self.told.append(f"least cortex: {left[i, j]:.1f} mm at {at_}")
        return np.asarray(gaussian_filter(made, BLUR, mode=("nearest", "wrap")))

    def _places(self, radii: Floats) -> Floats:
        """Points of the model at radii of the grid (n, `ANGLES`, 3) [mm]."""
        zeta = self._outer.zeta[:, None]
        theta = 2 * np.pi * np.arange(ANGLES) / ANGLES
        xy = self._centre(zeta[:, 0])[:, None] + radii[..., None] * np.stack(
            [np.cos(theta), np.sin(theta)], axis=1
        )
        z = zeta - self._slope(zeta) * (xy[..., 0] + self._lean * xy[..., 1])
        return self._placed.to_model(np.concatenate([xy, z[..., None]], axis=2))

    # Lines

    def _across(self, phi: Floats, s: Floats) -> Lines:
        zeta, slope = self.plane(s)
        theta, centre = 2 * np.pi * phi, self._centre(zeta)
        r = self._outer(theta, zeta)
        xy = centre + r[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=1)
        end = np.column_stack([xy, zeta - slope * (xy[:, 0] + self._lean * xy[:, 1])])
        below = s < self.mantle[0]
        at = np.where(below, float(self.mantle[0]), s)
        start = self._body.point(phi, *self.plane(at))
        if below.any():
            plug = np.full(int(below.sum()), self._plug)
            turn = np.arctan2(*start[below, 1::-1].T)
            depth = np.minimum((self._plug - zeta[below]) / CORE_OVER, 1.0)
            whole = self._canal_(turn, plug)
            ratio = np.hypot(*start[below, :2].T) / whole
            ratio += (CORE - ratio) * depth
            size = ratio * self._canal_(turn, zeta[below])
            start[below, :2] = centre[below] + size[:, None] * np.stack(
                [np.cos(turn), np.sin(turn)], axis=1
            )
            start[below, 2] = zeta[below]
        endosteum = root(self._inside(start, end, zeta, centre), np.ones(len(s)))
        mantle = np.empty(len(s))
        mantle[~below] = self._meets(self._grown.radius, start[~below], end[~below])
        if below.any():
            first = self._across(phi[below], at[below])
            share = first.mantle / first.endosteum
            deep = self._plug - zeta[below]
            share += (SPREAD - share) * np.minimum(1.0, deep / (4 * self.mesh.size))
            mantle[below] = share * endosteum[below]
        return Lines(start, end, mantle, endosteum)

    def _inside(
        self, start: Floats, end: Floats, zeta: Floats, centre: Floats
    ) -> Callable[[Floats, Ints], Floats]:
        """Depth within the endosteum at parts of lines [mm]."""

        def depth(part: Floats, k: Ints) -> Floats:
            xy = start[k, :2] + part[:, None] * (end - start)[k, :2] - centre[k]
            r = np.hypot(xy[:, 0], xy[:, 1])
            return np.asarray(self._canal_(np.arctan2(xy[:, 1], xy[:, 0]), zeta[k]) - r)

        return depth

    def _refuse(self) -> None:
        """Raise GeometryError where the stem has no room for cement."""
        along, around = np.linspace(self.tip, self.cut, 90), np.arange(72) / 72
        phi, s = (v.ravel() for v in np.meshgrid(around, along))
        lines, zeta = self._across(phi, s), self.plane(s)[0]
        depth = self._inside(lines.start, lines.end, zeta, np.zeros((len(s), 2)))
        inside = depth(np.zeros(len(s)), np.arange(len(s)))
        room = np.where(inside > 0, lines.endosteum * lines.length, inside)
        worst = int(room.argmin())
        if room[worst] >= LEAST_MANTLE:
            return
        x = self._placed.to_model(lines.start[worst])
        out = x - self._placed.to_model(np.array([0.0, 0.0, zeta[worst]]))
        side = SIDES[round(8 * np.arctan2(out[1], out[0]) / (2 * np.pi)) % 8]
        text = f"cuts {-room[worst]:.1f} mm into the cortex"
        if room[worst] >= 0:
            text = f"leaves {room[worst]:.1f} mm for cement of {LEAST_MANTLE:g} mm at least"
        raise GeometryError(
            f"geometry.insertion: the stem {text} {side} at {self._placed.where(x)}; ream"
            " (canal.ream: broach), take a smaller or shorter stem, or change varus and offsets"
        )


def _filled(radii: Floats) -> Floats:
    """Radii with what is missing taken from the section before."""
    radii = radii.copy()
    for i in range(1, len(radii)):
        radii[i] = np.where(np.isnan(radii[i]), radii[i - 1], radii[i])
    return radii


def _limited(radii: Floats, step: float) -> Floats:
    """Radii (n, `ANGLES`) cut down where they change faster than `STEEPEST` (along, around)."""
    turn = 1 + STEEPEST * 2 * np.pi / ANGLES
    while True:
        least = np.minimum(np.roll(radii, 1, axis=1), np.roll(radii, -1, axis=1)) * turn
        least[1:] = np.minimum(least[1:], radii[:-1] + STEEPEST * step)
        least[:-1] = np.minimum(least[:-1], radii[1:] + STEEPEST * step)
        if (radii <= least).all():
            return radii
        radii = np.minimum(radii, least)

