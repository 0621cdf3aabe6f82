"""Heat and contact that depend on each other on 1 and 3 ranks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests import coupled, support


def run(ranks: int, folder: Path, *overrides: str) -> dict[str, Any]:
    """Summary of the case on a number of ranks."""
    case, output = folder / "case.yaml", folder / f"{ranks}"
    case.write_text("title: Ranks\n" + coupled.CASE, encoding="utf-8")
    sets = [text for override in overrides for text in ("--set", override)]
    support.on_ranks(ranks, "-m", "mantle", "run", case, "-o", output, *sets)
    return dict(json.loads((output / "summary.json").read_text()))


def flat(values: Any, name: str = "") -> dict[str, float]:
    """The numbers of a nested table; places and times of maxima, which jump, apart."""
    if isinstance(values, dict):
        parts = [flat(v, f"{name}.{key}") for key, v in values.items()]
        return {key: v for part in parts for key, v in part.items()}
    if name.endswith(("_at", "_time")) or not isinstance(values, int | float):
        return {}
    return {name: float(values)}


@pytest.mark.parallel
@pytest.mark.parametrize(
    "overrides",
    [
        ["stages[1].increments=2"],
        [
            "interfaces.lower_upper={kind: contact, friction_coefficient: 0.3, "
            "friction_heating: 0.3}"
        ],
    ],
    ids=["conductance", "perfect"],
)
def test_coupled_results_do_not_depend_on_the_number_of_ranks(
    tmp_path: Path, overrides: list[str]
) -> None:
    overrides = [*overrides, "solver.tolerance=1e-12"]
    one = run(1, tmp_path, *overrides)
    contact = one["interfaces"]["lower_upper"]
    assert contact["open_fraction"] > 0.1 and contact["slip_fraction"] > 0.1
    assert one["thermal"]["interfaces"]["lower_upper"]["temperature_max_first"] > 45
    assert contact["dissipation"] > 0.05
    assert max(one["balance"][k] for k in ("force", "moment", "energy", "heat")) < 1e-9
    for ranks in (3,):
        other = run(ranks, tmp_path, *overrides)
        assert other["solver"]["ranks"] == ranks
        assert other["solver"]["dofs"] == one["solver"]["dofs"]
        for part in ("thermal", "interfaces", "regions"):
            expected = flat(one[part])
            # Penetration is nothing but rounding.
            assert flat(other[part]) == pytest.approx(expected, rel=1e-7, abs=1e-12), (ranks, part)
