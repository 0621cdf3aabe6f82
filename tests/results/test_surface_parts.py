"""Parts of interfaces are cut exactly; point values are recovered from means."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from app.foundation.arrays import Floats, Ints
from app.results.interface_numbers import ContactSamples, shear_of_faces
from app.results.stresses import Stresses
from app.results.surface_parts import Surface
from tests import support

Function = Callable[[Floats, Floats], Floats]


def grid(n: int, length: float = 1.0, jitter: float = 0.0, cells: int = 0) -> tuple[Floats, Ints]:
    """Points (m, 3) and triangles of a rectangle of n by `cells` squares; by default n squares."""
    cells = cells or n
    i, j = np.meshgrid(np.arange(n + 1), np.arange(cells + 1), indexing="ij")
    x = np.stack([i * length / n, j / cells, 0.0 * i], axis=-1).reshape(-1, 3)
    inner = (x[:, 0] % length > 0) & (x[:, 1] % 1 > 0)
    x[inner, :2] += jitter / n * np.random.default_rng(n).uniform(-1, 1, (int(inner.sum()), 2))
    a = (i * (cells + 1) + j)[:-1, :-1].ravel()
    b, c, d = a + cells + 1, a + cells + 2, a + 1
    return x, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def flat(x: Floats, triangles: Ints) -> Any:
    """The points of one plane interface, in the form of `ContactSurface`."""
    sides = x[triangles[:, 1:]] - x[triangles[:, :1]]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2
    weight = np.bincount(triangles.ravel(), np.repeat(area / 3, 3), len(x))
    normals = np.zeros((len(x), 3, 3))
    normals[:, 0, 2] = 1.0
    return SimpleNamespace(
        interface=np.zeros(len(x), dtype=int),
        x=x,
        weight=weight,
        normals=normals,
        faces=np.ones(len(x), dtype=int),
        triangles=(triangles,),
    )


def plane(n: int, **borders: Function) -> tuple[Floats, Surface]:
    x, triangles = grid(n, jitter=0.2)
    return x, Surface(flat(x, triangles), 0, {k: f(x[:, 0], x[:, 1]) for k, f in borders.items()})


def test_surface_parts_are_cut_along_their_border() -> None:
    """Half-planes of the unit square have exact areas and means on any mesh."""
    x, surface = plane(5, tip=lambda x, y: y - 0.37, rim=lambda x, y: x + y - 0.9)
    # Above y = 0.37, the triangle x + y < 0.9 has legs of 0.53.
    area = {"tip": 0.37, "rim": 0.53**2 / 2, "": 0.63 - 0.53**2 / 2}
    for part, expected in area.items():
        field = surface.field(x[:, 0], part)
        assert field.area == pytest.approx(expected, rel=1e-12)
        assert surface.weight[part].sum() == pytest.approx(expected, rel=1e-12)
    moments = {"tip": 0.37 / 2, "rim": 0.53**3 / 6, "": 0.63 / 2 - 0.53**3 / 6}
    for part, expected in moments.items():
        field = surface.field(x[:, 0], part)
        assert field.area * field.mean() == pytest.approx(expected, rel=1e-12)
    most, place = surface.field(x[:, 1], "rim").maximum()
    assert most == pytest.approx(0.9) and place[:2] == pytest.approx([0.0, 0.9])
    assert surface.field(x[:, 1], "tip").maximum()[0] == pytest.approx(0.37)
    assert surface.field(x[:, 1], "tip").percentile() == pytest.approx(0.99 * 0.37)


def test_surface_parts_areas_add_up() -> None:
    x, surface = plane(6, tip=lambda x, y: y - 0.4, rim=lambda x, y: (x - 0.5) ** 2 - 0.04)
    whole = flat(x, surface.triangles).weight
    assert sum(surface.weight.values()) == pytest.approx(whole)
    assert sum(surface.field(x[:, 0], p).area for p in surface.parts) == pytest.approx(1.0)


def test_surface_parts_that_are_rounding_are_left_out() -> None:
    """A stem above a void has no tip on the interface: the border is the end of the surface."""
    _, surface = plane(5, tip=lambda x, y: y - 1e-9, rim=lambda x, y: 0.9 - y)
    assert surface.parts == ["", "rim"]


@settings(max_examples=100, deadline=None)
@given(
    values=st.lists(st.integers(0, 1000), min_size=16, max_size=16),
    levels=st.lists(st.integers(-50, 50), min_size=16, max_size=16),
    fraction=st.floats(0.0, 1.0),
)
def test_surface_parts_percentile_is_below_the_maximum(
    values: list[int], levels: list[int], fraction: float
) -> None:
    """This holds for any values, means or recovered, in any part."""
    x, triangles = grid(3)
    surface = Surface(flat(x, triangles), 0, {"rim": np.array(levels) / 50})
    means = np.repeat(np.array(values)[:, None] / 7, 3, axis=1)
    for part in surface.parts:
        for field in (surface.field(v, part) for v in (means, surface.sharpened(means))):
            most, _ = field.maximum()
            assert field.percentile(fraction) <= most
            assert field.mean() <= most * (1 + 1e-12)


def recovered(x: Floats, triangles: Ints, f: Function) -> tuple[Floats, Floats, Floats]:
    """Exact values of a function at points, its means by shape functions, recovered values.

    Means are by quadrature, exact to rounding for polynomials on parts of a facet of a 24th.
    """
    surface, parts = Surface(flat(x, triangles), 0, {}), 24
    i, j = np.meshgrid(np.arange(parts), np.arange(parts), indexing="ij")
    at = np.array([(i + 1 / 3, j + 1 / 3), (i + 2 / 3, j + 2 / 3)]) / parts
    at = at.transpose(0, 2, 3, 1).reshape(-1, 2)
    inside = at.sum(axis=1) < 1
    at = at[inside]
    hats = np.column_stack([1 - at.sum(axis=1), at])
    places = np.einsum("qb,tbi->tqi", hats, x[triangles])
    values = f(places[..., 0], places[..., 1])
    sums = np.einsum("qb,tq,t->tb", hats, values, surface.area / len(hats))
    weights = np.einsum("qb,t->tb", hats, surface.area / len(hats))
    total, area = (np.bincount(triangles.ravel(), s.ravel(), len(x)) for s in (sums, weights))
    means = total / area
    three = np.repeat(means[:, None], 3, axis=1)
    return f(x[:, 0], x[:, 1]), means, surface.sharpened(three)[:, 0]


def test_surface_parts_recovery_keeps_constants_and_signs() -> None:
    """Means are zero at open points, and negative in tension."""
    x, triangles = grid(6, jitter=0.2)
    surface = Surface(flat(x, triangles), 0, {})
    assert surface.sharpened(np.full((len(x), 3), 3.7))[:, 0] == pytest.approx(3.7)
    means = np.where(x[:, :1] > 0.5, x[:, :1], 0.0) * np.ones(3)
    sharp = surface.sharpened(means)
    assert (sharp >= 0).all() and sharp.max() > means.max()
    assert surface.sharpened(-means) == pytest.approx(-sharp)


def order(errors: list[float]) -> float:
    """Fitted order over halved sizes."""
    return float(-np.polyfit(np.arange(len(errors)), np.log2(errors), 1)[0])


def test_surface_parts_recovery_converges_at_second_order() -> None:
    """Inside this is the order. At the border means are one-sided, and recovery gains an order."""
    errors: dict[str, list[float]] = {"mean": [], "sharp": [], "mean, edge": [], "sharp, edge": []}
    for n in (8, 16, 32):
        x, triangles = grid(n)
        exact, mean, sharp = recovered(
            x, triangles, lambda x, y: 2 + np.sin(3 * x + 1) * np.cos(2 * y)
        )
        inner = (np.abs(x[:, :2] - 0.5) < 0.3).all(axis=1)
        edge = np.isclose(x[:, 0], 1.0) & (np.abs(x[:, 1] - 0.5) < 0.3)
        for name, values in (("mean", mean), ("sharp", sharp)):
            errors[name].append(float(np.abs(values - exact)[inner].max()))
            errors[f"{name}, edge"].append(float(np.abs(values - exact)[edge].max()))
    assert order(errors["mean"]) > 1.9 and order(errors["sharp"]) > 1.9
    assert order(errors["mean, edge"]) == pytest.approx(1.0, abs=0.15)
    assert errors["sharp, edge"][-1] < 0.3 * errors["mean, edge"][-1]


def test_surface_parts_recovery_at_a_ridge() -> None:
    """A kink of slope s on points at a distance h has means that are s h / 3 too low."""
    for n in (8, 16, 32):
        # A strip, so that the shape functions are those of one dimension in the middle.
        x, triangles = grid(n, 1.0, cells=n)
        exact, mean, sharp = recovered(x, triangles, lambda x, y: 5 - 4 * np.abs(x - 0.5))
        top = np.isclose(x[:, 0], 0.5) & (np.abs(x[:, 1] - 0.5) < 0.3)
        low, left = (exact - mean)[top].max(), np.abs(exact - sharp)[top].max()
        assert low == pytest.approx(4 / n / 3, rel=0.05)
        assert left < low / 4


def test_surface_parts_recovery_of_a_rounded_punch() -> None:
    """The pressure rises like a root at its edge and is zero beyond, so no value grows.

    The pressure is p = sqrt(1 - x^2) within |x| < 1 (Hertz), and zero beyond. The largest value and
    the 95th percentile converge.
    """
    errors: dict[str, list[float]] = {"mean": [], "sharp": []}
    # Where p exceeds it there lies a twentieth of the area: |x| < 0.05 * 1.5.
    level = np.sqrt(1 - 0.075**2)
    for n in (12, 24, 48):
        x, triangles = grid(n, 1.5, cells=8)
        surface = Surface(flat(x, triangles), 0, {})
        _, mean, sharp = recovered(x, triangles, lambda x, y: np.sqrt(np.maximum(1 - x**2, 0.0)))
        for name, values in (("mean", mean), ("sharp", sharp)):
            field = surface.field(values, "")
            errors[name].append(abs(field.percentile(0.95) - level))
            assert field.maximum()[0] < 1.01
        assert (sharp[x[:, 0] > 1.0 + 3.0 / n] < 0.05).all()
    assert errors["sharp"][-1] < 5e-3 and order(errors["sharp"]) > 0.9


def test_surface_parts_recovery_skips_held_points() -> None:
    """A held point has no reported traction, so its zero is left out."""
    x, triangles = grid(6)
    points = flat(x, triangles)
    held = np.isclose(x[:, 0], 0.0)
    points.faces = np.where(held, 0, 1)
    surface = Surface(points, 0, {})
    means = np.where(held, 0.0, 3.0)[:, None] * np.ones(3)
    sharp = surface.sharpened(means)[:, 0]
    assert sharp[held] == pytest.approx(0.0)
    assert sharp[np.isclose(x[:, 0], 1 / 6)] == pytest.approx(3.0)


def test_surface_parts_faces_of_an_edge_have_separate_means() -> None:
    """A right angle is under one pressure.

    The force of its edge is divided by the areas of its faces.
    """
    x, triangles = grid(4)
    other = x[:, [2, 1, 0]] * [1.0, 1.0, -1.0]
    edge = np.isclose(x[:, 0], 0.0)
    n = len(x)
    new = np.where(edge, np.arange(n), n + np.cumsum(~edge) - 1)
    corner = flat(np.concatenate([x, other[~edge]]), triangles)
    corner.triangles = (np.concatenate([triangles, new[triangles]]),)
    both = np.zeros((len(corner.x), 3, 3))
    both[:n, 0, 2], both[n:, 0, 0] = 1.0, 1.0
    both[: len(edge)][edge, 1, 0] = 1.0
    corner.normals = both
    corner.faces = np.ones(len(corner.x), dtype=int)
    corner.faces[: len(edge)][edge] = 2
    sides = corner.x[corner.triangles[0]]
    area = (
        np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1) / 2
    )
    corner.weight = np.bincount(corner.triangles[0].ravel(), np.repeat(area / 3, 3), len(corner.x))
    corner.interface = np.zeros(len(corner.x), dtype=int)
    surface = Surface(corner, 0, {})
    # A pressure of 2 MPa: half of it over the whole area of a point with two equal faces.
    pressures = np.where(corner.faces[:, None] > np.arange(3), 2.0 / corner.faces[:, None], 0.0)
    means = surface.of_faces(pressures)
    field = surface.field(means, "")
    assert field.maximum()[0] == pytest.approx(2.0) and field.mean() == pytest.approx(2.0)
    assert surface.field(surface.sharpened(means), "").maximum()[0] == pytest.approx(2.0)


def test_surface_parts_faces_of_an_edge_carry_friction_by_pressure() -> None:
    """Coulomb's law holds on each face. The friction forces add up to that of the point."""
    areas, μ = np.array([[1.0, 3.0, 0.0], [4.0, 0.0, 0.0]]), 0.4
    pressures = np.array([[0.5, 1.5, 0.0], [0.0, 0.0, 0.0]])  # over 4 mm2
    of_faces = np.array([[2.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    shear = shear_of_faces(np.array([μ * 2.0, 0.1]), pressures, of_faces)
    assert shear[0] == pytest.approx(μ * of_faces[0])
    assert shear[0] @ areas[0] == pytest.approx(μ * 2.0 * 4.0)
    assert shear[1, 0] == 0.1  # bonded, without pressure


def test_surface_parts_sliver_has_the_pressure_of_its_point() -> None:
    """A face of a fiftieth of its point does not have fifty times the pressure."""
    x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.02]], dtype=float)
    triangles = np.array([[0, 1, 2], [0, 1, 3]])
    points = flat(x, triangles)
    points.normals[:, 1, 1] = 1.0
    points.faces = np.array([2, 2, 1, 1])
    points.normals[3, 0] = [0.0, 1.0, 0.0]
    surface = Surface(points, 0, {})
    pressures = np.zeros((4, 3))
    pressures[:2] = [0.0, 10.0, 0.0]
    means = surface.of_faces(pressures)
    assert means[0] == pytest.approx([0.0, 10.0, 0.0])
    assert surface.sharpened(means)[0] == pytest.approx([0.0, 10.0, 0.0])


