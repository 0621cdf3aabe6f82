"""Versions that a run depends on, compared with those that the packages report."""

from __future__ import annotations

import json
import sys

from petsc4py import PETSc

import dolfinx
import gmsh
import pytest

from app import __version__
from app.system import identity
from tests import support


def test_identity_versions_are_those_of_libraries() -> None:
    versions = identity.versions()
    assert list(versions) == ["mantle", "dolfinx", "petsc", "gmsh", "blas"]
    assert versions["mantle"].startswith(f"{__version__} ")
    assert versions["dolfinx"] == dolfinx.__version__
    assert versions["petsc"] == ".".join(map(str, PETSc.Sys.getVersion()))
    assert versions["gmsh"].startswith(gmsh.__version__)


def parts_in_process(**environ: str) -> dict[str, str]:
    """The parts in a separate process, which does not load MPI for Python."""
    code = (
        "import json, sys; from app.system import identity; print(json.dumps(identity.versions()));"
        "assert not {'mpi4py.MPI', 'petsc4py.PETSc', 'dolfinx'} & sys.modules.keys()"
    )
    return dict(json.loads(support.python("-c", code, **environ).stdout))


def test_identity_includes_the_kernel_of_the_blas() -> None:
    """Every processor of this kind has the kernel of Nehalem. Nothing else depends on it."""
    usual = parts_in_process()
    if "OpenBLAS" not in usual["blas"] or sys.platform != "linux":
        pytest.skip("another BLAS")
    old = parts_in_process(OPENBLAS_CORETYPE="Nehalem")
    assert "Nehalem" in old["blas"].split()
    assert old | {"blas": ""} == usual | {"blas": ""}


def test_identity_includes_sources_that_change_numbers() -> None:
    """Sources that only plan runs or report them are left out."""
    assert not identity.WITHOUT_INFLUENCE.fullmatch("app/numerics/newton.py")
    assert not identity.WITHOUT_INFLUENCE.fullmatch("app/system/identity.py")
    assert identity.WITHOUT_INFLUENCE.fullmatch("app/verification/problems/test_heat.py")
