"""Two users and one machine: what another could have written is neither run nor believed."""

from __future__ import annotations

import ctypes
import logging
import os
import shutil
import stat
from collections.abc import Iterator
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import numpy as np
import pytest

import meshes
from app import files
from app.cli import main
from app.errors import EnvironmentProblem
from app.numerics import kernel_cache
from app.schema import unit_conversion
from app.system import folders, form_cache
from tests import support

NOBODY = 65534
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root makes files of others")
CASE = support.case(
    "geometry: {kind: blocks, blocks: [{name: a, size: [2 mm, 2 mm, 2 mm]}]}\n"
    "mesh: {size: 2 mm}\n"
    "regions: {a: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}}\n"
    "supports: {s: {kind: fixed, boundary: bottom}}\n"
)


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A cache of this test."""
    home = tmp_path / "cache"
    home.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_CACHE_HOME", str(home))
    monkeypatch.setenv("MPLCONFIGDIR", "")
    monkeypatch.delenv("MPLCONFIGDIR")
    unit_conversion._kept.cache_clear()
    unit_conversion.conversion.cache_clear()
    yield home
    unit_conversion._kept.cache_clear()
    unit_conversion.conversion.cache_clear()


def forge(path: Path, how: str) -> None:
    """Make a file look as if another user had a hand in it."""
    match how:
        case "owner":
            os.chown(path, NOBODY, -1)
        case "group":
            path.chmod(0o664)
        case "world":
            path.chmod(0o646)
        case "link":
            other = path.with_name("other")
            path.rename(other)
            path.symlink_to(other)


FORGED = [pytest.param("owner", marks=as_root), "group", "world", "link"]


# ----------------------------------------------------------------------------------- folders


@as_root
@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("how", ["owner", "group", "world"])
def test_a_folder_of_somebody_else_is_no_cache(
    home: Path, level: int, how: str, caplog: pytest.LogCaptureFixture
) -> None:
    folder = folders.cache("meshes")
    assert folder is not None and stat.S_IMODE(folder.stat().st_mode) == 0o700
    forge([folder, *folder.parents][level], how)
    for _ in range(2):
        assert folders.cache("meshes") is None
    (told,) = caplog.messages
    assert told.startswith(f"{folder} is not used: {[folder, *folder.parents][level]} ")


def test_a_group_may_be_let_write_by_the_umask(home: Path) -> None:
    """Results are its, as the user wants; caches are not."""
    before = os.umask(0o002)
    try:
        folder = folders.cache("meshes")
        assert folder is not None and files.fault_of_folder(folder) == ""
        built(folder)
        assert not [p for p in folder.iterdir() if files.fault_of(p.stat())]
        files.write_bytes(home / "result", b"")
        assert stat.S_IMODE((home / "result").stat().st_mode) == 0o664
    finally:
        os.umask(before)


@as_root
def test_a_sticky_folder_is_safe_above_unless_another_owns_it(tmp_path: Path) -> None:
    place, folder = tmp_path / "tmp", tmp_path / "tmp" / "own"
    folder.mkdir(parents=True, mode=0o700)
    place.chmod(0o1777)
    assert files.fault_of_folder(folder) == ""
    os.chown(place, NOBODY, -1)
    assert files.fault_of_folder(folder) == f"{place} is owned by nobody"
    os.chown(place, 0, -1)
    place.chmod(0o777)
    assert files.fault_of_folder(folder) == f"{place} can be written by others"


@as_root
def test_another_cache_is_taken_and_that_is_told(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (home / "fenics").mkdir()
    os.chown(home / "fenics", NOBODY, -1)
    assert main(["version"]) == 0
    said = capsys.readouterr().err
    own = Path(os.environ["XDG_CACHE_HOME"])
    assert said == (f"mantle: caches are in {own} now: {home}/fenics is owned by nobody\n")
    assert own == Path(f"/tmp/mantle-{os.geteuid()}")
    assert stat.S_IMODE(own.stat().st_mode) == 0o700
    assert main(["version"]) == 0 and not capsys.readouterr().err


# ------------------------------------------------------------------------------------- files


def built(folder: Path) -> np.ndarray:
    return meshes.build(CASE.geometry, CASE.mesh, folder).points


@pytest.mark.parametrize("how", FORGED)
def test_a_forged_mesh_is_remade(home: Path, how: str, caplog: pytest.LogCaptureFixture) -> None:
    folder = folders.cache("meshes")
    assert folder is not None
    right = built(folder)
    (path,) = folder.glob("*.npz")
    stored = dict(np.load(path))
    assert path.stat().st_mode & 0o777 == 0o600
    forge(path, how)
    assert (built(folder) == right).all()
    assert f"{path} is not used" in caplog.text or how == "link"
    assert not path.is_symlink() and not files.fault_of(path.stat())
    # What was changed by damage alone, or stands under another name, does not fit its digest.
    np.savez(path, **{**stored, "points": stored["points"] * 2})
    path.chmod(0o600)
    assert (built(folder) == right).all()
    other = meshes.build(CASE.geometry, CASE.mesh.model_copy(update={"size": 1.0}), folder)
    (second,) = set(folder.glob("*.npz")) - {path}
    shutil.copy(second, path)
    assert (built(folder) == right).all() and len(other.points) > len(right)


@pytest.mark.parametrize("how", FORGED)
def test_forged_code_is_not_loaded(home: Path, how: str) -> None:
    """Nor is a note believed that tells of another module."""
    name = "libffcx_forms_" + "0" * 40
    folder = home / "fenics"
    folder.mkdir(mode=0o700)
    module, mark = folder / f"{name}{EXTENSION_SUFFIXES[0]}", folder / f"{name}.c.cached"
    for path in (module, mark, folder / f"{name}.c"):
        path.touch(0o600)
    assert form_cache.usable(folder, name)
    forge(module, how)
    found: list[bool] = []
    form_cache._wait(lambda *_: found.append(module.exists()), name, [], folder, 10)
    assert found == [False] and not form_cache.usable(folder, name)
    while form_cache._compiling:
        os.close(form_cache._compiling.pop())


@as_root
def test_code_in_a_folder_of_others_is_refused(home: Path) -> None:
    folder = home / "fenics"
    folder.mkdir()
    os.chown(folder, NOBODY, -1)
    with pytest.raises(EnvironmentProblem, match=r"owned by nobody; remove it, or set XDG_CACHE"):
        form_cache.mend()


@pytest.mark.parametrize(
    "change",
    [
        {"module": "../../tmp/evil"},
        {"module": "/tmp/libffcx_expressions_0"},
        {"symbol": "system"},
        {"shapes": 3},
    ],
)
def test_a_note_names_a_module_of_the_cache(home: Path, change: dict[str, object]) -> None:
    folder = folders.cache("laws")
    assert folder is not None
    note = folder / "law-0.json"
    right = {"module": f"libffcx_expressions_{'0' * 40}", "symbol": f"expression_{'0' * 40}"}
    folders.write_sealed(note, right | {"inputs": [], "shapes": []} | change)
    assert kernel_cache.find(support.MPI.COMM_SELF, note) is None


@pytest.mark.parametrize("name", [form_cache.LOCK, form_cache.COMPILING])
def test_locks_do_not_follow_links(home: Path, tmp_path: Path, name: str) -> None:
    victim, folder = tmp_path / "victim", home / "fenics"
    victim.write_text("mine")
    victim.chmod(0o600)
    folder.mkdir(mode=0o700)
    (folder / name).symlink_to(victim)
    form_cache.mend()
    form_cache._wait(lambda *_: None, "libffcx_forms_0", [], folder, 10)
    while form_cache._compiling:
        os.close(form_cache._compiling.pop())
    assert victim.read_text() == "mine" and stat.S_IMODE(victim.stat().st_mode) == 0o600


def test_a_mesh_lock_does_not_follow_links(home: Path, tmp_path: Path) -> None:
    victim, folder = tmp_path / "victim", folders.cache("meshes")
    assert folder is not None
    victim.write_text("mine")
    built(folder)
    (path,) = folder.glob("*.lock")
    path.unlink()
    path.symlink_to(victim)
    built(folder)
    assert victim.read_text() == "mine"


def test_unfinished_files_have_no_name_that_can_be_guessed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    victim, path = tmp_path / "victim", tmp_path / "summary.json"
    victim.write_text("mine")
    (tmp_path / f"{path.name}.partial").symlink_to(victim)
    files.write_bytes(path, b"new")
    assert victim.read_text() == "mine" and path.read_text() == "new"
    monkeypatch.setattr("secrets.token_hex", lambda n: "known")
    (tmp_path / f"{path.name}.known.partial").symlink_to(victim)
    with pytest.raises(FileExistsError):
        files.write_bytes(path, b"newer")
    assert victim.read_text() == "mine" and path.read_text() == "new"


# ------------------------------------------------------------------------------------- seeds


def test_an_image_brings_forms_along(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seed, name = tmp_path / "seed", f"libffcx_forms_{'0' * 40}"
    (seed / "fenics").mkdir(parents=True)
    for suffix in (EXTENSION_SUFFIXES[0], ".c", ".c.cached"):
        (seed / "fenics" / (name + suffix)).write_text(suffix)
    monkeypatch.setattr(folders, "SEED", seed)
    module = seed / "fenics" / (name + EXTENSION_SUFFIXES[0])

    def taken() -> bool:
        form_cache._wait(lambda *_: None, name, [], home / "fenics", 10)
        while form_cache._compiling:
            os.close(form_cache._compiling.pop())
        found = form_cache.usable(home / "fenics", name)
        shutil.rmtree(home / "fenics")
        return found

    assert taken()
    module.chmod(0o666)  # as images had it until now
    assert not taken()
    module.chmod(0o644)
    (seed / "fenics").chmod(0o777)
    assert not taken()


def test_compiled_forms_are_of_their_user_alone(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the umask."""
    seen: list[int] = []
    before = os.umask(0o002)
    try:
        libc = ctypes.CDLL(None)
        form_cache._let_go(lambda: seen.append(libc.umask(0o077)))
        assert os.umask(0o002) == 0o002
    finally:
        os.umask(before)
    assert seen == [0o077]


def test_a_cache_without_owners_is_none(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "file"
    path.write_text("x")
    path.chmod(0o622)
    with caplog.at_level(logging.WARNING), pytest.raises(PermissionError):
        files.read_own(path)
    assert caplog.messages == [f"{path} is not used: it can be written by others"]
