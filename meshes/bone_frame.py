"""Landmarks and axes of a femur from the triangles of its surface.

The head is a sphere, found by pairs of points with normals; the shaft a line through centroids of
sections; the lesser trochanter the most prominent peak of the outline's reach along the shaft; the
neck the plane of least area. All lengths go with the head's radius, so that size does not matter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares, minimize
from scipy.signal import find_peaks
from scipy.spatial import cKDTree

from app.arrays import Floats
from app.errors import GeometryError
from meshes.bone_surface import Surface, centroid, exits, section

RADII = (14.0, 36.0)  # mm: of heads
END = 90.0  # mm from an end of the bone within which its head is
SAMPLES, PAIRS = 2.5, 1500  # mm between samples; pairs of them tried
SMOOTH = 4.0  # mm over which normals are averaged
NEAR, ALONG = 1.0, math.cos(math.radians(18.0))  # mm and normals that belong to a sphere
COVERED = 0.28  # of a sphere, at least, by a head
CAP = math.cos(math.radians(90.0))  # half opening of the part of the head that is fitted
ROBUST = 0.5  # mm: residuals beyond it count less
# In radii of the head:
SHAFT = (0.8, 2.7)  # below the lesser trochanter, where the shaft's axis is
TROCHANTER = (0.8, 3.4)  # below the head's centre, where the lesser trochanter is
CONDYLES = 3.0  # above the distal end
LONG = 11.0  # length of a bone that has condyles
STEP = 1.5  # mm between sections that are searched for the lesser trochanter
REACH = 0.7  # mm: decay of the weights of an outermost place
BESIDE = (-4.5, -1.5, 1.5, 4.5)  # mm: sections of the neck beside the least one, averaged
SECTORS = 12  # of the head, one left out at a time


@dataclass(frozen=True)
class Frame:
    """Landmarks of a femur and the axes of its model, medial, anterior and proximal.

    Attributes:
        head: Centre of the head (3,) [mm], in the surface's axes as all below.
        radius: Of the head [mm].
        origin: Point of the shaft's axis at the level of the lesser trochanter (3,) [mm].
        axes: Unit vectors medial, anterior, proximal (rows) (3, 3); a right femur's are left-handed.
        neck: Unit vector along the neck to the head (3,).
        trochanter: Apex of the lesser trochanter (3,) [mm].
        side: ``left`` or ``right``.
        version: Angle of the neck to anterior of the condyles [rad]; None without condyles: then
            medial is along the neck.
        spread: Of 90 %: head, radius, trochanter [mm], neck, version [rad].
    """

    head: Floats
    radius: float
    origin: Floats
    axes: Floats
    neck: Floats
    trochanter: Floats
    side: str
    version: float | None
    spread: Mapping[str, float]

    def to_model(self, x: Floats) -> Floats:
        """Points (..., 3) in the model's axes, a right femur mirrored."""
        return np.asarray((x - self.origin) @ self.axes.T)

    @property
    def azimuth(self) -> float:
        """Angle of the neck to anterior of medial, about the shaft [rad]."""
        x, y, _ = self.axes @ self.neck
        return math.atan2(y, x)

    @property
    def neck_shaft(self) -> float:
        """Angle between neck and shaft [rad]."""
        return math.acos(-float(self.axes[2] @ self.neck))

    def surface(self, surface: Surface) -> Surface:
        """A surface in the model's axes, still outward."""
        triangles = surface.triangles
        if np.linalg.det(self.axes) < 0:
            triangles = triangles[:, ::-1]
        return replace(surface, points=self.to_model(surface.points), triangles=triangles)

    @property
    def lines(self) -> tuple[str, ...]:
        """What was found, in words, with the spread of 90 %."""
        degrees, s = math.degrees, self.spread
        version = "unknown without condyles: medial is along the neck"
        if self.version is not None:
            version = f"{degrees(self.version):.1f} deg +- {degrees(s['version']):.1f}"
        head = ", ".join(f"{v:.1f}" for v in self.head)
        small = ", ".join(f"{v:.1f}" for v in self.trochanter)
        return (
            f"side: {self.side}" + (", mirrored" if self.side == "right" else ""),
            f"head: ({head}) mm +- {s['head']:.1f}, radius {self.radius:.1f} mm",
            f"lesser trochanter: ({small}) mm",
            f"neck-shaft angle: {degrees(self.neck_shaft):.1f} deg +- {degrees(s['neck']):.1f}",
            f"version: {version}",
        )


