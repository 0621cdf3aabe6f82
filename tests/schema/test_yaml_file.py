"""YAML files: version 1.2, byte order marks, lines of Windows."""

from __future__ import annotations

from pathlib import Path

from app.case.case import load
from tests import support

MINIMAL = """\
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: "[10, 20, 5] mm"}
    - {name: upper, size: [1 cm, 0.02 m, 5000 um]}
mesh: {order: 1, size: 2 mm}
regions:
  lower: {youngs_modulus: 2.2 GPa, poisson_ratio: 0.3}
  upper: {rigid: true}
supports:
  base: {kind: fixed, boundary: bottom}
"""


def test_yaml_file_is_of_version_1_2() -> None:
    """``no`` is a word, ``1e-3`` a number, and a date text."""
    case = support.case(MINIMAL + "title: no\nsolver: {tolerance: 1e-3}\n")
    assert case.title == "no"
    assert case.solver.tolerance == 1e-3
    assert support.case(MINIMAL + "title: 2024-01-01\n").title == "2024-01-01"


def test_yaml_file_with_byte_order_mark_and_windows_lines(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + MINIMAL.replace("\n", "\r\n").encode())
    assert load(path).config == support.case(MINIMAL)
