"""The reference body of a hip: volumes and coordinates."""

from __future__ import annotations

import numpy as np

from meshes import reference_body

# ------------------------------------------------------------------------------ reference body


def test_reference_body_volumes_and_coordinates() -> None:
    """Regions have the volumes of straight rings about an ellipse.

    Coordinates are linear mean value ones.
    """
    turn = 2 * np.pi * np.arange(9) / 9
    outline = np.stack([5 * np.cos(turn), 3 * np.sin(turn)], axis=1)
    segments = (
        reference_body.Segment(2, ("a", "b", "c")),
        reference_body.Segment(3, ("d",)),
    )
    body = reference_body.make(outline, (2, 3), segments)
    a, b, c = body.section[body.columns].transpose(1, 0, 2)
    (p, q), (u, v) = (b - a).T, (c - a).T
    areas = 0.5 * np.abs(p * v - q * u)
    core = 0.5 * 9 * 15 * np.sin(2 * np.pi / 9)
    volumes = np.bincount(body.region, weights=areas)
    np.testing.assert_allclose(volumes, core * np.array([2, 2 * 3, 2 * 5, 3]), rtol=1e-9)
    assert (body.names, set(body.slab[body.region == 3])) == (("a", "b", "c", "d"), {2, 3, 4})
    sheared = outline + np.outer(outline[:, 1], [reference_body.SHEAR, 0.0])
    inside = body.section[9 * len(body.rho) :]
    inside = inside + np.outer(inside[:, 1], [reference_body.SHEAR, 0.0])
    np.testing.assert_allclose(body.weights @ sheared, inside, atol=1e-12)
    assert (body.weights > 0).all()