# A block pressed by 1 um on one of 2 mm without Poisson's ratio: 0.05 MPa on 16 mm2.
PRESSED = """
geometry: {kind: blocks, blocks: [{name: stem, size: [4 mm, 4 mm, 2 mm]},
                                  {name: upper, size: [4 mm, 4 mm, 1 mm]}]}
mesh: {order: 1, size: 0.5 mm, far_size: 1 mm}
regions: {stem: {youngs_modulus: 100 MPa, poisson_ratio: 0}, upper: {rigid: true}}
interfaces: {stem_upper: {kind: contact, friction_coefficient: 0}}
supports: {floor: {kind: fixed, boundary: bottom}, hand: {kind: displacement, boundary: top,
                                                          x: 0 mm, y: 0 mm, z: -1 um}}
"""
# Where y < 1 mm is the tip, and of what is left where x < 1 mm the rim [mm2].
AREAS = {"tip": 4.0, "rim": 3.0, "": 9.0}


@pytest.fixture(scope="module")
def pressed() -> support.Solved:
    return support.solve(PRESSED)


def divided(solved: support.Solved) -> tuple[Surface, dict[str, Any]]:
    """The interface in its parts, and its numbers."""
    contact = solved.problem.contact
    assert contact is not None
    x, y, _ = contact.points.surface.x.T
    surface = Surface(contact.points.surface, 0, {"tip": y - 1.0, "rim": x - 1.0})
    trial = solved.problem.trial(*solved.solver.u_and_q())  # type: ignore[arg-type]
    return surface, ContactSamples(solved.problem, trial, None, [surface]).numbers["stem_upper"]


