"""The problems of the suites: their names, cases and runs.

Their answers are tested by `app/verification/problems`.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from app.case.case import PlannedRun, load_case
from app.verification import suite
from app.verification.problem import within
from tests.support import CONFIGS, ROOT


@pytest.fixture(scope="module")
def verify() -> list[suite.PlannedProblem]:
    """All problems of ``mantle verify``."""
    return suite.planned("verify", "long")


@pytest.fixture(scope="module")
def stress() -> list[suite.PlannedProblem]:
    """All cases of ``mantle stress``."""
    return suite.planned("stress", "long")


@pytest.fixture(scope="module")
def default_stress(stress: list[suite.PlannedProblem]) -> list[suite.PlannedProblem]:
    """Cases that ``mantle stress`` runs without options."""
    return [planned for planned in stress if within(planned.row.tier, "default")]


def test_problems_of_verify_have_unique_short_names(verify: list[suite.PlannedProblem]) -> None:
    names = [planned.row.name for planned in verify]
    assert len(set(names)) == len(names)
    assert max(map(len, names)) <= 26


def test_problems_of_verify_are_as_many_as_the_readme_says(
    verify: list[suite.PlannedProblem],
) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"`mantle verify` solves (\d+) problems", readme) == [str(len(verify))]


def test_problems_of_verify_have_tolerance_quantity_and_source(
    verify: list[suite.PlannedProblem],
) -> None:
    for planned in (*verify, *suite.planned("verify")):
        row = planned.row
        assert row.tolerance is not None
        assert row.quantity
        assert row.source
        assert row.refusal is None


def test_problems_of_verify_have_cases_that_load(verify: list[suite.PlannedProblem]) -> None:
    """Each case says how to run it. Only `klarbring` has no run."""
    for planned in (*verify, *suite.planned("verify")):
        assert planned.runs or planned.row.name == "klarbring"
        for run in planned.runs:
            assert f"run configs/{run.case}" in (CONFIGS / run.case).read_text("utf-8")
            load_case(CONFIGS / run.case, run.overrides)


def test_problems_of_verify_with_an_order_have_falling_sizes(
    verify: list[suite.PlannedProblem],
) -> None:
    """An order needs a run at each of three different sizes."""
    for planned in (*verify, *suite.planned("verify")):
        if planned.row.order is not None:
            sizes = list(planned.row.sizes)
            assert sizes == sorted(sizes, reverse=True)
            assert len(set(sizes)) == len(sizes)
            assert len(sizes) == len(planned.runs)
            assert len(sizes) >= 3


def test_problems_of_verify_use_every_case_of_the_folder(
    verify: list[suite.PlannedProblem],
) -> None:
    cases = {run.case for planned in verify for run in planned.runs}
    assert cases == {f"verification/{p.name}" for p in CONFIGS.glob("verification/*.yaml")}


def test_problems_of_stress_have_all_groups(default_stress: list[suite.PlannedProblem]) -> None:
    groups = Counter(planned.row.group for planned in default_stress)
    assert {"augmentation", "penalty", "modulus", "poisson", "friction", "thin mantle"} < set(
        groups
    )
    assert {"loads", "units", "floating", "taper", "cycles", "increments"} < set(groups)
    assert {"symmetry", "bad cells", "heat", "layer", "creep", "cohesion"} < set(groups)


def test_problems_of_stress_are_as_many_as_the_manual_says(
    stress: list[suite.PlannedProblem], default_stress: list[suite.PlannedProblem]
) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"`mantle stress` runs (\d+) ", readme) == [str(len(default_stress))]
    manual = (ROOT / "docs" / "verification.md").read_text(encoding="utf-8")
    assert re.findall(r"# (\d+) cases, .*--tier long: (\d+)", manual) == [
        (str(len(default_stress)), str(len(stress)))
    ]


def test_problems_of_stress_have_unique_names(stress: list[suite.PlannedProblem]) -> None:
    names = [planned.row.name for planned in stress]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[^\s/]+", name) for name in names)


def test_problems_of_stress_vary_augmentation_by_decades(
    default_stress: list[suite.PlannedProblem],
) -> None:
    chosen = {
        p.row.name for p in default_stress if p.row.name.startswith("augmentation_E_50:1_mu_0.4")
    }
    assert {name.split("_")[-1] for name in chosen} == {f"{10.0**k:.2g}" for k in range(-4, 5) if k}


def test_problems_of_stress_have_a_tolerance_or_a_refusal(
    stress: list[suite.PlannedProblem],
) -> None:
    for planned in stress:
        row = planned.row
        assert row.source
        assert (row.tolerance is not None and row.tolerance > 0) or row.refusal


def test_problems_of_stress_have_cases(stress: list[suite.PlannedProblem]) -> None:
    for planned in stress:
        assert all((CONFIGS / run.case).is_file() for run in planned.runs)
    for name in ("stem", "taper"):
        text = (CONFIGS / "stress" / f"{name}.yaml").read_text(encoding="utf-8")
        assert f"run configs/stress/{name}.yaml" in text


def test_problems_of_stress_are_refused_before_meshing_only_if_floating(
    default_stress: list[suite.PlannedProblem], tmp_path: Path
) -> None:
    """These cases float on every mesh; all others are read without an error."""
    unmeshed = [p for p in default_stress if not any(run.mesh for run in p.runs)]
    suite.plan_runs(unmeshed, tmp_path, timed=False)
    refused = [p.row for p in unmeshed if not all(isinstance(r, PlannedRun) for r in p.planned)]
    assert {row.name for row in refused} == {
        "floating_no_support",
        "floating_held_along_x",
        "floating_rigid_on_rigid",
    }
    assert len(unmeshed) > 150
    assert all(row.group == "floating" and row.tolerance is None for row in refused)
