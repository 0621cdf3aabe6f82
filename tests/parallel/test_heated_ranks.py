"""The mechanics of heat and cure on 1 and 3 ranks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests import support

CASE = Path(__file__).with_name("heated_case.py")


def run(ranks: int, folder: Path) -> dict[str, Any]:
    output = folder / f"{ranks}.json"
    support.on_ranks(ranks, CASE, output)
    return dict(json.loads(output.read_text()))


@pytest.mark.parallel
def test_setting_and_release_do_not_depend_on_the_number_of_ranks(tmp_path: Path) -> None:
    one = run(1, tmp_path)
    assert max(one["balance"]) < 1e-8
    assert 0.02 < one["interface"]["slip_fraction"]
    for ranks in (3,):
        other = run(ranks, tmp_path)
        assert max(other["balance"]) < 1e-8
        assert other["thermal"] == pytest.approx(one["thermal"])
        largest = one["cement"]["von_mises_max"]
        for key in ("von_mises_max", "von_mises_p99", "principal_max", "principal_min"):
            assert abs(other["cement"][key] - one["cement"][key]) < 1e-6 * largest, key
        for key in ("gap_max", "slip_max", "pressure_mean", "shear_mean", "open_fraction"):
            assert other["interface"][key] == pytest.approx(one["interface"][key], rel=1e-6), key
        assert other["bond"].keys() == {"cement_bone"}
        for key, value in one["bond"]["cement_bone"].items():
            assert other["bond"]["cement_bone"][key] == pytest.approx(value, rel=1e-6), key
