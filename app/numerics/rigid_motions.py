"""Rigid motions of several bodies, and which of them are free, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from app.foundation.arrays import Floats, Ints

DIRECTIONS = [f"{motion} {axis}" for motion in ("move along", "rotate about") for axis in "xyz"]
# A rigid motion of bodies is free if its resistance is below this fraction of the largest one.
FREE_RESISTANCE = 1e-10
# A named motion of unit size is free if its part in the span of the free motions has at least this
# square.
FREE_SHARE = 0.9
# A free motion is named if its part outside the motions already named has at least this square.
NEW_SHARE = 0.2
# A motion of unit size is outside the span of others if its part outside exceeds this size.
INDEPENDENT_SIZE = 1e-3
# A direction is along an axis if the cosine of their angle exceeds this.
ALIGNED_COSINE = 0.9999
# Largest number of bodies of which all subsets are searched.
SUBSET_BODIES = 6


def rigid_modes(x: NDArray[np.floating]) -> Floats:
    """Translations along and rotations about the axes at points x (n, 3) -> (n, 3, 6)."""
    modes = np.zeros((len(x), 3, 6))
    modes[:, :, :3] = np.eye(3)
    for k in range(3):
        modes[:, :, 3 + k] = np.cross(np.eye(3)[k], x)
    return modes


def rotation_vector(R: Floats) -> Floats:
    """Vector (3,) of a rotation (3, 3) by less than π [rad]."""
    from scipy.spatial.transform import Rotation  # imported late: few cases rotate a region

    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def add_relative(matrix: Floats, a: int, b: int, resistance: Floats) -> None:
    """Add a resistance (6, 6) against relative motion of two bodies a and b, in place.

    The matrix is that of all bodies (6 n, 6 n).
    """
    for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
        matrix[6 * i : 6 * i + 6, 6 * j : 6 * j + 6] += sign * resistance


def relative_resistance(resistance: Floats, bodies: Ints, count: int) -> Floats:
    """Resistance of points to the motions of all bodies (6 count, 6 count).

    Args:
        resistance: Resistance of each point to the relative motion of its bodies (n, 6, 6).
        bodies: Both bodies of each point (n, 2).
        count: Number of bodies.
    """
    A = np.zeros((6 * count, 6 * count))
    for a, b in np.unique(bodies, axis=0):
        is_pair = (bodies == (a, b)).all(axis=1)
        add_relative(A, int(a), int(b), resistance[is_pair].sum(axis=0))
    return A


def motions_outside(motions: Floats, other_motions: Floats) -> Floats:
    """Return the motions (m, k) that are not in the span of others (m, l).

    All are orthonormal columns.
    """
    outside = motions - other_motions @ (other_motions.T @ motions)
    directions, sizes, _ = np.linalg.svd(outside, full_matrices=False)
    return np.asarray(directions[:, sizes > INDEPENDENT_SIZE])


def motions_in_words(
    free_motions: Floats,
    names: Sequence[str],
    centres: Floats,
    origin: Floats,
    size: float,
    verb: str = "nothing holds",
) -> list[str]:
    """Sentences on motions without resistance, one for each set of bodies that share them.

    Args:
        free_motions: Translation and rotation x size of each body about the origin, in each free
            motion (6 n, k).
        names: Names of the n bodies, in quotes.
        centres: A point on the axis of each body's rotations (n, 3) [mm].
        origin: Origin of the motions (3,) [mm].
        size: Length that scales rotations to translations [mm].
        verb: Words that begin each sentence, before the bodies.
    """
    if not free_motions.shape[1]:
        return []
    Q = np.linalg.qr(free_motions)[0]
    named = np.zeros((len(Q), 0))
    motions_of: dict[tuple[int, ...], list[str]] = {}
    for bodies, k, v in _named_motions(centres, origin, size):
        if named.shape[1] == Q.shape[1]:
            break
        unnamed_part = v - named @ (named.T @ v)
        if (
            np.linalg.norm(Q.T @ v) ** 2 < FREE_SHARE
            or np.linalg.norm(unnamed_part) ** 2 < NEW_SHARE
        ):
            continue
        named = np.column_stack([named, unnamed_part / np.linalg.norm(unnamed_part)])
        motions_of.setdefault(bodies, []).append(DIRECTIONS[k])
    # Motions along no axis.
    unnamed = Q - named @ (named.T @ Q)
    directions, sizes, _ = np.linalg.svd(unnamed, full_matrices=False)
    for v in directions.T[: Q.shape[1] - named.shape[1]][
        sizes[: Q.shape[1] - named.shape[1]] > NEW_SHARE
    ]:
        body = int(np.argmax(np.linalg.norm(v.reshape(-1, 6), axis=1)))
        motions_of.setdefault((body,), []).append(_oblique_motion(v[6 * body : 6 * body + 6]))
    return [
        _free_body_sentence(verb, [names[b] for b in bodies], directions_of_bodies)
        for bodies, directions_of_bodies in motions_of.items()
    ]


def _named_motions(
    centres: Floats, origin: Floats, size: float
) -> Iterator[tuple[tuple[int, ...], int, Floats]]:
    """Named motions, of few bodies first: bodies, number, unit vector (6 n,)."""
    n = len(centres)
    for count in range(1, n + 1 if n <= SUBSET_BODIES else 2):
        for bodies in combinations(range(n), count):
            arm = (origin - centres[list(bodies)].mean(axis=0)) / size
            for k in range(6):
                motion = np.zeros(6)
                motion[k] = 1.0
                if k >= 3:
                    motion[:3] = np.cross(motion[3:], arm)
                v = np.zeros((n, 6))
                v[list(bodies)] = motion
                yield bodies, k, v.ravel() / np.linalg.norm(v)


def _oblique_motion(v: Floats) -> str:
    rotates = np.linalg.norm(v[3:]) > np.linalg.norm(v[:3])
    axis = v[3:] if rotates else v[:3]
    axis = axis / np.linalg.norm(axis)
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))]) + 0.0
    k = int(np.argmax(axis))
    axis_text = "xyz"[k] if axis[k] > ALIGNED_COSINE else "({:.2f}, {:.2f}, {:.2f})".format(*axis)
    return f"rotate about an axis along {axis_text}" if rotates else f"move along {axis_text}"


def _free_body_sentence(verb: str, names: Sequence[str], directions: Sequence[str]) -> str:
    motions = []
    for motion in ("move along", "rotate about"):
        axes = [w.removeprefix(motion).strip() for w in directions if w.startswith(motion)]
        if axes:
            motions.append(f"{motion} {', '.join(axes)}")
    motions_text = " and to ".join(motions)
    if len(names) == 1:
        return f"{verb} body {names[0]}: it is free to {motions_text}"
    return f"{verb} bodies {' and '.join(names)}: they are free to {motions_text} together"
