"""`mantle validate`: parts of experiments, comparison, files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.campaigns.batch import Options
from app.validation import campaign, records
from app.validation.catalogue import EXPERIMENTS
from app.validation.experiment import COARSER_POINTS, NOMINAL, SAMPLES, Place, place_of_run
from tests.validation.predictions import measured, prediction


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
