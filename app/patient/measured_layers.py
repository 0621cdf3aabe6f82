"""Periosteum and endosteum of a patient's bone in the sections of a mesh.

Both are radii in each section, measured by rays that meet the triangles of the bone and of its
canal. The canal is then reamed. `meshes.bone_layers` describes the sections.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import GeometryError
from app.foundation.implant import Implant
from app.patient.bone_surface import BoneSurface
from meshes.bone_layers import StemShape
from meshes.femur_bone import CONE_END, CORTEX_LEFT, FemurBone
from meshes.layers import CORE_OVER, Sections
from meshes.placement import Placement
from meshes.plane_sections import centroid, exits, lines_at_height

if TYPE_CHECKING:
    from app.patient.geometry import Canal

SECTION_STEP = 2.0  # mm between sections
ANGLES = 96  # rays around
THETA = 2 * np.pi * np.arange(ANGLES) / ANGLES
GROOVE_WIDTH = 4.0  # mm: narrower gaps in the bone do not end a ray
TWICE_MET_SHARE = 0.02  # largest share of rays that may meet the bone more than once
STEEPEST_ALONG = 3.0  # slope of a surface along
STEEPEST_AROUND = 1.5  # slope of a surface around
RADIUS_SMOOTHING = 0.7  # samples over which radii are smoothed
THINNING_LENGTH = 35.0  # mm above the canal's end over which the cortex becomes thin
THIN_CORTEX = 2.0  # mm: thickness of the cortex there
LEAST_CORTEX = 1.5  # mm that reaming leaves where the patient has less than `CORTEX_LEFT`
BROACH_OVERSIZE = 0.3  # mm that a broach is wider than stem and mantle
# Radius of the innermost surface below the plug over the canal's mean radius.
CORE_SHARE = 0.6
# Its largest value over the canal's radius at the same angle.
NARROWEST_SHARE = 0.65
CANAL_SMOOTHING = 1.5  # samples over which a canal is smoothed
LEAST_REMOVED = 0.05  # mm of bone: less is printed as 0.0
MOST_OBLIQUE = 2.0  # largest length of a ray through the cortex over the thickness
LID_COSINE = 0.9  # least component along the shaft of normals of a canal's flat end
LID_DISTANCE = 15.0  # mm from the canal's top within which its flat end is
MOST_ECCENTRIC = 10.0  # mm: largest distance of a canal's centre from the bone's
NO_LINES: Floats = np.zeros((0, 2, 2))


class Radii:
    """A surface around the stem: a periodic bicubic spline of radii (n, `ANGLES`) [mm]."""

    def __init__(self, zeta: Floats, radii: Floats) -> None:
        self.zeta, self.radii = (
            zeta,
            gaussian_filter(radii, RADIUS_SMOOTHING, mode=("nearest", "wrap")),
        )
        columns = np.arange(-4, ANGLES + 4)
        wrapped = self.radii[:, columns % ANGLES]
        self._spline = RectBivariateSpline(zeta, columns * THETA[1], wrapped)

    def __call__(self, theta: Floats, zeta: Floats) -> Floats:
        """Radii at angles and sections (n,) [mm]."""
        return np.asarray(self._spline.ev(zeta, np.mod(theta, 2 * np.pi)))


class MeasuredLayers:
    """Bone that is known by triangles: radii by rays in the sections."""

    def __init__(
        self,
        bone: BoneSurface,
        canal: BoneSurface | None,
        canal_scale: float,
        size: float,
        reaming: Canal,
        implant: Implant,
        sections: Sections,
        stem: StemShape | None,
    ) -> None:
        """Measure the bone, then ream its canal.

        Args:
            bone: Its surface, in the model's axes.
            canal: Surface of its canal, or None: it then has the ratios of the parametric femur.
            canal_scale: Factor to these ratios in the shaft [-].
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
        self._sections, self._placement = sections, sections.placement
        self._size, self._implant = size, implant
        outer = _in_stem(self._placement, bone)
        if canal is not None:
            canal = _in_stem(self._placement, canal)
        self._centres = self._section_centres(outer, canal)
        lowest = sections.zeta[0] - SECTION_STEP
        zeta = np.linspace(
            lowest, self._placement.top, int((self._placement.top - lowest) / SECTION_STEP) + 1
        )
        radii, crossings = self._rays(outer, zeta)
        is_missed = np.isnan(radii).any(axis=1)
        if is_missed.any():
            raise GeometryError(
                "geometry: the stem's axis is outside the bone at"
                f" {self._place_on_axis(zeta[is_missed].max())}; move or rotate"
                " the stem (insertion:"
                " offsets, varus), cut lower or flatter (resection), or repair the surface if it"
                " crosses itself there"
            )
        twice_met = (crossings > 2).mean()
        if twice_met > TWICE_MET_SHARE:
            location = self._place_on_axis(zeta[int(np.median(np.nonzero(crossings > 2)[0]))])
            raise GeometryError(
                f"geometry.bone: {100 * twice_met:.0f} % of rays across the bone"
                " meet its surface more"
                f" than once, near {location}: it crosses itself or has cavities; repair it in the"
                " program that wrote it"
            )
        self._bone = Radii(zeta, _with_limited_slopes(radii))
        canal_radii = (
            self._parametric_radii(canal_scale) if canal is None else self._measured_canal(canal)
        )
        self._endosteum = Radii(zeta, self._reamed_radii(reaming, canal_radii, stem))

    def _section_centres(self, bone: BoneSurface, canal: BoneSurface | None) -> Floats:
        """Centres of the sections of the mesh (n, 2) [mm]: below the plug those of the canal."""
        zeta = self._sections.zeta
        centres = np.zeros((len(zeta), 2))
        for k in np.flatnonzero(zeta < self._sections.plug):
            middle = centroid(bone.level(zeta[k]))[0]
            lines = canal.level(zeta[k]) if canal else NO_LINES
            if len(lines):
                canal_middle = centroid(lines)[0]
                if np.hypot(*(canal_middle - middle)) < MOST_ECCENTRIC:
                    middle = canal_middle
            centres[k] = self._sections.below_plug(zeta[k]) * middle
        return centres

    def _centre(self, zeta: Floats) -> Floats:
        """Centre of the rays of sections (n, 2) [mm]: straight between stations."""
        columns = [np.interp(zeta, self._sections.zeta, c) for c in self._centres.T]
        return np.stack(columns, axis=1)

    def _place_on_axis(self, zeta: float) -> str:
        """A place on the stem's axis in words."""
        return self._placement.point_in_words(self._placement.to_model([0.0, 0.0, zeta]))

    def _rays(self, surface: BoneSurface, zeta: Floats) -> tuple[Floats, Ints]:
        """Radii of a surface in sections, and the number of crossings of each ray (n, `ANGLES`)."""
        x, rise = surface.points, self._sections.rise(surface.points)
        slopes, centres = self._sections.slope(zeta), self._centre(zeta)
        ray_results = []
        for z, slope, centre in zip(zeta, slopes, centres, strict=True):
            lines = lines_at_height(x[:, :2], x[:, 2] + slope * rise - z, surface.triangles)
            ray_results.append(exits(lines - centre, THETA, GROOVE_WIDTH))
        radii, crossings = (np.array(column) for column in zip(*ray_results, strict=True))
        return radii, crossings

    def _parametric_radii(self, canal_scale: float) -> Floats:
        """Radii of the endosteum by its ratio to the periosteum in the parametric femur [mm].

        In the metaphysis the cortex is as thin as above a measured canal. In the shaft a factor
        scales them; between 0 and the end of the cone it goes over to 1.
        """
        x = self._grid_points(self._bone.radii)
        theta = np.arctan2(x[..., 1], x[..., 0])
        z = np.asarray(x[..., 2] / self._size)
        self.notes.append(
            "canal: with the ratios of the parametric femur; in the metaphysis the cortex thins to"
            f" {THIN_CORTEX:g} mm"
        )
        table = FemurBone(cortex=THIN_CORTEX)
        ratio = table.endosteum(theta, z) / table.periosteum(theta, z)
        scale = 1.0 + np.clip(z / CONE_END, 0.0, 1.0) * (canal_scale - 1.0)
        bone = self._bone.radii
        widest = np.maximum(bone - LEAST_CORTEX, ratio * bone)
        return np.asarray(np.minimum(scale * ratio * bone, widest))

    def _measured_canal(self, canal: BoneSurface) -> Floats:
        """Radii of the endosteum by the canal's surface, and above it by a thinning cortex [mm]."""
        zeta, bone = self._bone.zeta, self._bone.radii
        radii, crossings = self._rays(canal, zeta)
        rows = np.flatnonzero((crossings > 0).all(axis=1) & (zeta < self._lid_height(canal)))
        if not len(rows) or zeta[rows[-1]] < self._implant.tip_z:
            distance = float(np.hypot(*canal.points.mean(axis=0)[:2]))
            fault = (
                f"does not surround the stem: its centre is {distance:.0f} mm from the stem's axis."
            )
            raise GeometryError(f"geometry.canal: {fault} Is it in the axes of the bone?")
        first_row, last_row = rows[[0, -1]]
        if zeta[first_row] > self._sections.plug - CORE_OVER:
            raise GeometryError(
                "geometry.canal: ends at"
                f" {self._place_on_axis(zeta[first_row])}, beside the stem or"
                " its plug; shorten the stem or give a longer canal"
            )
        canal_radii = gaussian_filter(
            _with_limited_slopes(radii[first_row : last_row + 1]),
            CANAL_SMOOTHING,
            mode=("nearest", "wrap"),
        )
        wall = bone[first_row : last_row + 1] - canal_radii
        if wall.min() < 0:
            i, j = np.unravel_index(wall.argmin(), wall.shape)
            raise GeometryError(
                f"geometry.canal: is {-wall.min():.1f} mm outside the bone at"
                f" {self._placement.point_in_words(self._grid_points(bone)[first_row + i, j])};"
                " expected a canal inside"
                " the bone, in the same axes"
            )
        radii_below = bone[:first_row] * (canal_radii[0] / bone[first_row])
        thinned_part = np.clip(
            (zeta[last_row + 1 :, None] - zeta[last_row]) / THINNING_LENGTH, 0.0, 1.0
        )
        thin_wall = THIN_CORTEX * self._obliquity()[last_row + 1 :]
        radii_above = bone[last_row + 1 :] - (wall[-1] + thinned_part * (thin_wall - wall[-1]))
        canal_top = float(self._placement.to_model(canal.points)[:, 2].max())
        section_top = float(self._placement.to_model([0.0, 0.0, zeta[last_row]])[2])
        self.notes.append(
            f"canal: measured up to z = {canal_top:.0f} mm, and in whole sections of the mesh up to"
            f" {section_top:.0f} mm; above these, the cortex thins to {THIN_CORTEX:g} mm"
        )
        return np.concatenate([radii_below, canal_radii, radii_above])

    def _obliquity(self) -> Floats:
        """Length of each ray through the cortex over the thickness there (n, `ANGLES`)."""
        theta, zeta = np.meshgrid(THETA, self._bone.zeta)
        x, outer = (self._section_points(theta, zeta, self._bone.radii + r) for r in (0.0, 1.0))
        normal = np.cross(np.roll(x, -1, axis=1) - np.roll(x, 1, axis=1), np.gradient(x, axis=0))
        normal_distance = ((outer - x) * normal).sum(axis=-1) / np.linalg.norm(normal, axis=-1)
        return np.asarray(np.clip(1 / np.abs(normal_distance), 1.0, MOST_OBLIQUE))

    def _lid_height(self, canal: BoneSurface) -> float:
        """Height of the lowest section that meets the flat proximal end of a canal [mm]."""
        a, b, c = canal.corners.transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        is_flat = normal[:, 2] > LID_COSINE * np.sqrt((normal**2).sum(axis=1))
        x = canal.corners[is_flat].reshape(-1, 3) if is_flat.any() else canal.points
        x = x[x[:, 2] > x[:, 2].max() - LID_DISTANCE]
        zeta, rise = x[:, 2], self._sections.rise(x)
        for _ in range(40):
            zeta = x[:, 2] + self._sections.slope(zeta) * rise
        return float(zeta.min() if is_flat.any() else zeta.max()) - SECTION_STEP

    def _reamed_radii(self, reaming: Canal, canal: Floats, stem: StemShape | None) -> Floats:
        """Radii of the endosteum after reaming [mm].

        Notes report the removed and the remaining bone.
        """
        bone, zeta = self._bone.radii, self._bone.zeta
        largest_radii = bone - np.maximum(LEAST_CORTEX, np.minimum(CORTEX_LEFT, bone - canal))
        target_radii = canal
        if reaming.ream == "by":
            target_radii = canal + reaming.ream_by
        elif reaming.ream == "broach":
            target_radii = np.maximum(canal, self._broached_radii(stem)) if stem else largest_radii
        reamed = np.minimum(target_radii, largest_radii)
        if stem is None:
            return reamed
        # Below the plug the reamed canal goes over to the patient's.
        is_below_plug = (zeta < self._sections.plug)[:, None]
        plug_row = int(np.searchsorted(zeta, self._sections.plug))
        loft = canal + (reamed[plug_row] - canal[plug_row]) * (
            1 - self._sections.below_plug(zeta)[:, None]
        )
        reamed = np.where(is_below_plug, np.minimum(loft, largest_radii), reamed)
        is_beside_stem = (zeta > self._sections.plug)[:, None]
        thicknesses = {"least bone around the canal": reamed - bone}
        if reaming.ream != "none":
            thicknesses = {
                "most bone removed by reaming": reamed - canal,
                "least bone left by reaming": reamed - bone,
            }
        for title, thickness in thicknesses.items():
            thickness = np.where(is_beside_stem, thickness, -np.inf)
            i, j = np.unravel_index(thickness.argmax(), thickness.shape)
            if 0.0 <= thickness[i, j] < LEAST_REMOVED:
                continue
            location = self._placement.point_in_words(self._grid_points(reamed)[i, j])
            self.notes.append(f"{title}: {abs(thickness[i, j]):.1f} mm at {location}")
        return reamed

    def _broached_radii(self, stem: StemShape) -> Floats:
        """Radii that a broach for stem and mantle leaves (n, `ANGLES`) [mm]."""
        theta, zeta = (v.ravel() for v in np.meshgrid(THETA, self._bone.zeta))
        start, end = stem.outline(theta / (2 * np.pi), self._sections, zeta), self.ends(theta, zeta)
        broached_part = stem.covered(zeta, start, end, BROACH_OVERSIZE)
        x, y, _ = (start + broached_part[:, None] * (end - start)).T.reshape(3, -1, ANGLES)
        rows = zip(np.arctan2(y, x), np.hypot(x, y), strict=True)
        return np.array(
            [np.interp(THETA, angle, radius, period=2 * np.pi) for angle, radius in rows]
        )

    def _section_points(self, theta: Floats, zeta: Floats, radii: Floats) -> Floats:
        """Points of sections, about their centres (..., 3) [mm]."""
        directions = np.stack([np.cos(theta), np.sin(theta)], axis=-1)
        centre = self._centre(zeta.ravel()).reshape(*zeta.shape, 2)
        return self._sections.in_plane(centre + radii[..., None] * directions, zeta)

    def _grid_points(self, radii: Floats) -> Floats:
        """Points of the model at radii of the grid (n, `ANGLES`, 3) [mm]."""
        zeta = np.broadcast_to(self._bone.zeta[:, None], radii.shape)
        return self._placement.to_model(
            self._section_points(np.broadcast_to(THETA, radii.shape), zeta, radii)
        )

    def ends(self, theta: Floats, zeta: Floats) -> Floats:
        """Points of the periosteum in sections (n, 3) [mm]."""
        return self._section_points(theta, zeta, self._bone(theta, zeta))

    def canal(self, theta: Floats, zeta: Floats) -> Floats:
        """Points of the endosteum in sections (n, 3) [mm]."""
        return self._section_points(theta, zeta, self._endosteum(theta, zeta))

    def depth(self, x: Floats, zeta: Floats) -> Floats:
        """Depth of points (n, 3) in sections within the endosteum (n,) [mm]."""
        dx, dy = (x[:, :2] - self._centre(zeta)).T
        return np.asarray(self._endosteum(np.arctan2(dy, dx), zeta) - np.hypot(dx, dy))

    def core(self, start: Floats, theta: Floats, zeta: Floats) -> Floats:
        """Points of the innermost surface below the plug (n, 3) [mm].

        The canal is narrow and rough there, so the surface becomes round.
        """
        x, is_below = start.copy(), zeta < self._sections.plug
        angle, level = np.arctan2(*start[is_below, 1::-1].T), zeta[is_below]
        depth = self._sections.plug - level
        ratio = np.hypot(*start[is_below, :2].T) / self._endosteum(angle, level + depth)
        rounded_part = np.minimum(depth / CORE_OVER, 1.0)
        angle += rounded_part * (np.mod(theta[is_below] - angle + np.pi, 2 * np.pi) - np.pi)
        levels, row = np.unique(level, return_inverse=True)
        ring_grid = (v.ravel() for v in np.meshgrid(THETA[::6], levels))
        mean_radius = self._endosteum(*ring_grid).reshape(-1, ANGLES // 6).mean(axis=1)[row]
        canal = self._endosteum(angle, level)
        core = np.minimum(CORE_SHARE * mean_radius, NARROWEST_SHARE * canal)
        x[is_below] = self._section_points(
            angle, level, ratio * canal + rounded_part * (core - ratio * canal)
        )
        return x

    def check(self, start: Floats, end: Floats) -> None:
        """Accept all lines. Crossings of rays were counted when the bone was measured."""


def _in_stem(placement: Placement, surface: BoneSurface) -> BoneSurface:
    """Return a surface of the model in the stem's axes."""
    return replace(surface, points=placement.to_stem(surface.points))


def _with_limited_slopes(radii: Floats) -> Floats:
    """Radii (n, `ANGLES`) with slopes up to `STEEPEST_ALONG` and `STEEPEST_AROUND`.

    Gaps take the radii below them.
    """
    radii, around_factor = radii.copy(), 1 + STEEPEST_AROUND * THETA[1]
    for i in range(1, len(radii)):
        radii[i] = np.where(np.isnan(radii[i]), radii[i - 1], radii[i])
    while True:
        largest_radii = (
            np.minimum(np.roll(radii, 1, axis=1), np.roll(radii, -1, axis=1)) * around_factor
        )
        largest_radii[1:] = np.minimum(
            largest_radii[1:], radii[:-1] + STEEPEST_ALONG * SECTION_STEP
        )
        largest_radii[:-1] = np.minimum(
            largest_radii[:-1], radii[1:] + STEEPEST_ALONG * SECTION_STEP
        )
        if (radii <= largest_radii).all():
            return radii
        radii = np.minimum(radii, largest_radii)
