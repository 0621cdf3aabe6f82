"""A run that is interrupted after any step and goes on ends with the same numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

from app import config
from app.results import Run
from app.run import run
from tests import coupled, restarted

NUMBERS = 1e-10
FIELDS = "output.fields=false"


def test_friction(tmp_path: Path) -> None:
    case, files = restarted.whole(restarted.RUBBING, tmp_path, FIELDS)
    assert len(files) == 6
    for file in files:
        part = restarted.on(case, tmp_path, file, FIELDS)
        restarted.assert_same(tmp_path / "whole", part, NUMBERS, 1e-12)
        assert restarted.rows(part) == restarted.rows(tmp_path / "whole")


def test_cure_and_what_it_leaves(tmp_path: Path) -> None:
    case, files = restarted.whole(restarted.SETTING, tmp_path, FIELDS)
    # Within setting, and where the holder lets go.
    for file in (files[len(files) // 2], files[-3]):
        restarted.assert_same(
            tmp_path / "whole", restarted.on(case, tmp_path, file, FIELDS), NUMBERS
        )


@pytest.mark.slow
@pytest.mark.parametrize("coupling", ["monolithic", "staggered"])
@pytest.mark.parametrize("adaptive", [True, False])
def test_heat_and_contact_that_depend_on_each_other(
    tmp_path: Path, coupling: str, adaptive: bool
) -> None:
    options = (FIELDS, f"solver.coupling={coupling}", f"stages.1.adaptive={adaptive}".lower())
    case, files = restarted.whole(coupled.CASE, tmp_path, *options)
    for file in files:
        part = restarted.on(case, tmp_path, file, *options)
        restarted.assert_same(tmp_path / "whole", part, NUMBERS)


@pytest.mark.slow
def test_cure_after_every_step(tmp_path: Path) -> None:
    case, files = restarted.whole(restarted.SETTING, tmp_path, FIELDS)
    for file in files:
        part = restarted.on(case, tmp_path, file, FIELDS)
        restarted.assert_same(tmp_path / "whole", part, NUMBERS)


def test_fields_go_on_in_their_file(tmp_path: Path) -> None:
    case, files = restarted.whole(restarted.RUBBING, tmp_path)
    whole = Run(tmp_path / "whole")
    before = [whole.displacement(k) for k in range(len(whole.times))]
    # In another folder they begin at the checkpoint: the last step is there in any case.
    for file, left in ((files[3], 2), (files[-1], 1)):
        part = Run(restarted.on(case, tmp_path, file))
        assert list(part.times) == list(whole.times[-left:])
        assert (part.displacement() == before[-1]).all()
    # Whatever was written after the checkpoint is written again.
    run(config.load(case), case, tmp_path / "whole", [], [], restart=str(files[2]))
    again = Run(tmp_path / "whole")
    assert list(again.times) == list(whole.times)
    for k, u in enumerate(before):
        assert (again.displacement(k) == u).all()
