"""The problems of the suites: their names, cases and runs; experiments that are not reproduced.

Their answers are tested by `app/verification/problems`.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from app.case.case import PlannedRun, load
from app.verification import suite
from app.verification.problem import within
from tests.support import CONFIGS


def test_problems_of_verify_are_well_posed() -> None:
    """Unique short names; cases that exist and say how to run them; sizes that fall."""
    everything = suite.planned("verify", "long")
    names = [planned.row.name for planned in everything]
    assert len(set(names)) == len(names) == 160
    assert max(map(len, names)) <= 26
    for planned in (*everything, *suite.planned("verify")):
        row = planned.row
        assert row.tolerance is not None
        assert row.quantity
        assert row.source
        assert row.refusal is None
        assert planned.runs or row.name == "klarbring"
        for run in planned.runs:
            assert f"run configs/{run.case}" in (CONFIGS / run.case).read_text("utf-8")
            load(CONFIGS / run.case, run.overrides)
        if row.order is not None:
            sizes = list(row.sizes)
            assert sizes == sorted(sizes, reverse=True)
            assert len(set(sizes)) == len(sizes) == len(planned.runs) >= 3
    cases = {run.case for planned in everything for run in planned.runs}
    assert cases == {f"verification/{p.name}" for p in CONFIGS.glob("verification/*.yaml")}


def test_problems_of_stress_are_well_posed(tmp_path: Path) -> None:
    """Names are unique, cases resolve, each subject has its share."""
    everything = suite.planned("stress", "long")
    small = [planned for planned in everything if within(planned.row.tier, "default")]
    groups = Counter(planned.row.group for planned in small)
    assert {"augmentation", "penalty", "modulus", "poisson", "friction", "thin mantle"} < set(
        groups
    )
    assert {"loads", "units", "floating", "taper", "cycles", "increments"} < set(groups)
    assert {"symmetry", "bad cells", "heat", "layer", "creep", "cohesion"} < set(groups)
    assert len(small) == 257
    assert len(everything) == 579
    assert len({planned.row.name for planned in everything}) == len(everything)
    chosen = {p.row.name for p in small if p.row.name.startswith("augmentation_E_50:1_mu_0.4")}
    assert {name.split("_")[-1] for name in chosen} == {f"{10.0**k:.2g}" for k in range(-4, 5) if k}
    for planned in everything:
        row = planned.row
        assert re.fullmatch(r"[^\s/]+", row.name)
        assert row.source
        assert (row.tolerance is not None and row.tolerance > 0) or row.refusal
        assert all((CONFIGS / run.case).is_file() for run in planned.runs)
    for name in ("stem", "taper"):
        text = (CONFIGS / "stress" / f"{name}.yaml").read_text(encoding="utf-8")
        assert f"run configs/stress/{name}.yaml" in text
    # Every override is one: what is refused at once is meant to be.
    some = [planned for planned in small if not any(run.mesh for run in planned.runs)]
    suite.plan(some, tmp_path, timed=False)
    refused = [p.row for p in some if not all(isinstance(r, PlannedRun) for r in p.planned)]
    assert len(some) > 150
    assert len(refused) == 3
    assert all(row.group == "floating" and row.tolerance is None for row in refused)
