"""Full disks, damaged caches, no compiler, two runs in one folder: told, and the next run works."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import meshes
from app.case.case import load
from app.system import folders
from tests.robustness.faulty import CASE, DAMAGES, HERE, OPTIONS, damage, mounts, run, slow
from tests.support import environment


@pytest.mark.parametrize("how", DAMAGES)
def test_a_damaged_mesh_is_made_again(how: str, tmp_path: Path) -> None:
    case = load(CASE, ["mesh.size=5 mm", "mesh.far_size=5 mm"]).config
    first = meshes.build(case.geometry, case.mesh, tmp_path)
    (path,) = tmp_path.glob("*.npz")
    good = path.read_bytes()
    damage(path, how)
    second = meshes.build(case.geometry, case.mesh, tmp_path)
    assert np.array_equal(first.points, second.points)
    assert path.stat().st_size == len(good)
    assert not list(tmp_path.glob("*.part"))


def test_a_mesh_that_cannot_be_kept_is_a_mesh(caplog: pytest.LogCaptureFixture) -> None:
    case = load(CASE, ["mesh.size=5 mm", "mesh.far_size=5 mm"]).config
    assert len(meshes.build(case.geometry, case.mesh, Path("/proc/nowhere")).cells)
    assert "the mesh cannot be kept in /proc/nowhere" in caplog.text


@pytest.mark.parametrize("kept", ['{"mm in mm": ["garbage"]}', "[]", "\0", '{"mm in mm": 1}'])
def test_damaged_conversions_are_made_again(kept: str, tmp_path: Path) -> None:
    (tmp_path / "mantle" / "units").mkdir(parents=True)
    (tmp_path / "mantle" / "units" / "conversions.json").write_text(kept)
    script = "from app.schema.unit_conversion import conversion; print(*conversion('mm', 'mm'))"
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=environment() | {"XDG_CACHE_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert (done.stdout, done.stderr) == ("1 0\n", "")


def test_a_folder_belongs_to_one_run(tmp_path: Path) -> None:
    held = folders.claim(tmp_path)
    done = run(tmp_path, environment()["PYTHONPATH"], None)
    assert done.returncode == 2
    assert f"-o {tmp_path}: another run is writing into it" in done.stderr
    assert not list(tmp_path.iterdir())
    os.close(held)
    os.close(folders.claim(tmp_path))


# -------------------------------------------------------------------------------- whole runs


@slow
@pytest.mark.parametrize("how", DAMAGES)
def test_damaged_forms_are_compiled_again(how: str, warmed: Path, tmp_path: Path) -> None:
    shutil.copytree(warmed, tmp_path / "cache")
    modules = list((tmp_path / "cache" / "fenics").glob("*.so"))
    assert modules
    for path in modules:
        damage(path, how)
    done = run(tmp_path / "out", HERE, tmp_path / "cache")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "DONE").exists()


@slow
@pytest.mark.parametrize("ranks", [1, 2])
def test_no_compiler_is_told(ranks: int, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mantle", "run", str(CASE), "-o", str(tmp_path / "out")]
    more = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "CC": "/nowhere/cc"}
    done = subprocess.run(
        [*command, *OPTIONS, "-n", str(ranks)],
        env=environment() | more,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 69, done.stderr
    assert done.stderr.count("a form cannot be compiled: ") == 1
    assert "/nowhere/cc" in done.stderr
    assert "mantle doctor tells whether there is a C compiler" in done.stderr
    assert "Traceback" not in done.stderr
    assert run(tmp_path / "out", HERE, tmp_path / "cache").returncode == 0  # with one


@slow
def test_a_cache_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    done = run(tmp_path / "out", HERE, "/proc/nowhere")
    assert done.returncode == 0, done.stderr
    own = f"/tmp/mantle-{os.geteuid()}"
    assert f"caches are in {own} now: /proc/nowhere" in done.stderr


@slow
@mounts
def test_a_full_cache_is_told(tmp_path: Path) -> None:
    (tmp_path / "cache").mkdir()
    mount = f"mount -t tmpfs -o size=64k none {tmp_path}/cache"
    done = run(tmp_path / "out", HERE, tmp_path / "cache", mount)
    assert done.returncode == 69, done.stderr
    assert "a form cannot be compiled: " in done.stderr
    assert "with 0 MB free" in done.stderr


@slow
@mounts
def test_a_full_disk_stops_the_run(warmed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    done = run(out, HERE, warmed, f"mount -t tmpfs -o size=64k none {out}")
    assert done.returncode == 5, done.stderr
    assert "cannot write" in done.stderr
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr
    again = run(out, HERE, warmed)
    assert again.returncode == 0, again.stderr


@slow
@mounts
def test_an_output_folder_on_a_read_only_disk_is_refused(warmed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    done = run(out, HERE, warmed, f"mount -t tmpfs -o ro none {out}")
    assert done.returncode == 2
    assert f"-o {out}: is not writable" in done.stderr
