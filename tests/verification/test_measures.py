"""Measures that problems share: a right run passes, another answer fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.results.reading import Run
from app.verification import measures
from tests import support
from tests.support import CONFIGS


def test_measures_detect_wrong_results(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    twice = "loads.press.pressure: 4 MPa"
    slack = "interfaces.cement_metal.gap: 0.001 mm"
    text = (CONFIGS / "blocks.yaml").read_text(encoding="utf-8").replace("size: 2 mm", "size: 4 mm")
    path.write_text(f"{text}\nvariations: {{one: {{}}, twice: {{{twice}}}, slack: {{{slack}}}}}\n")
    support.on_ranks(1, "-m", "mantle", "run", path, "-o", tmp_path / "out")
    first, second, third = (Run(tmp_path / "out" / name) for name in ("one", "twice", "slack"))
    assert measures.difference_between(first, first).error == 0
    assert measures.difference_between(second, first, lengths=2, stresses=2).error < 1e-9
    assert measures.difference_between(second, first).error == pytest.approx(1, rel=1e-6)
    assert measures.difference_between(third, first).error > 1e-2
    with pytest.raises(ValueError, match="not the same"):
        measures.difference_between(first, first, points=2)
    assert measures.law_violation(first).error < 1e-9
