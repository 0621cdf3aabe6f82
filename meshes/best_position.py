"""Search for the position of a stem in which the thinnest part of its mantle is thickest.

Room is measured as in `room`. The excess of a point is its room less the thickness that is wanted
there. At each step it is made linear in the five numbers of the position, within a trust region:
the largest least excess is then a linear program (scipy's HiGHS). Room counts up to
`COUNTED_RESERVE` above the wanted thickness, so a stem with enough room is not moved. A change that
gains less than `ROOM_PER_CHANGE` is not worth it, so the position stays near the start.
"""

from __future__ import annotations

import json
import math
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linprog

from app.foundation import files
from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from app.foundation.layout import alternatives, fixed
from meshes import cache, femur_stem, room
from meshes.femur_stem import Thickness
from meshes.placement import NO_POSITION, Placement, Position, position
from meshes.room import StemSurface, WidestCanal

if TYPE_CHECKING:
    from app.case.hips import Hip, Insertion, OperatedHip, Search

SEARCH_VERSION = 3  # raise it whenever the same input gives another position
NUMBERS = ("varus", "flexion", "version", "medial", "anterior")
ROOM_PER_CHANGE = 0.05  # mm of room for which a number may go as far as its limit
FIRST_TRUST = 0.3  # of the limits: first size of the trust region
LAST_TRUST = 0.005  # of the limits: last size of the trust region
DERIVATIVE_STEP = 0.01  # of the limits: step of the derivatives
CLOSE_POINTS = 2.0  # mm of room above the least: points that a step may make the closest
LINE_STRIDE = 3  # lines along the stem of which one is searched
COUNTED_RESERVE = 0.1  # mm of room above the wanted thickness that count; more does not
UNCEMENTED = 2.0  # mm of room that is wanted without cement
MOST_STEPS = 60  # at most
# Starts of the search next to the given position: number of `NUMBERS`, and part of its limit.
STARTS = ((2, 0.5), (2, -0.5))
TILT_NUMBERS = [0, 1]  # numbers of `NUMBERS` that are tilts
MOST_TILT = 0.2  # rad: largest varus and flexion of a position
ANGLE_DIGITS = 1  # decimals of a position's angles [deg]
# Least gain of room that is shown [mm].
SHOWN_GAIN = 0.005
LENGTH_DIGITS = 1  # decimals of a position's lengths [mm]


@dataclass(frozen=True)
class Limits:
    """Largest changes of a position, in rad and mm."""

    varus: float
    flexion: float
    version: float
    medial: float
    anterior: float

    @classmethod
    def of(cls, keys: Search) -> Limits:
        """Return the limits that the keys of a search give."""
        return cls(keys.varus, keys.flexion, keys.version, keys.offset, keys.offset)


def roomiest_position(
    canal: WidestCanal,
    stem: StemSurface,
    start: Position,
    limits: Limits,
    mantle_thickness: Thickness,
) -> Position:
    """The position, of the depth of the start, with the largest least excess of room.

    Args:
        canal: The widest possible canal.
        stem: The stem.
        start: Position at which the search begins.
        limits: Largest changes of it.
        mantle_thickness: Thickness of the mantle that is asked for, at angles and levels of the
            stem.
    """
    points = None if stem.points is None else stem.points[:, ::LINE_STRIDE]
    coarse = replace(
        stem,
        start=stem.start[::LINE_STRIDE],
        direction=stem.direction[::LINE_STRIDE],
        points=points,
    )
    start_numbers = np.array([getattr(start, name) for name in NUMBERS])
    scale = np.array([getattr(limits, name) for name in NUMBERS])
    scale[TILT_NUMBERS] = np.minimum(
        scale[TILT_NUMBERS], MOST_TILT - np.abs(start_numbers[TILT_NUMBERS])
    )
    free = np.flatnonzero(scale > 0)
    if not len(free):
        return start

    def changed(u: Floats) -> Position:
        return replace(
            start, **dict(zip(NUMBERS, map(float, start_numbers + scale * u), strict=True))
        )

    def excess_at(u: Floats, points: Floats | None = None) -> tuple[Floats, Floats]:
        return _excess(canal, coarse, changed(u), mantle_thickness, points)

    def objective(excess: Floats, u: Floats) -> float:
        return float(min(excess.min(), COUNTED_RESERVE) - ROOM_PER_CHANGE * np.abs(u).sum())

    def objective_of_all_lines(u: Floats) -> float:
        return objective(_excess(canal, stem, changed(u), mantle_thickness)[0], u)

    def searched_from(u: Floats) -> Floats:
        """Changes of the best position near a start."""
        trust, (excess, x) = FIRST_TRUST, excess_at(u)
        for _ in range(MOST_STEPS):
            near_points = x[excess < excess.min() + CLOSE_POINTS]
            excess_here, _ = excess_at(u, near_points)
            shifts = DERIVATIVE_STEP * np.eye(len(NUMBERS))[free]
            slopes = np.array(
                [(excess_at(u + s, near_points)[0] - excess_here) / DERIVATIVE_STEP for s in shifts]
            )
            step = np.zeros(len(NUMBERS))
            step[free] = _largest_least(excess_here, slopes.T, u[free], trust)
            next_excess, next_x = excess_at(u + step)
            if objective(next_excess, u + step) > objective(excess, u):
                u, excess, x = u + step, next_excess, next_x
            else:
                trust /= 2
                if trust < LAST_TRUST:
                    break
        return u

    no_change = np.zeros(len(NUMBERS))
    starts = [share * np.eye(len(NUMBERS))[number] for number, share in STARTS if scale[number]]
    # The given position stays if the lines that were not searched take the gain away.
    positions = [no_change, *(searched_from(u) for u in (no_change, *starts))]
    return changed(max(positions, key=objective_of_all_lines))


