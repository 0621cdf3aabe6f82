"""A run goes on with another number of ranks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.results.reading import Run
from app.system.folders import saved
from tests import restarted, support

STEPS = ("--set", "output.checkpoint.steps=1")


@pytest.mark.parallel
@pytest.mark.parametrize(("first", "then"), [(1, 2), pytest.param(2, 1, marks=pytest.mark.slow)])
def test_another_number_of_ranks(tmp_path: Path, first: int, then: int) -> None:
    case = tmp_path / "case.yaml"
    case.write_text(restarted.RUBBING)
    command = ("-m", "mantle", "run", case)
    support.on_ranks(1, *command, "-o", tmp_path / "whole")
    out = tmp_path / "out"
    support.on_ranks(first, *command, "-o", out, *STEPS)
    # As if it had been killed in the last step.
    saved(out)[0].unlink()
    for name in ("DONE", "summary.json", "history.csv"):
        (out / name).unlink()
    support.on_ranks(then, *command, "-o", out, "--restart", "auto")
    restarted.assert_same(tmp_path / "whole", out, 1e-6, 1e-9)
    one, other = Run(tmp_path / "whole"), Run(out)
    assert list(one.times) == list(other.times)
    for k in range(len(one.times)):
        # Nodes between the parts of ranks are there more than once, in another order.
        norms = [np.abs(r.displacement(k)).max() for r in (one, other)]
        assert norms[0] == pytest.approx(norms[1], rel=1e-6)
        mean = [np.average(r.stress(k)[:, 2, 2], weights=r.volumes()) for r in (one, other)]
        assert mean[0] == pytest.approx(mean[1], rel=1e-6)


@pytest.mark.parallel
def test_the_same_number_of_ranks(tmp_path: Path) -> None:
    """The mesh is parted as before."""
    case = tmp_path / "case.yaml"
    case.write_text(restarted.RUBBING)
    options = ("--set", "mesh.size=1.2 mm", "--set", "output.fields=false")
    command = ("-m", "mantle", "run", case, *options)
    support.on_ranks(2, *command, "-o", tmp_path / "whole")
    out = tmp_path / "out"
    support.on_ranks(2, *command, "-o", out, *STEPS)
    saved(out)[0].unlink()
    for name in ("DONE", "summary.json", "history.csv"):
        (out / name).unlink()
    support.on_ranks(2, *command, "-o", out, "--restart", "auto")
    restarted.assert_same(tmp_path / "whole", out)
