"""YAML files: version 1.2, byte order marks, Windows line ends."""

from __future__ import annotations

from pathlib import Path

from app.case.case import load_case
from tests import support


def test_yaml_file_is_of_version_1_2(two_blocks: str) -> None:
    """``no`` is a word, ``1e-3`` is a number, and a date is a text."""
    case = support.case(two_blocks + "title: no\nsolver: {tolerance: 1e-3}\n")
    assert case.title == "no"
    assert case.solver.tolerance == 1e-3
    assert support.case(two_blocks + "title: 2024-01-01\n").title == "2024-01-01"


def test_yaml_file_with_byte_order_mark_and_windows_lines(tmp_path: Path, two_blocks: str) -> None:
    path = tmp_path / "case.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + two_blocks.replace("\n", "\r\n").encode())
    assert load_case(path).config == support.case(two_blocks)
