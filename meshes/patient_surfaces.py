"""The nested surfaces of a patient's femur: radii by rays in the turned sections of the mesh.

In those sections, parallel to the neck cut near it, a ray meets the bone once, trochanters
included, where at a level of z it would meet it several times. Below the plug the shaft bows away
from the stem's axis: there the centre of the rays goes over to the canal's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import GeometryError
from meshes import femur_bone
from meshes.bone_surface import BoneSurface, centroid, exits, section
from meshes.femur_bone import CORTEX, PERIOSTEUM
from meshes.femur_surfaces import CORE_OVER, REACH, FemurSurfaces, root
from meshes.layers import Lines

EVERY = 2.0  # mm between sections
ANGLES = 96  # rays around
THETA = 2 * np.pi * np.arange(ANGLES) / ANGLES
GROOVE = 4.0  # mm: narrower gaps in the bone do not end a ray
TWICE = 0.02  # of the rays, at most, may meet the bone more than once
STEEPEST, AROUND = 3.0, 1.5  # slopes of a surface along and around
BLUR = 0.7  # samples
THINNING, THIN = 35.0, 2.0  # mm above the canal's end over which the cortex becomes so thin
LEAST_CORTEX = 1.5  # mm that reaming leaves where the patient has less than `CORTEX`
BROACH = 0.3  # mm that a broach is wider than stem and mantle
# The innermost surface below the plug: of the canal's mean radius, and of any radius at most.
CORE, NARROW = 0.6, 0.65
ROUGH = 1.5  # samples over which a canal is smoothed
OBLIQUE = 2.0  # at most, of a way through the cortex over its thickness
LID, NEAR_LID = 0.9, 15.0  # of the normal along the shaft: a canal's flat end; mm from its top
ECCENTRIC = 10.0  # mm that a canal's middle is beside the bone's, at most


class Radii:
    """A surface around the stem: a periodic bicubic spline of radii (n, `ANGLES`) [mm]."""

    def __init__(self, zeta: Floats, radii: Floats) -> None:
        self.zeta, self.radii = zeta, gaussian_filter(radii, BLUR, mode=("nearest", "wrap"))
        turns = np.arange(-4, ANGLES + 4)
        wrapped = self.radii[:, turns % ANGLES]
        self._spline = RectBivariateSpline(zeta, turns * THETA[1], wrapped)

    def __call__(self, theta: Floats, zeta: Floats) -> Floats:
        """Radii at angles and sections (n,) [mm]."""
        return np.asarray(self._spline.ev(zeta, np.mod(theta, 2 * np.pi)))


class PatientSurfaces(FemurSurfaces):
    """Nested surfaces, in the stem's axes, of a bone that is known by triangles."""

    _bone: Any
    _endosteum: Any
    key = "geometry.insertion"
    remedy = (
        "ream (canal.ream: broach), take a smaller or shorter stem, or change varus and offsets"
    )

    # Measuring

    def _centre(self, zeta: Floats) -> Floats:
        """Centre of the rays of sections (n, 2) [mm]: straight between stations."""
        return np.stack([np.interp(zeta, self._zeta, c) for c in self._centres.T], axis=1)

    def _in_stem(self, surface: BoneSurface) -> BoneSurface:
        return replace(surface, points=self._placed.to_stem(surface.points))

    def _at_axis(self, zeta: float) -> str:
        return self._placed.where(self._placed.to_model([0.0, 0.0, zeta]))

    def _rise(self, x: Floats) -> Floats:
        """What a slope of sections of 1 lowers points (..., 2) by [mm]."""
        return np.asarray(x[..., 0] + self._lean * x[..., 1])

    def _rays(self, surface: BoneSurface, zeta: Floats) -> tuple[Floats, Ints]:
        """Radii of a surface in sections, and how often rays meet it (n, `ANGLES`)."""
        x, rise = surface.points, self._rise(surface.points)
        found = []
        for z, slope, centre in zip(zeta, self._slope(zeta), self._centre(zeta), strict=True):
            lines = section(x[:, :2], x[:, 2] + slope * rise - z, surface.triangles)
            found.append(exits(lines - centre, THETA, GROOVE))
        radii, times = (np.array(part) for part in zip(*found, strict=True))
        return radii, times

    def _measure(self, geometry: Any) -> None:
        implant = geometry.implant
        self._plug = implant.stem_tip_z - implant.plug_length
        bone, canal = self._in_stem(self._placed.bone), None
        if self._placed.canal:
            canal = self._in_stem(self._placed.canal)
        self._centres = np.zeros((len(self._zeta), 2))
        for k, z in enumerate(self._zeta[: self.mantle[0]]):
            middle = centroid(bone.level(z))[0]
            if canal and len(lines := canal.level(z)):
                own = centroid(lines)[0]
                middle = own if np.hypot(*(own - middle)) < ECCENTRIC else middle
            part = min((self._plug - z) / CORE_OVER, 1.0)
            self._centres[k] = part * part * (3 - 2 * part) * middle
        low = self._zeta[0] - EVERY
        zeta = np.linspace(low, self._top, int((self._top - low) / EVERY) + 1)
        radii, times = self._rays(bone, zeta)
        if (missed := np.isnan(radii).any(axis=1)).any():
            raise GeometryError(
                "geometry: the stem's axis is outside of the bone at"
                f" {self._at_axis(zeta[missed].max())}; move or turn the stem (insertion: offsets,"
                " varus), cut lower or flatter (resection), or repair the surface, if it crosses"
                " itself there"
            )
        if (part := (times > 2).mean()) > TWICE:
            where = self._at_axis(zeta[int(np.median(np.nonzero(times > 2)[0]))])
            raise GeometryError(
                f"geometry.bone: {100 * part:.0f} % of rays across the bone meet its surface more"
                f" than once, about {where}: it crosses itself or has cavities; repair it where it"
                " was made"
            )
        self._bone = Radii(zeta, _limited(radii))
        own = self._own_canal(geometry, canal) if canal else self._table(geometry)
        self._endosteum = Radii(zeta, self._reamed(geometry, own))

    def _table(self, geometry: Any) -> Floats:
        """Radii of the endosteum by its ratio to the periosteum in the parametric femur [mm]."""
        x = self._places(self._bone.radii)
        theta = np.arctan2(x[..., 1], x[..., 0])
        z = np.asarray(x[..., 2] / self._placed.size)
        self.told.append("canal: by the ratios of mantle's own femur")
        ratio = femur_bone.endosteum(geometry.implant)(theta, z)
        return np.asarray(self._bone.radii * ratio / femur_bone.PERIOSTEUM.radius(theta, z))

    def _own_canal(self, geometry: Any, canal: BoneSurface) -> Floats:
        """Radii of the endosteum by the canal's surface, and above it by a thinning cortex [mm]."""
        zeta, bone = self._bone.zeta, self._bone.radii
        radii, times = self._rays(canal, zeta)
        rows = np.flatnonzero((times > 0).all(axis=1) & (zeta < self._lid(canal)))
        if not len(rows) or zeta[rows[-1]] < geometry.implant.stem_tip_z:
            aside = float(np.hypot(*canal.points.mean(axis=0)[:2]))
            text = f"does not surround the stem, and its middle is {aside:.0f} mm beside its axis;"
            raise GeometryError(f"geometry.canal.surface: {text} is it in the axes of the bone?")
        first, last = rows[[0, -1]]
        if zeta[first] > self._plug - CORE_OVER:
            raise GeometryError(
                f"geometry.canal.surface: ends at {self._at_axis(zeta[first])}, beside the stem or"
                " its plug; shorten the stem or give a longer canal"
            )
        own = gaussian_filter(_limited(radii[first : last + 1]), ROUGH, mode=("nearest", "wrap"))
        wall = bone[first : last + 1] - own
        if wall.min() < 0:
            i, j = np.unravel_index(wall.argmin(), wall.shape)
            raise GeometryError(
                f"geometry.canal.surface: is {-wall.min():.1f} mm outside of the bone at"
                f" {self._placed.where(self._places(bone)[first + i, j])}; expected within it, in"
                " the same axes"
            )
        below = bone[:first] * (own[0] / bone[first])
        part = np.clip((zeta[last + 1 :, None] - zeta[last]) / THINNING, 0.0, 1.0)
        thin = THIN * self._oblique()[last + 1 :]
        above = bone[last + 1 :] - (wall[-1] + part * (thin - wall[-1]))
        top = self._placed.to_model([0.0, 0.0, zeta[last]])[2]
        self.told.append(f"canal: measured up to z = {top:.0f} mm; above, cortex thins to {THIN:g}")
        return np.concatenate([below, own, above])

    def _oblique(self) -> Floats:
        """Ways of rays out of the bone over distances from its surface (n, `ANGLES`)."""
        theta, zeta = np.meshgrid(THETA, self._bone.zeta)
        x, out = (self._on(theta, zeta, self._bone.radii + r) for r in (0.0, 1.0))
        normal = np.cross(np.roll(x, -1, axis=1) - np.roll(x, 1, axis=1), np.gradient(x, axis=0))
        across = ((out - x) * normal).sum(axis=-1) / np.linalg.norm(normal, axis=-1)
        return np.asarray(np.clip(1 / np.abs(across), 1.0, OBLIQUE))

    def _lid(self, canal: BoneSurface) -> float:
        """Height of the lowest section that meets the flat proximal end of a canal [mm]."""
        a, b, c = canal.corners.transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        flat = normal[:, 2] > LID * np.sqrt((normal**2).sum(axis=1))
        x = canal.corners[flat].reshape(-1, 3) if flat.any() else canal.points
        x = x[x[:, 2] > x[:, 2].max() - NEAR_LID]
        zeta, rise = x[:, 2], self._rise(x)
        for _ in range(40):
            zeta = x[:, 2] + self._slope(zeta) * rise
        return float(zeta.min() if flat.any() else zeta.max()) - EVERY

    def _reamed(self, geometry: Any, own: Floats) -> Floats:
        """Radii of the endosteum after reaming [mm]; what it takes of the bone is told."""
        bone, zeta, ream = self._bone.radii, self._bone.zeta, geometry.canal.ream
        wanted = own + (geometry.canal.ream_by if ream == "by" else 0.0)
        if ream == "broach":
            wanted = np.maximum(own, self._broached())
        most = bone - np.maximum(LEAST_CORTEX, np.minimum(CORTEX, bone - own))
        made = np.minimum(wanted, most)
        # Below the plug the reamed canal goes over to the patient's own.
        depth = np.clip((self._plug - zeta) / CORE_OVER, 0.0, 1.0)[:, None]
        at = int(np.searchsorted(zeta, self._plug))
        loft = own + (made[at] - own[at]) * (1 - depth * depth * (3 - 2 * depth))
        made = np.where(depth > 0, np.minimum(loft, most), made)
        within = (zeta > self._plug)[:, None]
        for what, size in ("taken within by reaming, at most", made - own), ("left", made - bone):
            size = np.where(within, size, -np.inf)
            i, j = np.unravel_index(size.argmax(), size.shape)
            where = self._placed.where(self._places(made)[i, j])
            self.told.append(f"bone {what}: {abs(size[i, j]):.1f} mm at {where}")
        return made

    def _broached(self) -> Floats:
        """Radii that a broach for stem and mantle leaves (n, `ANGLES`) [mm]."""
        theta, zeta = (v.ravel() for v in np.meshgrid(THETA, self._bone.zeta))
        slope = self._slope(zeta)
        start, end = self._outline(theta / (2 * np.pi), zeta, slope), self._ends(theta, zeta, slope)
        part = self._covered(zeta, start, end, BROACH)
        x, y, _ = (start + part[:, None] * (end - start)).T.reshape(3, -1, ANGLES)
        rows = zip(np.arctan2(y, x), np.hypot(x, y), strict=True)
        return np.array([np.interp(THETA, turn, r, period=2 * np.pi) for turn, r in rows])

    def _on(self, theta: Floats, zeta: Floats, radii: Floats) -> Floats:
        """Points of sections, about their centres (..., 3) [mm]."""
        out = np.stack([np.cos(theta), np.sin(theta)], axis=-1)
        xy = self._centre(zeta.ravel()).reshape(*zeta.shape, 2) + radii[..., None] * out
        z = zeta - self._slope(zeta) * self._rise(xy)
        return np.concatenate([xy, z[..., None]], axis=-1)

    def _places(self, radii: Floats) -> Floats:
        """Points of the model at radii of the grid (n, `ANGLES`, 3) [mm]."""
        zeta = np.broadcast_to(self._bone.zeta[:, None], radii.shape)
        return self._placed.to_model(self._on(np.broadcast_to(THETA, radii.shape), zeta, radii))

    # Lines

    def _ends(self, theta: Floats, zeta: Floats, slope: Floats) -> Floats:
        return self._on(theta, zeta, self._bone(theta, zeta))

    def _inside(self, x: Floats, zeta: Floats) -> Floats:
        dx, dy = (x[:, :2] - self._centre(zeta)).T
        return np.asarray(self._endosteum(np.arctan2(dy, dx), zeta) - np.hypot(dx, dy))

    def _sink(self, start: Floats, theta: Floats, zeta: Floats, depth: Floats) -> Floats:
        """The innermost surface below the plug, which goes over to a round one of radial lines.

        The canal is narrow and rough there.
        """
        x, below = start.copy(), depth > 0
        turn, level = np.arctan2(*start[below, 1::-1].T), zeta[below]
        ratio = np.hypot(*start[below, :2].T) / self._endosteum(turn, level + depth[below])
        part = np.minimum(depth[below] / CORE_OVER, 1.0)
        turn += part * (np.mod(theta[below] - turn + np.pi, 2 * np.pi) - np.pi)
        levels, own = np.unique(level, return_inverse=True)
        around = (v.ravel() for v in np.meshgrid(THETA[::6], levels))
        mean = self._endosteum(*around).reshape(-1, ANGLES // 6).mean(axis=1)[own]
        canal = self._endosteum(turn, level)
        core = np.minimum(CORE * mean, NARROW * canal)
        x[below] = self._on(turn, level, ratio * canal + part * (core - ratio * canal))
        return x

    def _check(self, lines: Lines) -> None:
        """Nothing: `_measure` counts how often rays meet bone."""


@lru_cache(maxsize=2)
def kept(geometry: Any, mesh: Any, files: tuple[str, str]) -> PatientSurfaces:
    """The surfaces of a patient; with a stem from CAD they take some seconds."""
    return PatientSurfaces(geometry, mesh)


def _limited(radii: Floats) -> Floats:
    """Radii (n, `ANGLES`) with slopes up to `STEEPEST` and `AROUND`; gaps take those below."""
    radii, turn = radii.copy(), 1 + AROUND * THETA[1]
    for i in range(1, len(radii)):
        radii[i] = np.where(np.isnan(radii[i]), radii[i - 1], radii[i])
    while True:
        least = np.minimum(np.roll(radii, 1, axis=1), np.roll(radii, -1, axis=1)) * turn
        least[1:] = np.minimum(least[1:], radii[:-1] + STEEPEST * EVERY)
        least[:-1] = np.minimum(least[:-1], radii[1:] + STEEPEST * EVERY)
        if (radii <= least).all():
            return radii
        radii = np.minimum(radii, least)


class InsertedSurfaces(PatientSurfaces):
    """The same of the parametric femur, by its functions at places of its own axes."""

    remedy = "change insertion, widen the canal (canal_widening), or take a smaller or shorter stem"
    _check, _inside = FemurSurfaces._check, FemurSurfaces._inside

    def _measure(self, geometry: Any) -> None:
        implant, placed = geometry.implant, self._placed
        plug = implant.stem_tip_z - implant.plug_length
        low, way = placed.to_stem(np.zeros(3)), placed.turn[2]  # the shaft's axis
        part = np.clip((plug - self._zeta) / CORE_OVER, 0.0, 1.0)
        shaft = low[:2] + np.outer((self._zeta - low[2]) / way[2], way[:2])
        self._centres = (part * part * (3 - 2 * part))[:, None] * shaft
        self._periosteum = PERIOSTEUM
        self._canal = femur_bone.endosteum(geometry.model_copy(update={"anteversion": 0.0}))
        self._bone = partial(self._met, PERIOSTEUM.radius)
        self._endosteum = partial(self._met, self._canal)

    def _met(self, radius: Callable[..., Floats], theta: Floats, zeta: Floats) -> Floats:
        """Radii of a surface in sections (n,) [mm]."""
        return root(
            lambda r, k: self._within(radius, self._on(theta[k], zeta[k], r)),
            np.full(len(theta), REACH),
        )

    def _within(self, radius: Callable[[Floats, Floats], Floats], points: Floats) -> Floats:
        return super()._within(radius, self._placed.to_model(points))
