"""Expressions at points of no mesh: order, shapes, kept inputs, ranks without points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from ufl import as_vector, outer
from ufl.core.expr import Expr

from app.numerics import pointwise
from app.numerics.pointwise import Pointwise


def expressions(x: dict[str, Expr]) -> list[Expr]:
    return [x["s"] * x["v"][0], as_vector([x["s"], x["v"][1]]), outer(x["v"], x["v"])]


def test_pointwise_values_keep_the_order_of_points() -> None:
    rng = np.random.default_rng(1)
    s, v = rng.normal(size=50), rng.normal(size=(50, 3))
    law = Pointwise(MPI.COMM_SELF, 50, {"s": 1, "v": 3}, expressions)
    scalar, vector, tensor = law(s=s, v=v)
    assert np.allclose(scalar, s * v[:, 0])
    assert np.allclose(vector, np.stack([s, v[:, 1]], axis=1))
    assert np.allclose(tensor, v[:, :, None] * v[:, None, :])
    # An input that is not given again keeps its values.
    assert np.allclose(law(s=2 * s)[0], 2 * scalar)
    law.set(v=3 * v)
    assert np.allclose(law()[2], 9 * tensor)


def test_pointwise_without_points_gives_empty_arrays() -> None:
    law = Pointwise(MPI.COMM_SELF, 0, {"s": 1, "v": 3}, expressions)
    values = law(s=np.zeros(0), v=np.zeros((0, 3)))
    assert [f.shape for f in values] == [(0,), (0, 2), (0, 3, 3)]


def test_pointwise_compiled_law_is_found_without_building(tmp_path: Path) -> None:
    """A law is built again if its note names code that is missing, or is damaged."""
    built: list[int] = []

    def law(x: dict[str, Any]) -> list[Any]:
        built.append(1)
        return [x["b"] * x["v"], x["a"] - x["b"]]

    rng = np.random.default_rng(5)
    a, b, v = rng.random(6), rng.random(6), rng.random((6, 3))
    note = tmp_path / "law.json"

    def check() -> None:
        compiled = pointwise.Pointwise(MPI.COMM_SELF, 6, {"a": 1, "v": 3, "b": 1}, law, note)
        scaled, difference = compiled(a=a, b=b, v=v)
        np.testing.assert_allclose(scaled, b[:, None] * v)
        np.testing.assert_allclose(difference, a - b)

    for expected in (1, 1):
        check()
        assert len(built) == expected
    saved = note.read_text()
    for text in ("", "{}", "[1]", saved.replace("libffcx", "nowhere"), saved.replace("_", "-")):
        built.clear()
        note.write_text(text)
        check()
        assert len(built) == 1 and note.read_text() == saved


def test_pointwise_compiled_law_has_a_new_note_if_changed(tmp_path: Path) -> None:
    source = tmp_path / "source.py"
    notes = set()
    for text in ("1", "2"):
        source.write_text(text)
        notes |= {pointwise.note_of(law, [source]) for law in ("plain", "corner")}
    assert len(notes) == 4
