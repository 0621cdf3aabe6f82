"""A stem from CAD in a hip: points of its surface in the sections of the mesh.

Above the neck cut, or above the shoulder if that is lower, sections rotate until they are across
the neck. Their centres lead from the stem's axis to the neck's. Each ray from a centre meets the
triangles of the surface once. Sections in a collar on the neck cut are parallel to it, and rotate
from its top on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial import cKDTree

from app.foundation.arrays import Bools, FloatOrFloats, Floats, unit_vectors
from app.foundation.errors import GeometryError
from meshes.data import StepKeys
from meshes.femur_stem import ARC_WEIGHT, LEAST_WHOLE, Thickness, capped_shares, lines_per_piece
from meshes.nearest_facets import distance_from_triangles
from meshes.placement import Placement
from meshes.plane_sections import lines_at_height, ray_crossings

BEND_WINDOW = 1 / 60  # of the length around: bend is averaged over it; shorter corners are points
SHORTEST_FLAT = 1.5 / 60  # of the length around: flats between corners are longer
CORNER_BEND = 1.2  # of the mean bend by length: corners bend more
LEAST_BEND = 0.2  # radians: what bends less is no corner
CORNER_SHIFT = 0.08  # of the length around: a corner is that of another section, if it is nearer
SEARCH_STEP = 0.5  # mm between sections in which corners of the body are searched
RAYS = 720  # rays around; a sharp corner between two of them is cut by up to 0.04 mm
THETA = 2 * np.pi * np.arange(RAYS) / RAYS
NEAR_PLANE = 1e-6  # mm from a plane within which triangles may cross it
HIDDEN_METAL = 4.0  # mm of metal that a ray may meet beyond a gap: the corner of a shoulder
NOTCH_RATIO = 5.0  # of the distance of rays on an outline over that beside it: a notch is between
WIDEST_NOTCH = 1.0  # mm: nodes that are moved off the chord of a wider one invert cells
TIP_MARGIN = 3.0  # mm above the tip, and below the shoulder, from which the mantle goes on beyond
SMALLEST_TURN = 1e-9  # turns between the two points at the middle of a notch
NECK_SHARE = 0.38  # of the neck's length: what the points between axis and neck head for
NECK_INSET = 1e-3  # mm that the last section is within the neck
TURN_AFTER_COLLAR = 2.0  # speed at which sections turn above a collar, until they are as without it
LONGEST_COLLAR = 0.5  # of the way from cut to neck's end: with more, the last section is not turned


def outline(x: Floats, origin: Floats, plane: Floats) -> Floats:
    """Points at which rays from a point in a plane leave triangles (m, 3, 3); (`RAYS`, 3) [mm].

    Angles are from the first to the second of two directions in it (2, 3).

    Raises:
        ValueError: The point is outside, or rays meet the surface again.
    """
    normal = np.cross(*plane)
    a, b, c = (x.reshape(-1, 3) @ normal - origin @ normal).reshape(-1, 3).T
    highest, lowest = np.maximum(np.maximum(a, b), c), np.minimum(np.minimum(a, b), c)
    is_near = (highest > -NEAR_PLANE) & (lowest < NEAR_PLANE)
    x = x[is_near].reshape(-1, 3) - origin
    ray, r = ray_crossings(lines_at_height(x, x @ normal) @ np.linalg.pinv(plane), THETA)
    least_radii, largest_radii = np.full(RAYS, np.inf), np.zeros(RAYS)
    np.minimum.at(least_radii, ray, r)
    np.maximum.at(largest_radii, ray, r)
    if not (np.isfinite(least_radii).all() and (largest_radii - least_radii).max() < HIDDEN_METAL):
        raise ValueError
    exit_points = least_radii * [np.cos(THETA), np.sin(THETA)]
    return np.asarray(origin + exit_points.T @ plane)


def side_lengths(x: Floats) -> Floats:
    """Distances of the points of a closed outline (n, 2 or 3) from the next ones (n,) [mm]."""
    return np.asarray(np.sqrt(((np.roll(x, -1, axis=0) - x) ** 2).sum(axis=1)))


def outline_length(x: Floats) -> float:
    """Length of a closed outline (n, 2 or 3) [mm]."""
    return float(side_lengths(x).sum())


def fractions_around(x: Floats) -> Floats:
    """Parts of the length around before points of a closed outline (n, 3); shape (n,)."""
    length = side_lengths(x)
    return np.asarray((np.cumsum(length) - length) / length.sum())


def angles_at_points(x: Floats) -> Floats:
    """Angles by which a closed plane outline (n, 3) turns at its points (n,) [rad]."""
    edges = unit_vectors(np.roll(x, -1, axis=0) - x)
    before = np.roll(edges, 1, axis=0)
    across = np.cross(before, edges)
    normal = unit_vectors(np.cross(x, np.roll(x, -1, axis=0)).sum(axis=0))
    return np.asarray(np.arctan2(across @ normal, (before * edges).sum(axis=1)))


def corners(x: Floats) -> tuple[Floats, Floats]:
    """Middles and widths of the corners of a closed outline (n, 3), in parts of its length (k,).

    A corner is where it bends more than in the mean, up to where it bends half as much as there.
    Bend is averaged over a window: a sharp corner is as wide as that.
    """
    arc, bend = fractions_around(x), angles_at_points(x)
    total = bend.sum()
    turned_angle = np.cumsum(bend) - 0.5 * bend
    arc = np.concatenate([arc - 1, arc, arc + 1])
    turned_angle = np.concatenate([turned_angle - total, turned_angle, turned_angle + total])
    grid = np.arange(2 * RAYS) / (2 * RAYS)
    window_ends = [np.interp(grid + side * BEND_WINDOW, arc, turned_angle) for side in (-0.5, 0.5)]
    density = (window_ends[1] - window_ends[0]) / (BEND_WINDOW * total)
    is_high = density > CORNER_BEND
    if is_high.all() or not is_high.any():
        return np.zeros(0), np.zeros(0)
    shift, n, corner_spans = int(np.argmin(is_high)), len(grid), []
    density, is_high = np.roll(density, -shift), np.roll(is_high, -shift)
    firsts, lasts = np.flatnonzero(np.diff(is_high.astype(int), append=0)).reshape(-1, 2).T
    # An arc is facets: what is between them is no flat.
    is_separate = np.append(firsts[1:] - lasts[:-1] > SHORTEST_FLAT * n, True)
    for first_index, last_index in zip(
        firsts[np.roll(is_separate, 1)] + 1, lasts[is_separate], strict=True
    ):
        half_density = 0.5 * density[first_index : last_index + 1].mean()
        peak = first_index + np.flatnonzero(density[first_index : last_index + 1] >= half_density)
        before = _outwards(density, half_density, int(peak[0]), -1)
        after = _outwards(density, half_density, int(peak[-1]), 1)
        width = (after - before) / n
        if 2 * half_density * width * total > LEAST_BEND:
            corner_spans.append(((0.5 * (before + after) + shift) / n, width))
    middles, widths = np.transpose(corner_spans) if corner_spans else np.zeros((2, 0))
    return np.asarray(middles % 1.0), np.asarray(widths)


def _outwards(density: Floats, level: float, start: int, step: int) -> float:
    """Place, from a start in a direction, where a density on a ring falls below a level."""
    n, k = len(density), start
    while density[(k + step) % n] >= level and abs(k - start) < n:
        k += step
    high, low = density[k % n], density[(k + step) % n]
    return k + step * float((high - level) / (high - low))


@dataclass(frozen=True)
class CornerLines:
    """Corners and flats of the section where lines are counted, with their shares of the lines.

    Attributes:
        middles: Middles of the corners in parts of the length around (k,).
        sharp: True for corners that are points (k,).
        first: Number of the end of a corner at which the first line is; -1: it is on the first ray.
        weights: 1 for flats, `ARC_WEIGHT` for corners, from the first line on (m,).
        shares: Fraction of all lines on each flat and corner (m,).
    """

    middles: Floats
    sharp: Bools
    first: int
    weights: Floats
    shares: Floats

    @classmethod
    def of(cls, x: Floats, lines: int) -> CornerLines:
        """Corners and flats of an outline (n, 3)."""
        middles, widths = corners(x)
        sharp = widths < 1.3 * BEND_WINDOW
        ends = cls._ends(middles, widths, sharp)
        offsets = (ends + 0.5) % 1.0 - 0.5
        nearest = int(np.argmin(np.abs(offsets))) if len(ends) else -1
        first_end = nearest if len(ends) and abs(offsets[nearest]) < 0.5 / lines else -1
        pieces = cls(middles, sharp, first_end, np.zeros(0), np.zeros(0))
        bounds, inside = pieces._bounds(ends)
        weights = np.where(inside, ARC_WEIGHT, 1.0)
        lengths = weights * np.diff(bounds)
        is_whole = lines % 4 == 0 and lines >= max(LEAST_WHOLE, 2 * len(lengths))
        shares = lines_per_piece(lengths, lines) if is_whole else lengths
        return cls(middles, sharp, first_end, weights, shares / shares.sum())

    @staticmethod
    def _ends(middles: Floats, widths: Floats, sharp: Bools) -> Floats:
        """Ends of corners, of a sharp one its point, in parts of the length around (j,)."""
        ends = [
            [middle] if point else [middle - 0.5 * width, middle + 0.5 * width]
            for middle, width, point in zip(middles, widths, sharp, strict=True)
        ]
        return np.array([end for piece in ends for end in piece])

    def _bounds(self, ends: Floats) -> tuple[Floats, Bools]:
        """Bounds of the pieces from the first line on (m + 1,), and which are corners (m,)."""
        begins_corner = np.array(
            [k for sharp in self.sharp for k in ([False] if sharp else [True, False])]
        )
        start = ends[self.first] if self.first >= 0 else 0.0
        all_ends = ends if self.first >= 0 else np.append(ends, 0.0)
        is_after_corner = begins_corner if self.first >= 0 else np.append(begins_corner, False)
        arc = (all_ends - start) % 1.0
        order = np.argsort(arc, kind="stable")
        inside = is_after_corner[order].astype(bool)
        if self.first < 0 and len(ends):
            # The first ray may be within a corner.
            inside[0] = inside[-1]
        return start + np.append(arc[order], 1.0), inside

    def knots(self, x: Floats) -> tuple[Floats, Floats] | None:
        """Positions in an outline (n, 3), and the turns there (m + 1,).

        None: the outline has other corners.
        """
        middles, widths = corners(x)
        if len(middles) != len(self.middles):
            return None
        differences = (middles[None] - self.middles[:, None] + 0.5) % 1.0 - 0.5
        nearest = np.abs(differences).argmin(axis=1) if len(middles) else np.zeros(0, dtype=int)
        shifts = differences[np.arange(len(nearest)), nearest]
        if len(np.unique(nearest)) < len(nearest) or (np.abs(shifts) > CORNER_SHIFT).any():
            return None
        ends = self._ends(self.middles + shifts, widths[nearest], self.sharp)
        bounds, inside = self._bounds(ends)
        weights = np.where(inside, ARC_WEIGHT, 1.0)
        if (weights != self.weights).any() or (np.diff(bounds) <= 0).any():
            return None
        lengths = weights * np.diff(bounds)
        shares = capped_shares(self.shares, lengths / lengths.sum())
        return bounds, np.append(0.0, np.cumsum(shares))


def _with_corner_points(x: Floats, bounds: Floats, turns: Floats) -> tuple[Floats, Floats]:
    """Points of an outline, first the (`RAYS`, 3) of the rays, and the lines there in turns.

    Args:
        x: Points of the rays [mm].
        bounds: Ends of corners in parts of the length around (m,).
        turns: Lines there (m,).
    """
    arc, start, corner_arcs = fractions_around(x), bounds[0], bounds[:-1]
    corner_points = np.stack([np.interp(corner_arcs, arc, v, period=1.0) for v in x.T], axis=1)
    all_arcs = np.append((arc - start) % 1.0 + start, corner_arcs)
    return np.concatenate([x, corner_points]), np.interp(all_arcs, bounds, turns)


def _beside_notches(x: Floats, turns: Floats) -> tuple[Floats, Floats]:
    """Keep points off the chords of narrow notches, into which no ray reaches.

    The first half of the lines at a notch get its first end, the others its second.

    Args:
        x: Points of a closed outline (n, 3) [mm].
        turns: Lines there (n,).

    Returns:
        Points and their lines, with both ends of each notch once more at its middle line.
    """
    length = side_lengths(x)
    beside = np.maximum(np.roll(length, 1), np.roll(length, -1))
    first = np.flatnonzero((length > NOTCH_RATIO * beside) & (length < WIDEST_NOTCH))
    second = (first + 1) % len(x)
    middle = turns[first] + 0.5 * ((turns[second] - turns[first]) % 1.0)
    return (
        np.concatenate([x, x[first], x[second]]),
        np.concatenate([turns, middle - SMALLEST_TURN, middle + SMALLEST_TURN]),
    )


class CadStem:
    """A stem as `stem_file.read` finds it; ``ends`` are the steps above the neck cut."""

    def __init__(
        self,
        shape: Mapping[str, Floats],
        ends: tuple[float, float],
        placement: Placement,
        mesh: StepKeys,
        collar_thickness: float = 0.0,
    ) -> None:
        """Ends are the level of the tip and the height of the shoulder, or of the cut [mm].

        The thickness of a collar is in mm; 0: there is none.
        """
        (self._low, top_level), self._placement = ends, placement
        self._high = (
            self._low + float(shape["shoulder"]) - TIP_MARGIN
            if top_level < placement.top
            else np.inf
        )
        mirror = [1.0, -1.0 if placement.mirrored else 1.0, 1.0]
        shift = np.array([0.0, 0.0, self._low])
        self._x, self._coarse = shape["x"] * mirror + shift, shape["coarse"] * mirror + shift
        self._cached_outline = lru_cache(maxsize=4096)(self._outline)
        self._cached_lines = lru_cache(maxsize=4096)(self._lines)
        self._corner_lines: CornerLines | None = None
        end, neck_axis = shape["end"] * mirror + shift, shape["neck"] * mirror
        bend = end - (1 - NECK_SHARE) * end[0] / neck_axis[0] * neck_axis
        self._path = np.array([[0.0, 0.0, top_level], bend, end - NECK_INSET * neck_axis])
        medial = unit_vectors(np.array([1.0, 0.0, 0.0]) - neck_axis[0] * neck_axis)
        steepest, self._lean = placement.slopes
        self._planes = np.stack([self._plane(steepest), [medial, np.cross(neck_axis, medial)]])
        self._cut = self._path_fraction(placement.top, steepest)
        rise = collar_thickness * np.sqrt(1.0 + steepest**2 * (1.0 + self._lean**2))
        collar_top = self._path_fraction(placement.top + rise, steepest)
        self._collar_end = min(LONGEST_COLLAR, (collar_top - self._cut) / (1 - self._cut))
        length = np.linalg.norm(np.diff(self._path, axis=0), axis=1).sum()
        self.ends = (mesh.steps((1 - self._cut) * length),)

    def _plane(self, slope: float) -> Floats:
        """Directions in a section, over x and over y (2, 3)."""
        return np.array([[1.0, 0.0, -slope], [0.0, 1.0, -slope * self._lean]])

    def _path_fraction(self, height: float, slope: float) -> float:
        """Fraction of the neck's path at which the path crosses a section.

        It is from 0 to 1; 0 if the section is below the start of the path.
        """
        p, q, r = self._path @ [slope, slope * self._lean, 1.0]
        rise = height - p
        if rise <= 0:
            return 0.0
        return float(rise / (q - p + np.sqrt((q - p) ** 2 + (p - 2 * q + r) * rise)))

    def _outline(self, height: float, slope: float, fraction: float = 0.0) -> Floats:
        """Outline (`RAYS`, 3) [mm]. A fraction above 0 counts from the cut to the neck's end."""
        if fraction > 0:
            path_fraction = self._cut + (1 - self._cut) * fraction
            after_collar = max(0.0, fraction - self._collar_end)
            rotated_part = min(fraction, TURN_AFTER_COLLAR * after_collar)
            part_of_cut = (1 - rotated_part) ** 2
            plane = part_of_cut * self._planes[0] + (1 - part_of_cut) * self._planes[1]
        else:
            path_fraction, plane = self._path_fraction(height, slope), self._plane(slope)
        origin = (
            np.array(
                [
                    (1 - path_fraction) ** 2,
                    2 * (1 - path_fraction) * path_fraction,
                    path_fraction * path_fraction,
                ]
            )
            @ self._path
        )
        if path_fraction <= 0:
            origin = np.array([0.0, 0.0, height])
        try:
            return outline(self._x, origin, plane)
        except ValueError:
            location = self._placement.point_in_words(self._placement.to_model(origin))
            raise GeometryError(
                f"geometry.stem: around {location}, rays from the stem's axis meet its surface more"
                " than once. Is there a collar, or does the neck leave the body below the neck"
                " cut? Move the stem proximally (geometry.tip_z, geometry.insertion.depth), cut"
                " lower (geometry.resection.height), or remove the"
                " collar from the file and set geometry.stem.collar"
            ) from None

    def _lines(self, height: float, slope: float, fraction: float = 0.0) -> tuple[Floats, Floats]:
        """Points of an outline (n, 3) [mm], and the lines there in turns (n,).

        Lines are on the corners of the body. Where an outline has other corners, as at the foot of
        the neck, they have the directions of the highest section with those of the body. Above cut
        and collar they go over to equal distances around the neck.
        """
        x = self._cached_outline(height, slope, fraction)
        if fraction > 0:
            turns, equal = self._cached_lines(height, slope, 0.0)[1][:RAYS], fractions_around(x)
            after_collar = max(0.0, fraction - self._collar_end) / (1.0 - self._collar_end)
            to_equal = (equal - turns + 0.5) % 1.0 - 0.5
            # The square root turns lines early: in proportion they invert cells of a hollow neck.
            return _beside_notches(x, turns + np.sqrt(after_collar) * to_equal)
        knots = self._corner_lines.knots(x) if self._corner_lines else None
        if knots:
            return _with_corner_points(x, *knots)
        return x, fractions_around(x) if self._highest_turns is None else self._highest_turns

    @cached_property
    def _highest_turns(self) -> Floats | None:
        """Lines (`RAYS`,) at the rays of the highest section with the body's corners, in turns."""
        height, slope = self._placement.top, self._placement.slopes[0]
        while self._corner_lines and height > self._low:
            x = self._cached_outline(height, slope, 0.0)
            knots = self._corner_lines.knots(x)
            if knots:
                return _with_corner_points(x, *knots)[1][:RAYS]
            height -= SEARCH_STEP
        return None

    def _points_on_outlines(self, phi: Floats, *planes: Floats) -> Floats:
        """Points of outlines (n, 3) [mm], one outline for all with the same arguments (n,)."""
        keys, outline_of_point = np.unique(np.stack(planes, axis=1), axis=0, return_inverse=True)
        points = np.empty((len(phi), 3))
        for k in range(len(keys)):
            on_outline = outline_of_point.ravel() == k
            x, turns = self._cached_lines(*keys[k])
            points[on_outline] = np.stack(
                [np.interp(phi[on_outline], turns, v, period=1.0) for v in x.T], axis=1
            )
        return points

    def section(self, z: float) -> tuple[float, float, float]:
        """Half-width, half-depth and corner radius of a square of the same length around [mm]."""
        half_width = outline_length(self._cached_outline(z, 0.0, 0.0)) / 8
        return half_width, half_width, 0.0

    def divided(self, z: float, line_count: int) -> CadStem:
        """Itself, with lines on the corners of its section at z [mm]."""
        self._corner_lines = CornerLines.of(self._cached_outline(z, 0.0, 0.0), line_count)
        self._cached_lines.cache_clear()
        return self

    def point(self, phi: Floats, zeta: FloatOrFloats, slope: FloatOrFloats) -> Floats:
        """Points of outlines as `StemShaft.point`; below the tip they are those above."""
        zeta, slope = (np.broadcast_to(v, phi.shape) for v in (zeta, slope))
        return self._points_on_outlines(
            phi, self._low + np.abs(zeta - self._low), slope, np.zeros(len(phi))
        )

    def points(self, phi: Floats, s: Floats) -> Floats:
        """Points at stations from the cut on (n, 3) [mm]."""
        top, slope = (
            np.full(len(phi), v) for v in (self._placement.top, self._placement.slopes[0])
        )
        return self._points_on_outlines(phi, top, slope, np.asarray(s) / self.ends[-1])

    def depth(self, thickness: Thickness, x: Floats) -> Floats:
        """Depth of points (n, 3) within the outer side of a mantle (n,) [mm].

        Below the tip, and above a shoulder that is below the cut, the surface continues unchanged.
        """
        x = np.stack([x[:, 0], x[:, 1], np.maximum(x[:, 2], self._low + TIP_MARGIN)], axis=1)
        mantle_thickness = thickness(np.arctan2(x[:, 1], x[:, 0]), x[:, 2])
        distances = distance_from_triangles(x, self._coarse)
        is_above = x[:, 2] > self._high
        if is_above.any():
            shoulder_outline = self._cached_outline(self._high, 0.0, 0.0)[:, :2]
            plane_points = x[is_above, :2]
            angles = np.arctan2(plane_points[:, 1], plane_points[:, 0])
            outside = np.hypot(*plane_points.T) - np.interp(
                angles, THETA, np.hypot(*shoulder_outline.T), period=2 * np.pi
            )
            edge_distances = np.where(
                outside > 0, cKDTree(shoulder_outline).query(plane_points)[0], 0.0
            )
            distances[is_above] = np.minimum(distances[is_above], edge_distances)
        return np.asarray(mantle_thickness - distances)
