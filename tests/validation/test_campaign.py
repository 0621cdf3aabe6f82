"""`mantle validate`: predictions from results, comparison, files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.campaigns.batch import Options
from app.campaigns.runs import Result
from app.case.case import PlannedRun
from app.case.summary import Summary
from app.foundation.errors import InputError
from app.laws.interface_laws import Frictional
from app.validation import campaign, records
from app.validation.catalogue import EXPERIMENTS
from app.validation.experiment import COARSER_POINTS, NOMINAL, SAMPLES, Place, place_of_run
from tests.validation.predictions import measured, prediction

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


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_campaign_every_part_of_an_experiment_has_the_same_conditions(name: str) -> None:
    places = [place_of_run(point.name) for point in EXPERIMENTS[name].content.points()]
    conditions = {at.condition for at in places if at.part == NOMINAL}
    assert {at.part for at in places} == {NOMINAL, COARSER_POINTS, SAMPLES}
    for number in {at.sample for at in places if at.part == SAMPLES}:
        assert {at.condition for at in places if at.sample == number and number} == conditions
    assert {at.condition for at in places if at.part == COARSER_POINTS} == conditions
    designs = EXPERIMENTS[name].designs
    assert len({(d.seed, d.samples, len(d.inputs)) for d in designs}) == 1


def test_campaign_places_runs_by_part_condition_and_sample() -> None:
    assert place_of_run("nominal/foam_thin") == Place(NOMINAL, "foam_thin", 0)
    assert place_of_run("samples_foam/thin_sample03") == Place(SAMPLES, "foam_thin", 3)


def test_campaign_predicts_value_mesh_and_band(tmp_path: Path) -> None:
    """The value is friction of the nominal runs.

    The coarser mesh adds 1 %, and the samples give ranges.
    """
    results = [pushed(run, tmp_path / str(k)) for k, run in enumerate(RUNS)]
    predicted = campaign.predict(PUSH_OUT, results)
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


def test_campaign_leaves_failed_samples_out(tmp_path: Path) -> None:
    failed = {"samples_clean/sample03", "samples_rough/sample05"}
    results = [
        pushed(run, tmp_path / str(k), 4 if run.name in failed else 0) for k, run in enumerate(RUNS)
    ]
    assert len(campaign.predict(PUSH_OUT, results)["clean"].samples) == 10
    few = [
        result
        for result in results
        if place_of_run(result.planned.name).sample
        not in range(1, 12 - campaign.FEWEST_SAMPLES + 3)
    ]
    with pytest.raises(InputError, match="samples are complete; a prediction needs 8"):
        campaign.predict(PUSH_OUT, few)


def test_campaign_writes_numbers_of_predictions_and_measurements(tmp_path: Path) -> None:
    predicted = prediction([1.0, 2.0, 3.0])
    comparisons = [
        campaign.ComparedQuantity("rods", "strength", 2.0, predicted, measured(2.5)),
        campaign.ComparedQuantity("rods", "strength_gap", 2.3, predicted, measured(5.0)),
        campaign.ComparedQuantity("push_out", "clean", 2.0, predicted, None),
    ]
    assert [c.reproduced for c in comparisons] == [True, False, True]
    campaign._write(comparisons, Options(tmp_path, 1))
    entries = json.loads((tmp_path / "validate.json").read_text())
    assert [e["outcome"] for e in entries] == ["passed", "missed", "predicted"]
    assert [e["blind"] for e in entries] == [False, False, True]
    rows = (tmp_path / "validate.csv").read_text().splitlines()
    assert len(rows) == 4 and "outside" in rows[2]
    for name in ("validate", "rods", "push_out"):
        assert (tmp_path / f"{name}.png").stat().st_size > 5_000


def test_campaign_runs_an_experiment_coarsely_and_reproduces_its_prediction(
    tmp_path: Path,
) -> None:
    """The nominal runs are of a quick tier. A second call solves nothing."""
    options = Options(tmp_path, 1, "push_out", "quick")
    assert campaign.run(options, record=False)
    entries = json.loads((tmp_path / "validate.json").read_text())
    committed = records.predictions()["push_out"].quantities
    assert {e["quantity"] for e in entries} == committed.keys()
    for entry in entries:
        value = committed[entry["quantity"]].value
        assert entry["today"] == pytest.approx(value, rel=campaign.REPRODUCED)
