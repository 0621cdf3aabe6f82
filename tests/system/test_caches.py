"""Caches and files: of their user alone, whole or not there."""

from __future__ import annotations

import os
import stat
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

from app.cli import main
from app.foundation import files
from app.numerics import pointwise
from app.system import folders, form_cache
from tests import support

FORM = "libffcx_forms_" + "0" * 40


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("MPLCONFIGDIR", str(tmp_path / "matplotlib"))
    return tmp_path / "cache"


def write_form(folder: Path, mark: str = "") -> Path:
    """A module as a compiler leaves it."""
    module = folder / f"{FORM}{EXTENSION_SUFFIXES[0]}"
    folder.mkdir(parents=True, exist_ok=True)
    for path, text in ((module, "code"), (module.parent / f"{FORM}.c", "source")):
        path.write_text(text)
    (folder / f"{FORM}.c.cached").write_text(mark)
    return module


def test_caches_are_private_to_their_user(home: Path) -> None:
    """Whatever the umask, and also where they were there before."""
    (home / "mantle" / "meshes").mkdir(parents=True, mode=0o777)
    before = os.umask(0)
    try:
        assert not folders.settle_cache()
        meshes = folders.cache("meshes")
    finally:
        os.umask(before)
    assert meshes is not None
    for folder in (meshes, home / "fenics"):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_caches_fallback_is_reported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")
    assert main(["explain", "mesh.size"]) == 0
    fallback = f"/tmp/mantle-{os.geteuid()}"
    assert capsys.readouterr().err.startswith(
        f"mantle: caches are in {fallback} now: /proc/nowhere"
    )
    assert os.environ["XDG_CACHE_HOME"] == fallback
    assert stat.S_IMODE(Path(fallback).stat().st_mode) == 0o700


def test_caches_may_be_missing(home: Path) -> None:
    home.touch()
    assert folders.cache("meshes") is None


def test_caches_copy_forms_of_an_image(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a cache that is new, and for no other."""
    monkeypatch.setattr(folders, "SEED", home.parent / "seed")
    write_form(folders.SEED / "fenics")
    assert not folders.settle_cache() and form_cache.usable(home / "fenics", FORM)
    (home / "fenics" / f"{FORM}.c").unlink()
    assert not folders.settle_cache() and not form_cache.usable(home / "fenics", FORM)


@pytest.mark.parametrize("damage", ["none", "cut", "no mark", "no source", "no module"])
def test_form_cache_incomplete_modules_are_compiled_again(damage: str, tmp_path: Path) -> None:
    module = write_form(tmp_path, "4")
    source, mark = tmp_path / f"{FORM}.c", tmp_path / f"{FORM}.c.cached"
    match damage:
        case "cut":
            module.write_text("cod")
        case "no mark" | "no source" | "no module":
            {"mark": mark, "source": source, "module": module}[damage.split()[1]].unlink()
    existed: list[bool] = []
    form_cache._compile(
        lambda: form_cache._find(lambda *_: existed.append(source.exists()), FORM, [], tmp_path, 10)
    )
    assert existed == [damage == "none"] and not form_cache._compiling


@pytest.mark.parametrize(
    "change",
    [
        {"module": "../../tmp/evil"},
        {"module": "/tmp/libffcx_expressions_0"},
        {"symbol": "system"},
        {"shapes": 3},
    ],
)
def test_form_cache_note_names_a_module(home: Path, change: dict[str, object]) -> None:
    folder = folders.cache("laws")
    assert folder is not None
    note = folder / "law-0.json"
    right = {"module": f"libffcx_expressions_{'0' * 40}", "symbol": f"expression_{'0' * 40}"}
    folders.write_json(note, right | {"inputs": [], "shapes": []} | change)
    assert pointwise.load_noted(support.MPI.COMM_SELF, note) is None


def test_files_unfinished_have_random_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    victim, path = tmp_path / "victim", tmp_path / "summary.json"
    victim.write_text("mine")
    monkeypatch.setattr("secrets.token_hex", lambda n: "known")
    (tmp_path / f"{path.name}.known.partial").symlink_to(victim)
    with pytest.raises(FileExistsError):
        files.write_bytes(path, b"newer")
    assert victim.read_text() == "mine" and not path.exists()
