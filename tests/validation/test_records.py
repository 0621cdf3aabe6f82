"""Files of predictions and measurements: complete, of present inputs, errors in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import configs
from app import cli
from app.foundation.errors import InputError
from app.validation import records
from app.validation.catalogue import EXPERIMENTS
from app.validation.prediction import FEWEST_SAMPLES
from app.validation.records import MeasuredQuantity
from tests.validation.predictions import prediction, record

# Numbers that the project asks for: predicted experiments, quantities before a comparison.
LEAST_EXPERIMENTS = 8
LEAST_BLIND = 20


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that replaces the manual's."""
    monkeypatch.setattr(records, "PREDICTIONS", tmp_path / "predictions.json")
    monkeypatch.setattr(records, "MEASURED", tmp_path / "measured.json")
    return tmp_path


@pytest.mark.parametrize("name", records.predictions())
def test_records_predict_every_quantity_from_the_present_inputs(name: str) -> None:
    """A changed case, range or script needs a new prediction: mantle validate --record."""
    experiment = EXPERIMENTS[name]
    committed = records.predictions()[name]
    assert committed.quantities.keys() == experiment.quantities.keys()
    assert committed.inputs == records.hash_of_inputs(experiment)
    assert committed.blind == experiment.blind
    for key, quantity in experiment.quantities.items():
        predicted = committed.quantities[key]
        assert (predicted.text, predicted.unit) == (quantity.text, quantity.unit)
        assert len(predicted.samples) >= FEWEST_SAMPLES
        assert predicted.failure
        low, high = predicted.band
        assert min(predicted.samples) <= low <= high <= max(predicted.samples)


def test_records_predict_enough_experiments() -> None:
    known = records.predictions()
    assert len(known) >= LEAST_EXPERIMENTS
    assert sum(len(r.quantities) for r in known.values() if r.blind) >= LEAST_BLIND


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_records_experiments_have_a_case_and_a_sheet(name: str) -> None:
    case = (configs.FOLDER / "validation" / f"{name}.yaml").read_text(encoding="utf-8")
    assert f"run configs/validation/{name}.yaml" in case
    sheet = (records.FOLDER / f"{name}.md").read_text(encoding="utf-8")
    for word in ("Source", "Modelled", "Left out", "Rests on", "Failure"):
        assert f"**{word}.**" in sheet
    assert f"]({name}.md)" in (records.FOLDER / "README.md").read_text(encoding="utf-8")


def test_records_measure_what_is_predicted_and_no_blind_experiment() -> None:
    measured = records.measurements(records.predictions())
    assert {"rods", "slab"} <= measured.keys()
    assert not any(EXPERIMENTS[name].blind for name in measured)


def test_records_hash_changes_with_a_case_but_not_with_a_comment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = EXPERIMENTS["disc"]
    committed = records.hash_of_inputs(experiment)
    for name in ("experiments/disc.yaml", "validation/disc.yaml", "validation/disc.geo"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text((configs.FOLDER / name).read_text(encoding="utf-8"))
    monkeypatch.setattr(configs, "FOLDER", tmp_path)
    assert records.hash_of_inputs(experiment) == committed
    for name, old, new, same in (
        ("validation/disc.yaml", "title:", "# a comment\ntitle:", True),
        ("validation/disc.yaml", "0.2 W/(m K)", "0.21 W/(m K)", False),
        ("experiments/disc.yaml", "high: 1e-2", "high: 2e-2", False),
        ("validation/disc.geo", "Pi / 6", "Pi / 5", False),
    ):
        path = tmp_path / name
        before = path.read_text(encoding="utf-8")
        assert old in before
        path.write_text(before.replace(old, new), encoding="utf-8")
        assert (records.hash_of_inputs(experiment) == committed) == same, name
        path.write_text(before, encoding="utf-8")


STRENGTH = '"unit": "MPa", "source": "made up"'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "measured.json: not valid JSON"),
        ("[]", "measured.json: "),
        (f'{{"rods": {{"strength": {{{STRENGTH}}}}}}}', "has neither a value nor a range"),
        (
            f'{{"rods": {{"strength": {{"range": [2, 1], {STRENGTH}}}}}}}',
            "rods.strength.range: does not increase",
        ),
        (
            f'{{"rods": {{"strength": {{"value": 1, "uncertainty": 0, {STRENGTH}}}}}}}',
            "rods.strength.uncertainty: 0",
        ),
        ('{"rods": {"strength": {"value": 1, "unit": "MPa"}}}', "'source' is missing"),
        (f'{{"rod": {{"strength": {{"value": 1, {STRENGTH}}}}}}}', "rod: there is no prediction"),
        (
            f'{{"rods": {{"length": {{"value": 1, {STRENGTH}}}}}}}',
            "rods.length: there is no prediction of this quantity",
        ),
        (
            '{"rods": {"strength": {"value": 1, "unit": "kPa", "source": "x"}}}',
            "rods.strength: is in kPa, the prediction in MPa",
        ),
    ],
)
def test_records_report_malformed_measurements_in_one_line(
    text: str, message: str, folder: Path
) -> None:
    (folder / "measured.json").write_text(text)
    known = {"rods": record("", {"strength": prediction([1.0, 2.0])})}
    with pytest.raises(InputError) as caught:
        records.measurements(known)
    assert message in str(caught.value)
    assert len(caught.value.messages) == 1


def test_records_without_measurements_are_empty(folder: Path) -> None:
    assert records.measurements({}) == {}


def test_records_are_read_as_written(folder: Path) -> None:
    written = {"rods": record("0", {"strength": prediction([1.0, 2.5])})}
    records.write(written)
    assert records.predictions() == written
    assert json.loads(records.PREDICTIONS.read_text())["rods"]["quantities"]["strength"]["unit"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-k", "spoons"], "-k spoons: no experiment has this in its name; allowed: "),
        (["-k", "rods"], "no complete prediction of rods; mantle validate -k rods --record"),
        (["-k", "rods", "--record", "--tier", "quick"], "a prediction needs all samples"),
    ],
)
def test_records_missing_end_the_command_with_one_line(
    arguments: list[str], message: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "predictions.json").write_text("{}")
    code = cli.main(["validate", *arguments, "-o", str(folder / "out")])
    complaint = capsys.readouterr().err
    assert code == InputError.exit_code
    assert message in complaint
    assert len(complaint.splitlines()) == 1


def test_records_middle_is_the_value_or_that_of_the_range() -> None:
    both = MeasuredQuantity(value=1.0, range=(0.0, 4.0), unit="-", source="x")
    assert both.middle == 1.0
    assert MeasuredQuantity(range=(0.0, 4.0), unit="-", source="x").middle == 2.0
