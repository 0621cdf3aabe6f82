"""Drawings of curves."""

from __future__ import annotations

from app.plots import curves


def test_curves_drawing_wraps_title_and_starts_at_zero() -> None:
    line = curves.Line("a", 0, [1.0, 2.0], [98.0, 99.0])
    drawn = curves.drawing(curves.Panel("word " * 15, "MPa", [line]))
    assert len(drawn.title) == 2 and max(map(len, drawn.title)) <= curves.TITLE
    assert drawn.up[0] == (0.0, "0") and drawn.across[0] == (0.0, "1")
    warm = curves.drawing(curves.Panel("temperature", "°C", [line]))
    assert float(warm.up[0][1]) > 90
