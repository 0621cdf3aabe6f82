"""Periosteum and endosteum of a patient's bone in the sections of a mesh.

Both are radii in each section, measured by rays that meet the triangles of the bone and of its
canal. The canal is then reamed. `meshes.bone_layers` describes the sections.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, Protocol

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import GeometryError
from app.foundation.implant import Implant
from app.patient.bone_surface import BoneSurface
from meshes.bone_layers import StemShape
from meshes.femur_bone import CORTEX_LEFT, FemurBone
from meshes.layers import CORE_OVER, Sections
from meshes.placement import Placement
from meshes.plane_sections import centroid, exits, section

EVERY = 2.0  # mm between sections
ANGLES = 96  # rays around
THETA = 2 * np.pi * np.arange(ANGLES) / ANGLES
GROOVE = 4.0  # mm: narrower gaps in the bone do not end a ray
TWICE = 0.02  # of the rays, at most, may meet the bone more than once
STEEPEST = 3.0  # slope of a surface along
AROUND = 1.5  # slope of a surface around
BLUR = 0.7  # samples over which radii are smoothed
THINNING = 35.0  # mm above the canal's end over which the cortex becomes thin
THIN = 2.0  # mm: thickness of the cortex there
LEAST_CORTEX = 1.5  # mm that reaming leaves where the patient has less than `CORTEX_LEFT`
BROACH = 0.3  # mm that a broach is wider than stem and mantle
CORE = 0.6  # of the canal's mean radius: the innermost surface below the plug
NARROW = 0.65  # of the canal's radius at any angle: the innermost surface at most
ROUGH = 1.5  # samples over which a canal is smoothed
OBLIQUE = 2.0  # at most, of a way through the cortex over its thickness
LID = 0.9  # component along the shaft of normals of a canal's flat end
NEAR_LID = 15.0  # mm from the canal's top, where its flat end is
ECCENTRIC = 10.0  # mm that a canal's middle is beside the bone's, at most
NO_LINES: Floats = np.zeros((0, 2, 2))


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


class Reaming(Protocol):
    """Keys that say how a canal is reamed."""

    @property
    def ream(self) -> Literal["none", "by", "broach"]:
        """Way of reaming."""

    @property
    def ream_by(self) -> float:
        """Distance of reaming with `by` [mm]."""


class MeasuredLayers:
    """Bone that is known by triangles: radii by rays in the sections."""

    def __init__(
        self,
        bone: BoneSurface,
        canal: BoneSurface | None,
        size: float,
        reaming: Reaming,
        implant: Implant,
        sections: Sections,
        stem: StemShape | None,
    ) -> None:
        """Measure the bone, then ream its canal.

        Args:
            bone: Its surface, in the model's axes.
            canal: Surface of its canal, or None: its width is then that of the parametric femur.
            size: Its size over that of the parametric femur.
            reaming: Keys that say how the canal is reamed.
            implant: The stem with its plug.
            sections: Sections of the mesh.
            stem: The stem and its mantle in the sections. None: the canal is as wide as a broach
                may make it for any stem.

        Raises:
            GeometryError: The stem's axis leaves the bone, or a surface crosses itself.
        """
        self.notes = list[str]()
        self._sections, self._placed = sections, sections.placed
        self._size, self._implant = size, implant
        outer = _in_stem(self._placed, bone)
        if canal is not None:
            canal = _in_stem(self._placed, canal)
        self._centres = self._middles(outer, canal)
        low = sections.zeta[0] - EVERY
        zeta = np.linspace(low, self._placed.top, int((self._placed.top - low) / EVERY) + 1)
        radii, times = self._rays(outer, zeta)
        missed = np.isnan(radii).any(axis=1)
        if missed.any():
            raise GeometryError(
                "geometry: the stem's axis is outside the bone at"
                f" {self._at_axis(zeta[missed].max())}; move or rotate the stem (insertion:"
                " offsets, varus), cut lower or flatter (resection), or repair the surface if it"
                " crosses itself there"
            )
        twice = (times > 2).mean()
        if twice > TWICE:
            where = self._at_axis(zeta[int(np.median(np.nonzero(times > 2)[0]))])
            raise GeometryError(
                f"geometry.bone: {100 * twice:.0f} % of rays across the bone meet its surface more"
                f" than once, near {where}: it crosses itself or has cavities; repair it in the"
                " program that wrote it"
            )
        self._bone = Radii(zeta, _limited(radii))
        canal_radii = self._table() if canal is None else self._measured(canal)
        self._endosteum = Radii(zeta, self._reamed(reaming, canal_radii, stem))

    def _middles(self, bone: BoneSurface, canal: BoneSurface | None) -> Floats:
        """Centres of the sections of the mesh (n, 2) [mm]: below the plug those of the canal."""
        zeta = self._sections.zeta
        centres = np.zeros((len(zeta), 2))
        for k in np.flatnonzero(zeta < self._sections.plug):
            middle = centroid(bone.level(zeta[k]))[0]
            lines = canal.level(zeta[k]) if canal else NO_LINES
            if len(lines):
                canal_middle = centroid(lines)[0]
                if np.hypot(*(canal_middle - middle)) < ECCENTRIC:
                    middle = canal_middle
            centres[k] = self._sections.below_plug(zeta[k]) * middle
        return centres

    def _centre(self, zeta: Floats) -> Floats:
        """Centre of the rays of sections (n, 2) [mm]: straight between stations."""
        columns = [np.interp(zeta, self._sections.zeta, c) for c in self._centres.T]
        return np.stack(columns, axis=1)

    def _at_axis(self, zeta: float) -> str:
        """A place on the stem's axis in words."""
        return self._placed.where(self._placed.to_model([0.0, 0.0, zeta]))

    def _rays(self, surface: BoneSurface, zeta: Floats) -> tuple[Floats, Ints]:
        """Radii of a surface in sections, and how often rays meet it (n, `ANGLES`)."""
        x, rise = surface.points, self._sections.rise(surface.points)
        slopes, centres = self._sections.slope(zeta), self._centre(zeta)
        met = []
        for z, slope, centre in zip(zeta, slopes, centres, strict=True):
            lines = section(x[:, :2], x[:, 2] + slope * rise - z, surface.triangles)
            met.append(exits(lines - centre, THETA, GROOVE))
        radii, times = (np.array(part) for part in zip(*met, strict=True))
        return radii, times

    def _table(self) -> Floats:
        """Radii of the endosteum by its ratio to the periosteum in the parametric femur [mm]."""
        x = self._places(self._bone.radii)
        theta = np.arctan2(x[..., 1], x[..., 0])
        z = np.asarray(x[..., 2] / self._size)
        self.notes.append("canal: with the ratios of the parametric femur")
        table = FemurBone()
        return np.asarray(self._bone.radii * table.endosteum(theta, z) / table.periosteum(theta, z))

    def _measured(self, canal: BoneSurface) -> Floats:
        """Radii of the endosteum by the canal's surface, and above it by a thinning cortex [mm]."""
        zeta, bone = self._bone.zeta, self._bone.radii
        radii, times = self._rays(canal, zeta)
        rows = np.flatnonzero((times > 0).all(axis=1) & (zeta < self._lid(canal)))
        if not len(rows) or zeta[rows[-1]] < self._implant.tip_z:
            aside = float(np.hypot(*canal.points.mean(axis=0)[:2]))
            text = f"does not surround the stem: its centre is {aside:.0f} mm from the stem's axis."
            raise GeometryError(f"geometry.canal.surface: {text} Is it in the axes of the bone?")
        first, last = rows[[0, -1]]
        if zeta[first] > self._sections.plug - CORE_OVER:
            raise GeometryError(
                f"geometry.canal.surface: ends at {self._at_axis(zeta[first])}, beside the stem or"
                " its plug; shorten the stem or give a longer canal"
            )
        canal_radii = gaussian_filter(
            _limited(radii[first : last + 1]), ROUGH, mode=("nearest", "wrap")
        )
        wall = bone[first : last + 1] - canal_radii
        if wall.min() < 0:
            i, j = np.unravel_index(wall.argmin(), wall.shape)
            raise GeometryError(
                f"geometry.canal.surface: is {-wall.min():.1f} mm outside the bone at"
                f" {self._placed.where(self._places(bone)[first + i, j])}; expected a canal inside"
                " the bone, in the same axes"
            )
        below = bone[:first] * (canal_radii[0] / bone[first])
        part = np.clip((zeta[last + 1 :, None] - zeta[last]) / THINNING, 0.0, 1.0)
        thin = THIN * self._oblique()[last + 1 :]
        above = bone[last + 1 :] - (wall[-1] + part * (thin - wall[-1]))
        top = self._placed.to_model([0.0, 0.0, zeta[last]])[2]
        self.notes.append(
            f"canal: measured up to z = {top:.0f} mm; above, the cortex thins to {THIN:g} mm"
        )
        return np.concatenate([below, canal_radii, above])

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
        zeta, rise = x[:, 2], self._sections.rise(x)
        for _ in range(40):
            zeta = x[:, 2] + self._sections.slope(zeta) * rise
        return float(zeta.min() if flat.any() else zeta.max()) - EVERY

    def _reamed(self, reaming: Reaming, canal: Floats, stem: StemShape | None) -> Floats:
        """Radii of the endosteum after reaming [mm]; notes say what it takes of the bone."""
        bone, zeta = self._bone.radii, self._bone.zeta
        most = bone - np.maximum(LEAST_CORTEX, np.minimum(CORTEX_LEFT, bone - canal))
        wanted = canal
        if reaming.ream == "by":
            wanted = canal + reaming.ream_by
        elif reaming.ream == "broach":
            wanted = np.maximum(canal, self._broached(stem)) if stem else most
        made = np.minimum(wanted, most)
        if stem is None:
            return made
        # Below the plug the reamed canal goes over to the patient's.
        depth = (zeta < self._sections.plug)[:, None]
        at = int(np.searchsorted(zeta, self._sections.plug))
        loft = canal + (made[at] - canal[at]) * (1 - self._sections.below_plug(zeta)[:, None])
        made = np.where(depth, np.minimum(loft, most), made)
        within = (zeta > self._sections.plug)[:, None]
        thicknesses = {
            "most bone removed by reaming": made - canal,
            "least bone left by reaming": made - bone,
        }
        for what, size in thicknesses.items():
            size = np.where(within, size, -np.inf)
            i, j = np.unravel_index(size.argmax(), size.shape)
            where = self._placed.where(self._places(made)[i, j])
            self.notes.append(f"{what}: {abs(size[i, j]):.1f} mm at {where}")
        return made

    def _broached(self, stem: StemShape) -> Floats:
        """Radii that a broach for stem and mantle leaves (n, `ANGLES`) [mm]."""
        theta, zeta = (v.ravel() for v in np.meshgrid(THETA, self._bone.zeta))
        start, end = stem.outline(theta / (2 * np.pi), self._sections, zeta), self.ends(theta, zeta)
        part = stem.covered(zeta, start, end, BROACH)
        x, y, _ = (start + part[:, None] * (end - start)).T.reshape(3, -1, ANGLES)
        rows = zip(np.arctan2(y, x), np.hypot(x, y), strict=True)
        return np.array([np.interp(THETA, turn, r, period=2 * np.pi) for turn, r in rows])

    def _on(self, theta: Floats, zeta: Floats, radii: Floats) -> Floats:
        """Points of sections, about their centres (..., 3) [mm]."""
        out = np.stack([np.cos(theta), np.sin(theta)], axis=-1)
        centre = self._centre(zeta.ravel()).reshape(*zeta.shape, 2)
        return self._sections.in_plane(centre + radii[..., None] * out, zeta)

    def _places(self, radii: Floats) -> Floats:
        """Points of the model at radii of the grid (n, `ANGLES`, 3) [mm]."""
        zeta = np.broadcast_to(self._bone.zeta[:, None], radii.shape)
        return self._placed.to_model(self._on(np.broadcast_to(THETA, radii.shape), zeta, radii))

    def ends(self, theta: Floats, zeta: Floats) -> Floats:
        """Points of the periosteum in sections (n, 3) [mm]."""
        return self._on(theta, zeta, self._bone(theta, zeta))

    def canal(self, theta: Floats, zeta: Floats) -> Floats:
        """Points of the endosteum in sections (n, 3) [mm]."""
        return self._on(theta, zeta, self._endosteum(theta, zeta))

    def depth(self, x: Floats, zeta: Floats) -> Floats:
        """Depth of points (n, 3) in sections within the endosteum (n,) [mm]."""
        dx, dy = (x[:, :2] - self._centre(zeta)).T
        return np.asarray(self._endosteum(np.arctan2(dy, dx), zeta) - np.hypot(dx, dy))

    def core(self, start: Floats, theta: Floats, zeta: Floats) -> Floats:
        """Points of the innermost surface below the plug (n, 3), at last a round one [mm].

        The canal is narrow and rough there.
        """
        x, below = start.copy(), zeta < self._sections.plug
        turn, level = np.arctan2(*start[below, 1::-1].T), zeta[below]
        depth = self._sections.plug - level
        ratio = np.hypot(*start[below, :2].T) / self._endosteum(turn, level + depth)
        part = np.minimum(depth / CORE_OVER, 1.0)
        turn += part * (np.mod(theta[below] - turn + np.pi, 2 * np.pi) - np.pi)
        levels, row = np.unique(level, return_inverse=True)
        around = (v.ravel() for v in np.meshgrid(THETA[::6], levels))
        mean = self._endosteum(*around).reshape(-1, ANGLES // 6).mean(axis=1)[row]
        canal = self._endosteum(turn, level)
        core = np.minimum(CORE * mean, NARROW * canal)
        x[below] = self._on(turn, level, ratio * canal + part * (core - ratio * canal))
        return x

    def check(self, start: Floats, end: Floats) -> None:
        """Accept all lines: how often rays meet bone was counted when it was measured."""


def _in_stem(placed: Placement, surface: BoneSurface) -> BoneSurface:
    """Return a surface of the model in the stem's axes."""
    return replace(surface, points=placed.to_stem(surface.points))


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
