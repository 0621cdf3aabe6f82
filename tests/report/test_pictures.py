"""Pictures of interfaces in the plane, with known places and sizes."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.plots import curves, figures, maps
from app.report import pictures
from app.results.reading import Run

N = 12  # nodes around the cylinder
LAYERS = 3  # along it
RADIUS = 5.0  # mm
LENGTH = 30.0  # mm


def cylinder(turn: float) -> tuple[Any, Any]:
    """Nodes of a cylinder with a cap at z = 0, and its triangles, turned by an angle [degrees]."""
    angle = np.radians(turn + 360.0 / N * np.arange(N))
    z = np.linspace(0.0, LENGTH, LAYERS + 1)
    ring = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle)], axis=1)
    points = [(x, y, h) for h in z for x, y in ring] + [(0.0, 0.0, 0.0)]
    triangles = []
    for k in range(LAYERS):
        for i in range(N):
            a, b = k * N + i, k * N + (i + 1) % N
            triangles += [(a, b, b + N), (a, b + N, a + N)]
    cap = [(i, (i + 1) % N, len(points) - 1) for i in range(N)]
    return np.array(points), np.array(triangles + cap)


@pytest.mark.parametrize("turn", [0.0, 7.0, 15.0, -100.0])
def test_pictures_cylinder_is_unrolled_exactly(turn: float) -> None:
    """There are no holes or smears at the seam: each place in the window is in one triangle."""
    points, triangles = cylinder(turn)
    corners, nodes = pictures.unroll(points, triangles)
    x = points[nodes]
    assert corners[:, :, 1] == pytest.approx(x[:, :, 2], abs=1e-12)
    angle = corners[:, :, 0]
    assert RADIUS * np.cos(np.radians(angle)) == pytest.approx(x[:, :, 0], abs=1e-9)
    assert RADIUS * np.sin(np.radians(angle)) == pytest.approx(x[:, :, 1], abs=1e-9)
    # The cap is seen edge on and left out.
    assert len(points) - 1 not in nodes
    assert np.ptp(angle, axis=1) == pytest.approx(360.0 / N)
    low, high = pictures.SEAM, pictures.SEAM + 360.0
    # One that ends at the seam may be there on its other side too, by rounding.
    assert angle.min(axis=1).max() < high + 1e-9 and angle.max(axis=1).min() > low - 1e-9
    rng = np.random.default_rng(1)
    sample = np.stack([rng.uniform(low, high, 400), rng.uniform(0.0, LENGTH, 400)], axis=1)
    inside = np.zeros(len(sample), dtype=int)
    for a, b, c in corners:
        shares = np.linalg.solve(np.stack([b - a, c - a], axis=1), (sample - a).T)
        inside += (shares.min(axis=0) >= 0) & (shares.sum(axis=0) <= 1)
    assert (inside == 1).all()


def two_bodies(order: int) -> Any:
    """A run of two tetrahedra on a common face, with separate nodes there."""
    face = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]])
    corners = [np.vstack([face, [[0.0, 0, z]]]) for z in (-3.0, 3.0)]
    if order == 2:
        ends = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])
        corners = [np.vstack([x, x[ends].mean(axis=1)]) for x in corners]
    width = len(corners[0])
    points = np.vstack(corners)
    cells = np.arange(2 * width).reshape(2, width)
    return SimpleNamespace(points=points, cells=cells, region=np.array([1, 2]))


@pytest.mark.parametrize("order", [1, 2])
def test_pictures_facets_are_those_of_the_interface(order: int) -> None:
    run = two_bodies(order)
    triangles = pictures.facets(run, [2], [1])
    assert (triangles >= len(run.points) // 2).all()
    x = run.points[triangles]
    assert x[:, :, 2] == pytest.approx(0.0)
    area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1) / 2
    # A facet with six nodes is four triangles.
    assert area == pytest.approx([2.0] if order == 1 else [0.5] * 4)


def test_pictures_flat_interface_is_drawn_in_its_plane() -> None:
    run = two_bodies(1)
    sheet = pictures.sheet(run, False, (("lower",), ("upper",)), ("lower", "upper"))
    assert sheet is not None and not sheet.round
    a, b, c = sheet.corners[0]
    lengths = sorted(float(np.linalg.norm(e)) for e in (b - a, c - b, a - c))
    assert lengths == pytest.approx([2.0, 2.0, np.sqrt(8.0)])
    # Bodies that do not meet have no map.
    run.points[4:] += 1.0
    assert pictures.sheet(run, False, (("a",), ("b",)), ("a", "b")) is None


def test_pictures_rows_and_titles_do_not_overlap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Titles cover neither each other nor neighbouring rows."""
    drawn: list[Any] = []
    new = figures.new
    monkeypatch.setattr(figures, "new", lambda *size: drawn.append(new(*size)) or drawn[-1])
    points, triangles = cylinder(0.0)
    corners, nodes = pictures.unroll(points, triangles)
    run: Run = SimpleNamespace()  # type: ignore[assignment]
    sheet = pictures.Sheet(corners, nodes, True)
    rows: list[pictures.Row] = [
        ("height (mm)", "viridis", [points[:, 2]] * 2),
        ("nothing", "viridis", [None] * 2),
    ]
    path = tmp_path / "map.png"
    more = "_youngs_modulus=110GPa_order=2_size=4mm"
    names = (f"friction_coefficient={f}_cement_thickness=4mm{more}" for f in (0.2, 0.4))
    columns = [(name, run, sheet) for name in names]
    assert pictures.draw(path, columns, rows) == ["height (mm)"]
    first, second = (axes.title.get_window_extent() for axes in drawn[0].axes[:2])
    assert first.x1 < second.x0
    assert first.height > 2.5 * 10 * drawn[0].dpi / 72  # three lines
    assert max(first.y1, second.y1) <= drawn[0].bbox.height
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    assert "<svg" in path.with_suffix(".svg").read_text()
    assert pictures.draw(tmp_path / "none.png", [("one", run, sheet)], rows[1:]) == []
    assert not (tmp_path / "none.png").exists()


