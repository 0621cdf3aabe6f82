"""Predictions from the results of an experiment."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.campaigns.runs import Result
from app.case.case import PlannedRun
from app.case.summary import Summary
from app.foundation.errors import InputError
from app.laws.interface_laws import Frictional
from app.validation import prediction
from app.validation.catalogue import EXPERIMENTS
from app.validation.experiment import COARSER_POINTS, place_of_run

PUSH_OUT = EXPERIMENTS["push_out"]
RUNS = PUSH_OUT.plan()


def pushed(planned: PlannedRun, folder: Path, exit_code: int = 0) -> Result:
    """A run of a dowel whose strength is its friction coefficient, 1 % more on the coarser mesh."""
    law = planned.case.interfaces["stem_cement"]
    assert isinstance(law, Frictional)
    strength = float(law.friction_coefficient)
    if place_of_run(planned.name).part == COARSER_POINTS:
        strength *= 1.01
    folder.mkdir()
    numbers = {"stem_cement": {"force": [0, 0, -2 * strength], "area": 2}}
    (folder / "summary.json").write_text(json.dumps({"interfaces": numbers}))
    return Result(planned, folder, exit_code, 1.0, Summary(), "")


def test_prediction_has_value_mesh_and_band(tmp_path: Path) -> None:
    """The value is friction of the nominal runs.

    The coarser mesh adds 1 %, and the samples give ranges.
    """
    results = [pushed(run, tmp_path / str(k)) for k, run in enumerate(RUNS)]
    predicted = prediction.predict(PUSH_OUT, results)
    clean = predicted["clean"]
    assert clean.value == 0.35
    assert clean.discretization == pytest.approx(0.0035)
    assert len(clean.samples) == 12
    assert clean.band == pytest.approx(np.percentile(clean.samples, (5, 95)), rel=1e-4)
    assert 0.3 <= clean.band[0] < 0.31 and 0.39 < clean.band[1] <= 0.4
    assert predicted["lubricated"].value == pytest.approx(0.2 / 0.35, rel=1e-4)
    assert predicted["lubricated"].discretization == pytest.approx(0, abs=1e-12)
    friction = "interfaces.stem_cement.friction_coefficient"
    assert clean.follows[f"{friction} (clean)"] == 1.0
    assert abs(clean.follows[f"{friction} (lubricated)"]) < 0.6  # independent of it


def test_prediction_leaves_failed_samples_out(tmp_path: Path) -> None:
    failed = {"samples_clean/sample03", "samples_rough/sample05"}
    results = [
        pushed(run, tmp_path / str(k), 4 if run.name in failed else 0) for k, run in enumerate(RUNS)
    ]
    assert len(prediction.predict(PUSH_OUT, results)["clean"].samples) == 10
    few = [
        result
        for result in results
        if place_of_run(result.planned.name).sample
        not in range(1, 12 - prediction.FEWEST_SAMPLES + 3)
    ]
    with pytest.raises(InputError, match="samples are complete; a prediction needs 8"):
        prediction.predict(PUSH_OUT, few)
