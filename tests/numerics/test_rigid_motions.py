"""Rigid motions of bodies, in words."""

from __future__ import annotations

import numpy as np

from app.numerics.rigid_motions import motions_in_words, rigid_modes


def test_rigid_motions_free_ones_are_named() -> None:
    """One body moves along an axis, two bodies move together, or about an axis without a name."""
    centres, names = np.array([[1.0, 2, 3], [4.0, 0, -1]]), ["'a'", "'b'"]
    origin, size = np.array([0.5, 0.5, 0.5]), 10.0

    def motion(body: int, axis: np.ndarray, about: np.ndarray) -> np.ndarray:
        v = np.zeros((2, 6))
        v[body, 3:], v[body, :3] = axis, np.cross(axis, (origin - about) / size)
        return v.ravel()

    turn, oblique = (
        motion(b, np.array(a), centres[b]) for b, a in ((0, [0, 0, 1]), (1, [0.6, 0, 0.8]))
    )
    for v, motion_text in (
        (turn, "body 'a': it is free to rotate about z"),
        (np.tile([1.0, 0, 0, 0, 0, 0], 2), "bodies 'a' and 'b': they are free to move along x tog"),
        (oblique, "body 'b': it is free to rotate about an axis along (0.60, 0.00, 0.80)"),
    ):
        (text,) = motions_in_words(v[:, None], names, centres, origin, size)
        assert text.startswith(f"nothing holds {motion_text}")
    assert rigid_modes(np.zeros((1, 3)))[0, :, 3:].any() is np.False_
