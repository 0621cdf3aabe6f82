"""The launcher on a machine with other users: what it runs from, and what it leaves for them."""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from tests.command_line.test_launcher import EMPTY_TREE, MANTLE, ROOT, as_root, run

# As mmdebstrap keeps the options of apt and the archives.
KEEPING = """
for word; do case $word in --aptopt=*) OPTIONS=${word#*=} ;; esac; done
mkdir -p "$TARGET/etc/apt/apt.conf.d"
cp "$OPTIONS" "$TARGET/etc/apt/apt.conf.d/99mmdebstrap"
echo "deb http://me:secret@archive/debian trixie main" >"$TARGET/etc/apt/sources.list"
"""
APT = """#!/bin/sh
[ "$1" = dump ] && echo 'Acquire::http::Proxy "http://me:secret@proxy:3128/";'
"""


def set_up(folder: Path, *arguments: str, tool: str = EMPTY_TREE) -> subprocess.CompletedProcess:
    """Set up a tree that a stand-in for mmdebstrap makes, which notes that it was asked."""
    programs = folder / "bin"
    programs.mkdir(exist_ok=True)
    head = "for word; do case $word in *.part) TARGET=$word ;; esac; done\n"
    for name, text in (
        ("mmdebstrap", f"#!/bin/sh\n{head}echo run >>{folder}/log\n{tool}"),
        ("apt-config", APT),
    ):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    path = f"{programs}:{os.environ['PATH']}"
    more = {"PATH": path, "MANTLE_BACKEND": "tree", "MANTLE_INSIDE": ""}
    return run("setup", *arguments, XDG_CACHE_HOME=str(folder / "cache"), **more)


def set_ups(folder: Path) -> int:
    return (folder / "log").read_text().count("run")


def tree(folder: Path) -> Path:
    (found,) = (folder / "cache" / "mantle").glob("tree-*")
    return found


@as_root
def test_a_umask_that_lets_a_group_write_makes_a_tree_that_is_used(tmp_path: Path) -> None:
    before = os.umask(0o002)
    try:
        for _ in range(2):
            result = set_up(tmp_path)
            assert "not used" not in result.stderr
    finally:
        os.umask(before)
    assert set_ups(tmp_path) == 1


@as_root
def test_no_password_stays_in_a_tree(tmp_path: Path) -> None:
    result = set_up(tmp_path, tool=EMPTY_TREE + KEEPING)
    assert result.returncode == 69 or "ready" in result.stderr, result.stderr
    options = (tree(tmp_path) / "etc/apt/apt.conf.d/99mmdebstrap").read_text()
    assert "Install-Recommends" in options and "Proxy" not in options
    sources = (tree(tmp_path) / "etc/apt/sources.list").read_text()
    assert sources == "deb http://archive/debian trixie main\n"
    for path in (tmp_path / "cache").rglob("*"):
        assert not path.is_file() or "secret" not in path.read_text(), path


@as_root
def test_a_tree_is_made_again_if_it_is_older_than_asked(tmp_path: Path) -> None:
    set_up(tmp_path, tool=EMPTY_TREE + 'touch "$TARGET/first"\n')
    set_up(tmp_path, "--update", "2001-01-01")
    assert set_ups(tmp_path) == 1 and (tree(tmp_path) / "first").exists()
    os.utime(tree(tmp_path) / "etc/mantle-tree", (1e9, 1e9))
    set_up(tmp_path, "--update", "yesterday")
    assert set_ups(tmp_path) == 2 and not (tree(tmp_path) / "first").exists()


@pytest.mark.parametrize("words", [["--update", "someday"], ["--upgrade"]])
def test_other_options_of_setup_are_refused(words: list[str]) -> None:
    result = run("setup", *words)
    assert result.returncode == 2 and "--update" in result.stderr


def test_the_linter_is_the_one_with_these_digests() -> None:
    """In a form that pip believes nothing else of."""
    (named,) = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]["lint"]
    text = (ROOT / "tests" / "ruff.txt").read_text()
    assert re.findall(r"^ruff\S*", text, re.MULTILINE) == [named]
    assert len(re.findall(r"--hash=sha256:[0-9a-f]{64}\b", text)) >= 2
    assert "--require-hashes" in MANTLE.read_text()