def _excess(
    canal: WidestCanal,
    stem: StemSurface,
    stem_position: Position,
    mantle_thickness: Thickness,
    points: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Excess of room of points of a stem (n,), by default of all in cement; points (n, 3) [mm]."""
    placement = canal.cut.put(stem.implant, stem_position, False)
    x = stem.cemented(placement, canal.cut) if points is None else points
    return canal.room(placement.to_model(x)) - mantle_thickness(
        np.arctan2(x[:, 1], x[:, 0]), x[:, 2]
    ), x


def wanted_thickness(geometry: Hip, placement: Placement) -> Thickness:
    """Thickness of the mantle that a geometry asks for; without cement `UNCEMENTED`."""
    thickness = geometry.cement_thickness or UNCEMENTED
    return femur_stem.thickness(thickness, geometry.implant.tip_z, placement.top)


def searched(
    geometry: OperatedHip, insertion: Insertion, folder: Path | None
) -> tuple[Insertion, str]:
    """Keys of the best position of a stem, and its gain of room, in words.

    A search takes 4 s of a core. Its result is kept, because each rank and each case of a sweep
    would repeat it.

    Args:
        geometry: A hip with its bone, cut and implant.
        insertion: Its keys, with the limits of the search as `best`.
        folder: Folder of the positions that were searched before, if there is one.

    Raises:
        GeometryError: No position within the limits has room for the stem.
    """
    content = {**cache.geometry_content(geometry), "search": SEARCH_VERSION}
    path = folder / f"{cache.hash_of(content)}.json" if folder else None
    if path:
        # A damaged file is replaced.
        with suppress(OSError, ValueError, TypeError, KeyError):
            saved_search = json.loads(path.read_text(encoding="utf-8"))
            return _with_numbers(insertion, *map(float, saved_search["numbers"])), str(
                saved_search["gain"]
            )
    numbers, gain = _search(geometry, insertion)
    if path:
        with suppress(OSError):
            content_text = json.dumps({"numbers": numbers, "gain": gain})
            files.write_bytes(path, content_text.encode(), 0o600)
    return _with_numbers(insertion, *numbers), gain


def _with_numbers(
    insertion: Insertion,
    varus: float,
    flexion: float,
    angle: float,
    medial: float,
    anterior: float,
) -> Insertion:
    """Keys of an insertion at a position, in rad and mm, without a search."""
    keys = {
        "varus": varus,
        "flexion": flexion,
        "version": insertion.version.model_copy(update={"angle": angle}),
        "medial_offset": medial,
        "anterior_offset": anterior,
        "best": None,
    }
    return insertion.model_copy(update=keys)


def _search(geometry: OperatedHip, insertion: Insertion) -> tuple[list[float], str]:
    """Numbers of the best position, in the order of `_with_numbers`, and its gain in words."""
    start, limits = position(geometry), insertion.best
    assert limits is not None  # the position is to be searched
    canal, neck = room.widest_canal(geometry), geometry.femur.neck
    cut, implant, mirrored = canal.cut, geometry.implant, geometry.femur.mirrored
    start_placement = cut.put(implant, start, mirrored)
    stem = StemSurface.of(implant, start_placement)
    mantle_thickness = wanted_thickness(geometry, start_placement)
    best_position = roomiest_position(canal, stem, start, Limits.of(limits), mantle_thickness)
    reference_azimuth = neck if insertion.version.relative_to == "neck" else 0.0
    rounded = Position(
        start.depth,
        _rounded_angle(best_position.varus),
        _rounded_angle(best_position.flexion),
        _rounded_angle(best_position.version - reference_azimuth) + reference_azimuth,
        round(best_position.medial, LENGTH_DIGITS),
        round(best_position.anterior, LENGTH_DIGITS),
    )
    kept = [name for name in NUMBERS if getattr(best_position, name) == getattr(start, name)]
    rounded = replace(rounded, **{name: getattr(start, name) for name in kept})
    # Rounding may cost more than the search gained.
    excess_at_start, excess_rounded = (
        _excess(canal, stem, candidate, mantle_thickness)[0].min() for candidate in (start, rounded)
    )
    if excess_rounded <= excess_at_start:
        rounded = start
    varus, flexion, angle = rounded.varus, rounded.flexion, rounded.version - reference_azimuth
    medial, anterior = rounded.medial, rounded.anterior
    placement = cut.put(implant, rounded, mirrored)
    fit_after, fit_before = room.fit(canal, stem, placement), room.fit(canal, stem, start_placement)
    position_text = (
        f"varus {fixed(math.degrees(varus))}, flexion {fixed(math.degrees(flexion))},"
        f" version {fixed(math.degrees(angle))} deg from the {insertion.version.relative_to},"
        f" offsets {fixed(medial)} mm medial, {fixed(anterior)} mm anterior"
    )
    if fit_after.least < geometry.least_room:
        shortfall = f"leaves {fit_after.least:.2f} mm"
        if fit_after.least < 0:
            shortfall = f"cuts {-fit_after.least:.2f} mm into the cortex"
        aim = "keeps the stem in the canal"
        if geometry.least_room > 0:
            aim = f"leaves {geometry.least_room:g} mm around the stem"
        remedies = (
            *geometry.ways_to_widen_canal,
            "use a smaller or shorter stem",
            "widen insertion.best",
        )
        raise GeometryError(
            f"geometry.insertion: {NO_POSITION} {aim};"
            f" the best ({position_text}) {shortfall}"
            f" {fit_after.side} at {placement.point_in_words(fit_after.place)};"
            f" {alternatives(remedies)}"
        )
    gain = fit_after.least - fit_before.least
    gain_text = "as at the given position"
    if gain >= SHOWN_GAIN:
        gain_text = f"{gain:.2f} mm more than at the given position"
    room_text = f"room {fit_after.words(placement)}, {gain_text}"
    return [varus, flexion, angle, medial, anterior], f"{position_text}: {room_text}"


def _rounded_angle(angle: float) -> float:
    """An angle rounded to a tenth of a degree [rad]."""
    return math.radians(round(math.degrees(angle), ANGLE_DIGITS))


def _largest_least(excess: Floats, slopes: Floats, u: Floats, trust: float) -> Floats:
    """Step (k,) that makes the least of linear excesses largest.

    Args:
        excess: Excesses of the points (n,) [mm].
        slopes: Their derivatives (n, k) [mm].
        u: Changes of the numbers so far, over their limits (k,).
        trust: Largest change in this step.
    """
    n, k = slopes.shape
    # Unknowns are the step (k,), the size of the whole change (k,), and the least excess.
    cost = np.concatenate([np.zeros(k), np.full(k, ROOM_PER_CHANGE), [-1.0]])
    eye, zeros = np.eye(k), np.zeros((k, 1))
    constraint_matrix = np.block(
        [
            [-slopes, np.zeros((n, k)), np.ones((n, 1))],
            [eye, -eye, zeros],
            [-eye, -eye, zeros],
        ]
    )
    constraint_limits = np.concatenate([excess, -u, u])
    lower_bounds, upper_bounds = np.maximum(-trust, -1.0 - u), np.minimum(trust, 1.0 - u)
    bounds = [
        *zip(lower_bounds, upper_bounds, strict=True),
        *[(0.0, None)] * k,
        (None, COUNTED_RESERVE),
    ]
    return np.asarray(linprog(cost, constraint_matrix, constraint_limits, bounds=bounds).x[:k])