def test_pictures_points_and_bars_stay_inside_the_frame() -> None:
    """The numbers are far from zero and similar, and their axis begins at zero.

    Pages behave the same.
    """
    line = curves.Line("a", 0, [0.2, 0.8], [98.8, 91.0], [2.0, 2.0])
    panel = curves.Panel("slip", "µm", [line], "friction")
    axes = figures.new(4.0, 3.0).subplots()
    curves.draw_panel(axes, panel)
    low, high = axes.get_ylim()
    assert low == 0 and high > 1.04 * 100.8
    drawn = curves.drawing(panel)
    assert drawn.up[0] == (0.0, "0") and drawn.columns == 2
    for _, middle, least, most in drawn.lines[0].points:
        assert 0 < least < middle < most <= 1 and middle == pytest.approx((least + most) / 2)


@pytest.mark.parametrize("way", [1, -1])
def test_pictures_linear_field_is_shaded_without_streaks(way: int) -> None:
    """Thin triangles have parallel diagonals. Nothing is drawn outside of them."""
    u, v = (g.ravel() for g in np.meshgrid(np.arange(9.0) * 40.0, np.arange(61.0)))
    a = np.arange(len(u)).reshape(61, 9)
    low, high = (a[:-1, :-1].ravel(), a[:-1, 1:].ravel()), (a[1:, :-1].ravel(), a[1:, 1:].ravel())
    kept = low[0] % 9 < 6  # the rest of the plane is empty
    lower, upper = (low[0], low[1], high[1]), (low[0], high[1], high[0])
    triangles = np.concatenate([np.stack(t, axis=1)[kept] for t in (lower, upper)])[:, ::way]
    plane = np.stack([u, v], axis=1)[triangles]
    figure = figures.new(4.0, 3.0)
    axes = figure.subplots()
    axes.set(xlim=(0.0, 320.0), ylim=(0.0, 60.0), facecolor="w")
    axes.set_axis_off()
    maps.shaded(axes, plane, u[triangles], "gray", (0.0, 480.0))
    figure.canvas.draw()
    box = axes.get_window_extent()
    pixels = np.asarray(figure.canvas.buffer_rgba())[:, :, 0].astype(float)
    shown = pixels[::-1][int(box.y0) + 3 : int(box.y1) - 3, int(box.x0) : int(box.x1)]
    end = int(0.75 * shown.shape[1])
    assert np.ptp(shown[:, : end - 2], axis=0).max() <= 1.0  # the same at all heights
    expected = 255.0 * (np.arange(shown.shape[1]) + 0.5) / shown.shape[1] * 320.0 / 480.0
    assert np.abs(shown[:, : end - 2] - expected[: end - 2]).max() < 2.5
    assert (shown[:, end + 2 :] == 255.0).all()
