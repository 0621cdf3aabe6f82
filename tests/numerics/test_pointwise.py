"""Expressions at points of no mesh: order, shapes, inputs kept, ranks without points."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from ufl import as_vector, outer
from ufl.core.expr import Expr

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
