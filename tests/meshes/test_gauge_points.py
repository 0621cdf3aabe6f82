"""Points of strain gauges on facets: discs, tangent planes, circles that do not fit."""

from __future__ import annotations

import numpy as np
import pytest

from app.foundation.arrays import Floats
from meshes.gauge_points import GaugeFault, gauge_points

RADIUS = 14.0


def sphere(n: int = 24, curved: bool = True) -> Floats:
    """Facets of a sphere: an octahedron whose faces are divided (f, 6 or 3, 3) [mm]."""
    corners = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    facets = []
    for signs in np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).reshape(3, -1).T:
        a, b, c = corners * signs
        for i in range(n):
            for j in range(n - i):
                place = [a + (i + p) / n * (b - a) + (j + q) / n * (c - a) for p, q in THREE]
                facets.append(place)
                if i + j < n - 1:
                    facets.append(
                        [a + (i + p) / n * (b - a) + (j + q) / n * (c - a) for p, q in OTHERS]
                    )
    x = np.array(facets)
    if curved:
        x = np.concatenate([x, (x + np.roll(x, -1, axis=1)) / 2], axis=1)
    return RADIUS * x / np.linalg.norm(x, axis=2, keepdims=True)


# Corners of the two kinds of triangles in a divided triangle.
THREE = ((0, 0), (1, 0), (0, 1))
OTHERS = ((1, 0), (1, 1), (0, 1))
PLATE = 10.0 * np.array(
    [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]],
)


def places(x: Floats, facet: Floats, share: Floats) -> Floats:
    """Positions of points in flat facets (n, 3) [mm]."""
    return np.einsum("nk,nkc->nc", share, x[facet, :3])


def test_gauge_points_integrate_polynomials_over_the_circle() -> None:
    """Means of x^2, x^4 and x^2 y^2 over a circle are R^2/4, R^4/8, R^4/24."""
    gauge = gauge_points(PLATE, (5, 5, 0.4), None, (1, 0, 1), 4.0)
    x, y, z = (places(PLATE, gauge.facet, gauge.barycentric) - [5, 5, 0]).T
    assert gauge.weight.sum() == pytest.approx(1)
    assert gauge.distance == pytest.approx(0.4)
    assert gauge.weight @ x**2 == pytest.approx(2**2 / 4)
    assert gauge.weight @ x**4 == pytest.approx(2**4 / 8)
    assert gauge.weight @ (x * y) ** 2 == pytest.approx(2**4 / 24)
    assert gauge.weight @ x == pytest.approx(0, abs=1e-12)
    assert z == pytest.approx(0)
    assert gauge.direction == pytest.approx([1, 0, 0])


@pytest.mark.parametrize("curved", [True, False])
def test_gauge_points_lie_in_the_tangent_plane_of_a_sphere(curved: bool) -> None:
    """The normal is radial. The mean of the squared distance from it is R^2/2 of the gauge."""
    at = np.array([3.0, -5.0, 4.0])
    radial = at / np.linalg.norm(at)
    x = sphere(curved=curved)
    seen = gauge_points(x, (0, 0, 0), at.tolist(), (0, 0, 1), 3.0)
    near = gauge_points(x, (1.05 * RADIUS * radial).tolist(), None, (0, 0, 1), 3.0)
    for gauge in (seen, near):
        assert gauge.centre == pytest.approx(RADIUS * radial, abs=2e-4 if curved else 0.05)
        assert abs(gauge.normal @ radial) == pytest.approx(1, abs=1e-6 if curved else 1e-3)
        assert gauge.direction @ gauge.normal == pytest.approx(0, abs=1e-2)
        assert gauge.direction[2] > 0.8
        off = places(x, gauge.facet, gauge.barycentric) - gauge.centre
        across = (off**2).sum(axis=1) - (off @ gauge.normal) ** 2
        assert gauge.weight @ across == pytest.approx(1.5**2 / 2, rel=0.03)


@pytest.mark.parametrize(
    ("changes", "key", "text"),
    [
        ({"diameter": 11.0}, "diameter", "of the circle at .* is beyond the edge of the surface"),
        ({"at": (9.5, 5, 0)}, "diameter", "of the circle at .* is beyond the edge"),
        ({"direction": (0.1, 0, 1)}, "direction", r"84 degrees out of the surface, .*0.00, 1.00"),
        ({"at": (5, 5, -3), "towards": (0, 0, -1)}, "towards", "does not meet the surface"),
        ({"at": (50, 5, -3), "towards": (0, 0, 1)}, "towards", "does not meet the surface"),
    ],
)
def test_gauge_points_refuse_what_does_not_fit(
    changes: dict[str, object], key: str, text: str
) -> None:
    keys = {"at": (5, 5, 0), "towards": None, "direction": (1, 0, 0), "diameter": 2.0} | changes
    with pytest.raises(GaugeFault, match=text) as caught:
        gauge_points(PLATE, **keys)  # type: ignore[arg-type]
    assert caught.value.key == key
    assert caught.value.remedy


def test_gauge_points_name_the_largest_circle_that_fits() -> None:
    """A sphere of 14 mm bends by 60 degrees at a radius of 12.1 mm."""
    with pytest.raises(GaugeFault, match="bends by more than 60 degrees") as caught:
        gauge_points(sphere(), (0, 0, 0), (1, 2, 3), (0, 0, 1), 26.0)
    assert "at most about 23 mm" in caught.value.remedy
    with pytest.raises(GaugeFault, match="beyond the edge"):
        gauge_points(sphere(), (0, 0, 0), (1, 2, 3), (0, 0, 1), 40.0)