class _Bone:
    """Triangles of a femur by their areas, centres and normals."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        a, b, c = surface.corners.transpose(1, 0, 2)
        normal = 0.5 * np.cross(b - a, c - a)
        self.area = _far(normal)
        self.centre = (a + b + c) / 3
        self._normal = normal

    @cached_property
    def samples(self) -> tuple[Floats, Floats, Floats]:
        """Centres (q, 3), averaged unit normals (q, 3) and areas (q,) of boxes of `SAMPLES`."""
        box = np.floor((self.centre - self.centre.min(axis=0)) / SAMPLES).astype(np.int64)
        of = np.unique(box, axis=0, return_inverse=True)[1].ravel()
        area = np.bincount(of, self.area)
        x, normal = (
            np.stack([np.bincount(of, v[:, i]) for i in range(3)], axis=1)
            for v in (self.area[:, None] * self.centre, self._normal)
        )
        x /= area[:, None]
        tree = cKDTree(x)
        normal = normal + tree.sparse_distance_matrix(tree, SMOOTH).tocsr().sign() @ normal
        return x, normal / np.linalg.norm(normal, axis=1)[:, None], area

    def outermost(self, way: Floats, within: Any) -> Floats:
        """Mean place (3,) of what reaches farthest in a direction, of marked triangles."""
        x, area = self.centre[within], self.area[within]
        reach = x @ way
        weight = area * np.exp((reach - reach.max()) / REACH)
        return np.asarray(weight @ x / weight.sum())

    def across(self, point: Floats, axis: Floats) -> Floats:
        """Lines (k, 2, 2) of the section through a point across an axis, about the point."""
        x = (self.surface.points - point) @ np.column_stack([*_across(axis), axis])
        return section(x[:, :2], x[:, 2], self.surface.triangles)


def _across(axis: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors that are right-handed with an axis (3,)."""
    one = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    one /= np.linalg.norm(one)
    return one, np.cross(axis, one)


def _far(x: Floats) -> Floats:
    """Lengths of vectors (n, 3)."""
    return np.sqrt(np.einsum("ni,ni->n", x, x))


def _unit(x: Floats) -> Floats:
    return np.asarray(x / np.linalg.norm(x))


def find(surface: Surface, given: Mapping[str, Any] | None = None) -> Frame:
    """Find the landmarks of a femur; ``given`` has those that are known.

    Args:
        surface: Its surface, of the whole bone or of its proximal part.
        given: Of ``head_centre``, ``lesser_trochanter``, ``shaft`` (two points, from distal to
            proximal), ``condyles`` (two points) [mm], ``side``.

    Raises:
        GeometryError: It is no femur: no head, no lesser trochanter, no single side.
    """
    given, bone = given or {}, _Bone(surface)
    mean = np.average(bone.centre, axis=0, weights=bone.area)
    off = (bone.centre - mean) * np.sqrt(bone.area)[:, None]
    axis = np.linalg.eigh(off.T @ off)[1][:, 2]
    head, radius, up, spread = _head(bone, axis, given)
    low = float((surface.points @ up).min())
    origin = head - 1.75 * radius * up
    for _ in range(3):
        point, up = _shaft(bone, origin, up, radius, given)
        origin, trochanter = _trochanter(bone, point, up, head, radius, given)
        low = float((surface.points @ up).min())
    neck, neck_spread = _neck(bone, head, radius, up, origin, spread)
    medial = _unit(neck - (neck @ up) * up)
    side, posterior = _side(bone, trochanter - origin, up, medial, origin, radius, low, given)
    version, turn = None, neck_spread
    back = np.cross(medial, up) * posterior
    found = given.get("condyles")
    if found is not None or origin @ up - low > (LONG - 1.75) * radius:
        line = _condyles(bone, up, medial, back, low, radius, found)
        across = _unit(line - (line @ up) * up)
        across *= np.sign(across @ medial)
        front = np.cross(up, across) * posterior
        version = math.atan2(medial @ front, medial @ across)
        medial = across
        turn = math.hypot(neck_spread / math.sin(math.acos(-float(up @ neck))), spread["rms"] / 23)
    anterior = np.cross(up, medial) * posterior
    told = {"head": spread["head"], "radius": spread["radius"], "neck": neck_spread}
    told |= {"version": turn}
    axes = np.stack([medial, anterior, up])
    return Frame(head, radius, origin, axes, neck, trochanter, side, version, told)


