"""YAML files: version 1.2, byte order marks, Windows line ends."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.case.case import load_case
from app.schema import yaml_file
from tests import support

# Texts that would be numbers, truth values, dates or null without quotes, in YAML 1.1 or 1.2.
LOOK_LIKE_OTHERS = (
    *("1e3", "1e-3", ".5", "1.", "+1", "1.5e3", "0o17", "012", "09", "0x1F", "1_000", "1:30"),
    *("yes", "no", "on", "off", "y", "n", "True", "null", "~", "=", "<<", ".inf", ".nan"),
    *("2001-01-01", "", "-", "a: b", "x #y", "*a", "1,000", "a\nb", " a", "\x85"),
)


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


@pytest.mark.parametrize("text", LOOK_LIKE_OTHERS)
@pytest.mark.parametrize("short", [True, False])
def test_yaml_file_texts_read_back_as_texts(text: str, short: bool, tmp_path: Path) -> None:
    data: dict[str, object] = {"key": text, "list": [text, {"inner": text}], f"{text}k": 1}
    path = tmp_path / "case.yaml"
    path.write_text(yaml_file.to_yaml(data, short=short), encoding="utf-8")
    assert yaml_file.read(path).data == data
