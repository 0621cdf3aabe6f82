"""A start from a cheaper model that is spread over ranks in another way than the fine one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests import support


@pytest.mark.parallel
@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_nested_start_on_ranks(ranks: int, tmp_path: Path) -> None:
    """The same jumps as without, from a start that is closer to equilibrium."""
    output = tmp_path / "numbers.json"
    support.on_ranks(ranks, "-m", "tests.parallel.nested_case", output)
    numbers = json.loads(output.read_text())
    assert numbers["difference"] < 1e-6
    assert numbers["start"] < 0.3