def _head(
    bone: _Bone, axis: Floats, given: Mapping[str, Any]
) -> tuple[Floats, float, Floats, dict[str, float]]:
    """Centre, radius, the way to proximal, and the spread of the head."""
    x, normal, area = bone.samples
    along = x @ axis
    best: tuple[float, Any] = (0.0, None)
    for up in (axis, -axis):
        end = np.abs(along - (x @ up).max() * (up @ axis)) < END
        covered, sphere = _sphere(x[end], normal[end], area[end])
        if covered > best[0]:
            best = (covered, (sphere, up))
    covered, found = best
    if covered < COVERED:
        text = f"no sphere covers more than {100 * covered:.0f} % of a head at either end"
        raise GeometryError(f"geometry.bone: {text}; expected a femur with its head")
    (centre, radius), up = found
    for _ in range(4):
        out = x - centre
        far = _far(out)
        on = (np.abs(far - radius) < 2 * NEAR) & (np.einsum("ni,ni->n", out, normal) > ALONG * far)
        pole = _unit(area[on] @ (out[on] / far[on, None]))
        out = bone.centre - centre
        far = _far(out)
        cap = np.flatnonzero((out @ pole > CAP * far) & (np.abs(far - radius) < 0.25 * radius))
        centre, radius = _fit(bone.centre[cap], bone.area[cap], centre, radius)
    one, other = _across(pole)
    out = bone.centre[cap] - centre
    sector = np.floor(SECTORS * (np.arctan2(out @ one, out @ other) / (2 * np.pi) + 0.5))
    left = [
        np.r_[_fit(bone.centre[cap[keep]], bone.area[cap[keep]], centre, radius)]
        for keep in (sector != k for k in range(SECTORS))
    ]
    left_ = np.array([np.r_[c, r] for c, r in left]) if np.ndim(left[0]) != 1 else np.array(left)
    variance = (SECTORS - 1) / SECTORS * ((left_ - left_.mean(axis=0)) ** 2).sum(axis=0)
    off = _far(out) - radius
    rms = math.sqrt(float(np.average(off**2, weights=bone.area[cap])))
    spread = {"head": 1.65 * math.sqrt(variance[:3].sum()), "radius": 1.65 * math.sqrt(variance[3])}
    if "head_centre" in given:
        centre, spread["head"] = np.array(given["head_centre"]), 0.0
    return centre, radius, up, spread | {"rms": rms}


def _sphere(x: Floats, normal: Floats, area: Floats) -> tuple[float, tuple[Floats, float]]:
    """Covered part, centre and radius of the sphere that covers most of itself."""
    pairs = np.random.default_rng(1).integers(len(x), size=(2, PAIRS))
    apart, turned = (v[pairs[0]] - v[pairs[1]] for v in (x, normal))
    size = (turned**2).sum(axis=1)
    radius = (apart * turned).sum(axis=1) / np.maximum(size, 1e-12)
    good = (size > 0.05) & (radius > RADII[0]) & (radius < RADII[1])
    radius, first = radius[good], pairs[0][good]
    centre = x[first] - radius[:, None] * normal[first]
    covered = np.zeros(len(radius))
    for k, (c, r) in enumerate(zip(centre, radius, strict=True)):
        out = x - c
        near = np.flatnonzero(np.abs(np.einsum("ni,ni->n", out, out) - r * r) < 2 * r * NEAR)
        out = out[near]
        on = np.einsum("ni,ni->n", out, normal[near]) > ALONG * r
        covered[k] = area[near[on]].sum() / (4 * math.pi * r * r)
    if not len(covered):
        return 0.0, (x.mean(axis=0), 0.0)
    best = int(covered.argmax())
    return float(covered[best]), (centre[best], float(radius[best]))


