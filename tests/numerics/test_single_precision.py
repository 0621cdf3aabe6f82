"""Products of symmetric matrices in single precision."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from app.numerics import single_precision
from app.numerics.single_precision import SinglePrecision
from app.numerics.sparse import from_triplets
from tests import support

# Unit roundoff of single precision: half of the distance from 1 to the next number.
ROUNDOFF = 2.0**-24


def symmetric(points: int, blocks: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triplets of a random symmetric matrix of full 3 x 3 blocks, diagonal ones among them."""
    rng = np.random.default_rng(seed)
    pair = rng.integers(0, points, (blocks, 2))
    pair = np.vstack([pair, np.repeat(np.arange(points), 2).reshape(-1, 2)])
    row = np.repeat(3 * pair[:, 0], 9) + np.tile(np.repeat(np.arange(3), 3), len(pair))
    column = np.repeat(3 * pair[:, 1], 9) + np.tile(np.arange(3), 3 * len(pair))
    value = rng.normal(size=len(row)) * 10.0 ** rng.uniform(-3, 3)
    return np.append(row, column), np.append(column, row), np.append(value, value)


@pytest.mark.parametrize(("points", "blocks"), [(1, 0), (2, 3), (40, 300)])
def test_single_precision_product_is_that_of_the_matrix(points: int, blocks: int) -> None:
    """Rounding of entries, of x and of sums: each term of a row has a few units of roundoff."""
    A = from_triplets(MPI.COMM_SELF, 3 * points, 3 * points, *symmetric(points, blocks, 7))
    x, y = A.createVecs()
    x.array[:] = np.random.default_rng(8).normal(size=3 * points)
    single = SinglePrecision(A)
    single.matrix.mult(x, y)
    dense = A[:, :]
    terms = np.abs(dense) @ np.abs(x.array)
    error = np.abs(y.array - dense @ x.array)
    assert (error <= (8 + dense.shape[0]) * ROUNDOFF * terms).all()
    assert error.max() > 0, "a product in double precision"


def test_single_precision_product_is_exact_for_small_integers() -> None:
    """Single precision has all integers below 2^24."""
    rows, columns, values = symmetric(30, 200, 3)
    A = from_triplets(MPI.COMM_SELF, 90, 90, rows, columns, np.rint(values))
    x, y = A.createVecs()
    x.array[:] = np.random.default_rng(4).integers(-9, 9, 90)
    single = SinglePrecision(A)
    single.matrix.mult(x, y)
    np.testing.assert_array_equal(y.array, A[:, :] @ x.array)


def test_single_precision_rows_in_parts_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    A = from_triplets(MPI.COMM_SELF, 60, 60, *symmetric(20, 80, 5))
    x, y = A.createVecs()
    x.set(1.0)
    products = []
    for nodes in (20, 7, 1):
        monkeypatch.setattr(single_precision, "NODES_AT_A_TIME", nodes)
        single = SinglePrecision(A)
        single.matrix.mult(x, y)
        products.append(y.array.copy())
    np.testing.assert_array_equal(products[1:], [products[0]] * 2)


def test_single_precision_keeps_the_matrix_as_it_was() -> None:
    A = from_triplets(MPI.COMM_SELF, 9, 9, *symmetric(3, 4, 6))
    x, y = A.createVecs()
    x.set(1.0)
    single = SinglePrecision(A)
    single.matrix.mult(x, y)
    before = y.array.copy()
    A.scale(2.0)
    single.matrix.mult(x, y)
    np.testing.assert_array_equal(y.array, before)


BEFORE_A_CLOSED_PAGE = """
import ctypes
import mmap

import numpy as np
from mpi4py import MPI

from app.numerics.single_precision import SinglePrecision
from app.numerics.sparse import from_triplets

row, column = np.divmod(np.arange(9), 3)
A = from_triplets(MPI.COMM_SELF, 3, 3, row, column, np.eye(3).ravel())
single, page = SinglePrecision(A), mmap.PAGESIZE
memory = np.frombuffer(mmap.mmap(-1, 2 * page), np.uint8)
libc = ctypes.CDLL(None)
assert libc.mprotect(ctypes.c_void_p(memory.ctypes.data + page), page, 0) == 0
size = single._blocks.nbytes
memory[page - size : page] = single._blocks.view(np.uint8).ravel()
single._blocks = memory[page - size : page].view(np.float32)
x, y = A.createVecs()
x.array[:] = 1.0, 2.0, 3.0
single.matrix.mult(x, y)
print(y.array.tolist())
"""


def test_single_precision_reads_nothing_behind_its_blocks() -> None:
    """The blocks end at a page that must not be read."""
    assert support.python("-c", BEFORE_A_CLOSED_PAGE).stdout.splitlines()[-1] == "[1.0, 2.0, 3.0]"