def test_surface_parts_add_up_to_the_interface(pressed: support.Solved) -> None:
    _, numbers = divided(pressed)
    for part in ("rim", "tip"):
        area = numbers[part]["area"]
        assert area == pytest.approx(AREAS[part], rel=1e-12)
        assert numbers[part]["force"] == pytest.approx([0, 0, 0.05 * area], abs=1e-9)
    whole = sum(part["area"] for part in (numbers, numbers["rim"], numbers["tip"]))
    assert whole == pytest.approx(16.0)
    assert numbers["force"] == pytest.approx([0, 0, 0.05 * 16.0], abs=1e-9)


def test_surface_parts_have_separate_statistics(pressed: support.Solved) -> None:
    """The coordinate x has a mean of 2.5 mm over the rest."""
    surface, numbers = divided(pressed)
    x = pressed.last.x[:, 0]
    for part, mean, most in (("", 2.5, 4.0), ("rim", 0.5, 1.0), ("tip", 2.0, 4.0)):
        field = surface.field(x, part)
        assert field.area == pytest.approx(AREAS[part], rel=1e-12)
        assert field.mean() == pytest.approx(mean, rel=1e-12)
        assert field.percentile(1.0) == field.maximum()[0]
        assert field.maximum()[0] == pytest.approx(most)
    assert min(numbers["gap_max_at"][:2]) >= 1.0 >= numbers["rim"]["gap_max_at"][0]


