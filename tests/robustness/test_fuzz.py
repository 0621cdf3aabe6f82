"""Mutated case, sweep, study and mesh files: read or refused within limits of time and memory."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests import support

pytestmark = pytest.mark.slow


def fuzz(module: str, seed: str, first: int, last: int, folder: Path) -> None:
    done = support.python(
        *("-W", "error::SyntaxWarning", "-m", f"tests.robustness.{module}"),
        *(seed, str(first), str(last), folder),
        timeout=3600.0,
        XDG_CACHE_HOME=str(folder / "cache"),
    )
    *failures, last_line = (json.loads(line) for line in done.stdout.splitlines())
    assert not failures, json.dumps(failures[:3], indent=1)
    assert last_line == {"tried": last - first}


@pytest.mark.parametrize("part", range(6))
def test_fuzz_many_case_files(part: int, tmp_path: Path) -> None:
    fuzz("fuzz", "all", 1000 * part, 1000 * (part + 1), tmp_path)


def test_fuzz_many_mesh_files(tmp_path: Path) -> None:
    """Files 5 and 626 crash gmsh 4.13."""
    fuzz("fuzz_meshes", "all", 0, 2000, tmp_path)
