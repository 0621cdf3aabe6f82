"""Costs that a run does not have: imports it has no use for, and units without pint."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

from mpi4py import MPI

import gmsh
import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import meshes
from app.case.case import load
from app.numerics import pointwise
from app.numerics.sparse import from_triplets
from app.schema import units
from app.system import folders
from meshes import cache
from meshes.data import connected
from tests import support


def test_start_of_a_run_imports_no_mesher_pictures_or_scipy(tmp_path: Path) -> None:
    """Each costs a tenth of a second and more, in a run that could take two without its page."""
    path = support.CONFIGS / "blocks.yaml"
    case = load(path).config
    meshes.build(case.geometry, case.mesh, folders.cache("meshes"))
    script = (
        "import sys; from app.cli import main; "
        f"assert main(['run', {str(path)!r}, '-o', {str(tmp_path)!r}, "
        "'--set', 'output.report=false']) == 0; "
        "print(*sys.modules)"
    )
    loaded = set(support.python("-c", script).stdout.splitlines()[-1].split())
    assert "dolfinx" in loaded
    assert not loaded & {"gmsh", "matplotlib", "pandas", "pint", "scipy.sparse", "scipy.spatial"}


def test_start_of_a_parametric_femur_imports_nothing_for_patients() -> None:
    """Imports of the search for landmarks on a patient's bone take 0.15 s."""
    path = str(support.CONFIGS / "stance.yaml")
    script = (
        "import sys; from pathlib import Path; from app.case.case import load; "
        f"assert load(Path({path!r})).config.geometry.placement.top > 0; print(*sys.modules)"
    )
    loaded = set(support.python("-c", script).stdout.splitlines()[-1].split())
    assert "meshes.placement" in loaded
    for_patients = {
        f"scipy.{name}" for name in ("interpolate", "ndimage", "optimize", "signal", "stats")
    }
    assert not loaded & (for_patients | {"app.patient.bone"})


def test_start_mesh_key_has_the_version_of_gmsh() -> None:
    assert cache._gmsh_version() == gmsh.__version__


def test_start_unit_conversion_is_cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forget() -> None:
        units.conversion.cache_clear()
        units._kept.cache_clear()

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    forget()
    name = "kN/inch^2"
    factors = units.conversion(name, "MPa")
    assert factors[0] == Fraction(1000) / Fraction("25.4") ** 2
    forget()
    with monkeypatch.context() as without:
        without.setattr(units, "registry", lambda: pytest.fail("asked again"))
        assert units.conversion(name, "MPa") == factors
    kept = tmp_path / "mantle/units/conversions.json"
    for text in ("{broken", "[]", "\0", *(f'{{"{name} in MPa": {v}}}' for v in (1, '["x"]'))):
        kept.write_text(text)
        forget()
        assert units.conversion(name, "MPa") == factors
    forget()


def test_start_connected_components_equal_those_of_scipy() -> None:
    rng = np.random.default_rng(3)
    for n, pairs in ((1, 0), (40, 25), (200, 190), (300, 900)):
        a, b = rng.integers(0, n, (2, pairs))
        graph = coo_array((np.ones(pairs), (a, b)), shape=(n, n))
        _, expected = connected_components(graph, directed=False)
        np.testing.assert_array_equal(connected(n, a, b), expected)


def test_start_sparse_triplets_are_summed() -> None:
    rng = np.random.default_rng(4)
    i, j, v = rng.integers(0, 5, 60), rng.integers(0, 7, 60), rng.random(60)
    expected = np.zeros((5, 7))
    np.add.at(expected, (i, j), v)
    A = from_triplets(MPI.COMM_SELF, 5, 7, i, j, v)
    np.testing.assert_allclose(A[:, :], expected)
    none = np.zeros(0, dtype=np.int64)
    assert from_triplets(MPI.COMM_SELF, 2, 3, none, none, np.zeros(0)).norm() == 0.0


def test_start_compiled_law_is_found_without_building(tmp_path: Path) -> None:
    """And is built where its note tells of code that is not there, or of nothing."""
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


def test_start_compiled_law_has_a_new_note_if_changed(tmp_path: Path) -> None:
    source = tmp_path / "source.py"
    notes = set()
    for text in ("1", "2"):
        source.write_text(text)
        notes |= {pointwise.note_of(law, [source]) for law in ("plain", "corner")}
    assert len(notes) == 4