def test_surface_parts_of_an_undivided_interface(pressed: support.Solved) -> None:
    numbers = pressed.interfaces["stem_upper"]
    assert numbers["area"] == pytest.approx(16.0) and not {"rim", "tip"} & numbers.keys()


def test_surface_parts_neck_is_separate_from_the_stem(
    pressed: support.Solved, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tension is z [MPa]. The neck begins at 1 mm, so it has tension above 1 MPa."""
    stresses = Stresses(pressed.problem, depth=lambda x: 1.0 - x[:, 2])
    z = stresses.points_and_volumes("stem")[0][:, 2]
    monkeypatch.setattr(stresses, "evaluate", lambda _: np.multiply.outer(z, np.diag([0, 0, 1.0])))
    stem = stresses.numbers_of_region("stem")
    assert (
        0.5 < stem["von_mises_p99"] <= stem["von_mises_max"] < 1.0 < stem["neck"]["principal_max"]
    )
    assert stem["volume"] + stem["neck"]["volume"] == pytest.approx(32.0)
    assert stem["neck"]["von_mises_max"] == pytest.approx(z.max())
    assert stem["neck"]["von_mises_max_at"][2] == pytest.approx(z.max())
    without = Stresses(pressed.problem)
    assert "neck" not in without.numbers_of_region("stem")
