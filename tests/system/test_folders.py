"""Folders of caches: private, missing, copied from an image."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from app.cli import main
from app.system import folders, form_cache
from tests.system.caches import FORM, write_form


def test_folders_of_caches_are_private_to_their_user(home: Path) -> None:
    """Folders are private for any umask, and existing folders become private."""
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


def test_folders_of_caches_fallback_is_reported(
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


def test_folders_of_caches_may_be_missing(home: Path) -> None:
    home.touch()
    assert folders.cache("meshes") is None


def test_folders_of_caches_copy_forms_of_an_image(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forms are copied to a new cache, and to no other."""
    monkeypatch.setattr(folders, "SEED", home.parent / "seed")
    write_form(folders.SEED / "fenics")
    assert not folders.settle_cache() and form_cache.usable(home / "fenics", FORM)
    (home / "fenics" / f"{FORM}.c").unlink()
    assert not folders.settle_cache() and not form_cache.usable(home / "fenics", FORM)