def _fit(x: Floats, area: Floats, centre: Floats, radius: float) -> tuple[Floats, float]:
    """Sphere through points (n, 3) by their areas, outliers counting less."""
    root = np.sqrt(area / area.mean())

    def off(p: Floats) -> Floats:
        return np.asarray(root * (_far(x - p[:3]) - p[3]))

    def slope(p: Floats) -> Floats:
        out = p[:3] - x
        far = _far(out)
        return np.column_stack([root[:, None] * out / far[:, None], -root])

    found = least_squares(off, np.r_[centre, radius], slope, loss="soft_l1", f_scale=ROBUST).x
    return found[:3], float(found[3])


def _shaft(
    bone: _Bone, origin: Floats, up: Floats, radius: float, given: Mapping[str, Any]
) -> tuple[Floats, Floats]:
    """A point of the shaft's axis and its direction, from an estimate."""
    if "shaft" in given:
        low, high = np.array(given["shaft"])
        return high, _unit(high - low)
    end = float(((bone.surface.points - origin) @ up).min())
    depths = np.linspace(*np.multiply(SHAFT, radius), 33)
    depths = depths[-depths > end + 3.0]
    if len(depths) < 8:
        text = f"ends {-end:.0f} mm below the lesser trochanter"
        raise GeometryError(f"geometry.bone: {text}; expected {1.8 * radius:.0f} mm of shaft")
    one, other = _across(up)
    middles = []
    for depth in depths:
        point = origin - depth * up
        (u, v), _ = centroid(bone.across(point, up))
        middles.append(point + u * one + v * other)
    x = np.array(middles)
    axis = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[2][0]
    return x.mean(axis=0), axis * np.sign(axis @ up)


def _trochanter(
    bone: _Bone, point: Floats, up: Floats, head: Floats, radius: float, given: Mapping[str, Any]
) -> tuple[Floats, Floats]:
    """Point of the shaft's axis at the level of the lesser trochanter, and its apex."""
    if "lesser_trochanter" in given:
        apex = np.array(given["lesser_trochanter"])
        return point + ((apex - point) @ up) * up, apex
    medial = _unit((head - point) - ((head - point) @ up) * up)
    side = np.cross(up, medial)
    top = point + ((head - point) @ up) * up
    one, other = _across(up)
    turns = np.linspace(-0.6 * np.pi, 0.6 * np.pi, 22)
    ways = np.cos(turns)[:, None] * medial + np.sin(turns)[:, None] * side
    ways = np.stack([ways @ one, ways @ other])
    depths = np.arange(0.3 * radius, 4.2 * radius, STEP)
    end = float(((bone.surface.points - top) @ up).min())
    depths = depths[-depths > end + 1.0]
    reach = np.array(
        [(bone.across(top - d * up, up).reshape(-1, 2) @ ways).max(axis=0) for d in depths]
    )
    reach = gaussian_filter1d(reach, 1.5 / STEP, axis=0)
    best = (0.0, 0, 0)
    for k in range(len(turns)):
        at, found = find_peaks(reach[:, k], prominence=0.5)
        for p, prominence in zip(at, found["prominences"], strict=True):
            inside = TROCHANTER[0] * radius < depths[p] < TROCHANTER[1] * radius
            if inside and prominence > best[0]:
                best = (float(prominence), k, int(p))
    prominence, k, p = best
    if prominence == 0.0:
        text = "no lesser trochanter stands out of the shaft"
        raise GeometryError(f"geometry.bone: {text}; give landmarks.lesser_trochanter")
    way = math.cos(turns[k]) * medial + math.sin(turns[k]) * side
    depth = float(depths[p])
    for _ in range(3):
        level = (bone.centre - top) @ up
        apex = bone.outermost(way, np.abs(level + depth) < 0.4 * radius)
        out = apex - point
        out = out - (out @ up) * up
        way = _unit(out)
    return point + ((apex - point) @ up) * up, apex


