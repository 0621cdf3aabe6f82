"""The errors that a run states, beside what finer meshes and meshes of other nodes give."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from app.case.quantities import TABLE
from tests import support

COARSE = ("--set", "stages.0.increments=1", "--set", "output.fields=false")


def stance(folder: Path, size: float, error: bool) -> dict[str, Any]:
    """The summary of the stance on a mesh of a size [mm]."""
    output = folder / f"{size:g}"
    sizes = ("--set", f"mesh.size={size:g} mm", "--set", f"output.error={str(error).lower()}")
    case = support.CONFIGS / "stance.yaml"
    support.on_ranks(1, "-m", "mantle", "run", case, "-o", output, *COARSE, *sizes)
    return dict(json.loads((output / "summary.json").read_text()))


@pytest.mark.slow
def test_most_headline_numbers_move_less_than_their_stated_error(tmp_path: Path) -> None:
    """Nodes move by up to 1 %: that changes less than the mesh is said to be wrong by."""
    stated = stance(tmp_path, 6.0, error=True)
    others = [stance(tmp_path, size, error=False) for size in (5.94, 6.06)]
    headlines = [key for key, q in TABLE["interfaces"].items() if q.headline and q.order]
    within = []
    for name, numbers in stated["interfaces"].items():
        for key in headlines:
            values = [s["interfaces"][name][key] for s in others]
            moved = max(abs(value - numbers[key]) for value in values)
            within.append((moved <= numbers[f"{key}_error"], name, key, moved))
    assert len(within) == 10
    assert sum(ok for ok, *_ in within) >= 8, within


@pytest.mark.slow
def test_stated_errors_are_not_far_below_the_true_ones(tmp_path: Path) -> None:
    """Of the main numbers of a mesh with eight lines around, against one with sixteen.

    What the finer mesh still leaves wrong is not known here: the true errors are larger.
    """
    stated = stance(tmp_path, 6.0, error=True)
    finer = stance(tmp_path, 4.0, error=False)
    headlines = [key for key, q in TABLE["interfaces"].items() if q.headline and q.order]
    within = []
    for name, numbers in stated["interfaces"].items():
        for key in headlines:
            off = abs(finer["interfaces"][name][key] - numbers[key])
            within.append((numbers[f"{key}_error"] >= 0.5 * off, name, key, off))
    assert len(within) == 10
    assert sum(ok for ok, *_ in within) >= 8, within