def _neck(
    bone: _Bone, head: Floats, radius: float, up: Floats, origin: Floats, spread: Mapping[str, float]
) -> tuple[Floats, float]:
    """Unit vector along the neck to the head, and its spread [rad]."""
    x = bone.surface.points
    near = _far(x - head) < 3.2 * radius
    triangles = bone.surface.triangles[near[bone.surface.triangles].all(axis=1)]
    used, triangles = np.unique(triangles, return_inverse=True)
    x, triangles = x[used], triangles.reshape(-1, 3)
    angles = 2 * np.pi * np.arange(72) / 72
    toward = _unit(head - (origin + 0.6 * radius * up))
    one = _unit(np.cross(up, toward))
    other = np.cross(toward, one)

    def cut(p: Floats, t: float) -> tuple[float, Floats]:
        axis = _unit(toward + p[0] * one + p[1] * other)
        centre = head - t * axis
        u = _unit(np.cross(up, axis))
        v = np.cross(axis, u)
        for _ in range(2):
            y = (x - centre) @ np.column_stack([u, v, axis])
            r, _ = exits(section(y[:, :2], y[:, 2], triangles), angles)
            if np.isnan(r).any():
                return 1e4, centre
            weight = r**3 / (1.5 * (r**2).sum())
            centre = centre + (weight @ np.cos(angles)) * u + (weight @ np.sin(angles)) * v
        return float((r**2).mean()) * math.pi, centre

    def area(p: Floats) -> float:
        return float(np.mean([cut(p, p[2] * radius + d)[0] for d in BESIDE]))

    best = minimize(
        area,
        [0.0, 0.0, 0.75],
        method="Nelder-Mead",
        options={"xatol": 3e-4, "fatol": 1e-3, "initial_simplex": _simplex([0.0, 0.0, 0.75])},
    ).x
    middles = [cut(best, best[2] * radius + d)[1] for d in BESIDE]
    middle = np.mean(middles, axis=0)
    lever = float(np.linalg.norm(head - middle))
    return _unit(head - middle), math.hypot(spread["head"], 0.75 * spread["rms"]) / lever


def _simplex(start: list[float]) -> Floats:
    return np.array(start) + np.vstack([np.zeros(3), np.diag([0.15, 0.15, 0.1])])


def _side(
    bone: _Bone,
    trochanter: Floats,
    up: Floats,
    medial: Floats,
    origin: Floats,
    radius: float,
    low: float,
    given: Mapping[str, Any],
) -> tuple[str, float]:
    """The side, and 1 where up x medial is anterior, else -1.

    The lesser trochanter and the condyles are posterior.
    """
    left = np.cross(up, medial)  # anterior of a left femur
    votes = [-float(trochanter @ left) / radius]
    if origin @ up - low > (LONG - 1.75) * radius:
        distal = bone.centre @ up < low + 1.5 * radius
        mean = np.average(bone.centre[distal] - origin, axis=0, weights=bone.area[distal])
        votes.append(-float(mean @ left) / radius)
    if "side" in given:
        side = given["side"]
    elif abs(sum(votes)) < 0.15:
        text = "left or right cannot be told: the lesser trochanter is neither in front nor behind"
        raise GeometryError(f"geometry.bone: {text}; give geometry.bone.side")
    else:
        side = "left" if sum(votes) > 0 else "right"
    return side, 1.0 if side == "left" else -1.0


def _condyles(
    bone: _Bone, up: Floats, medial: Floats, back: Floats, low: float, radius: float, given: Any
) -> Floats:
    """Line between the most posterior points of the condyles (3,)."""
    if given is not None:
        return np.asarray(np.subtract(*given), dtype=float)
    distal = bone.centre @ up < low + CONDYLES * radius
    for _ in range(5):
        across = np.cross(back, up)
        at = bone.centre @ across
        middle = 0.5 * (at[distal].min() + at[distal].max())
        one, other = (bone.outermost(back, distal & (s * (at - middle) > 0)) for s in (1, -1))
        line = one - other
        line = line - (line @ up) * up
        turned = np.cross(up, line)
        back = _unit(turned) * np.sign(turned @ back)
    return line
