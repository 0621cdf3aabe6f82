"""Numbers of several runs, compared."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.case.number_text import Number
from app.report import compared_numbers
from app.report.sweep_results import CONVERGED, SweptCase


def run(folder: Path, **sections: object) -> SweptCase:
    """A converged run whose summary has these sections."""
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps(sections))
    return SweptCase(folder.name, folder, CONVERGED)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (Number(10.0, 1.0), Number(11.5, 1.0), False),
        (Number(10.0, 1.0), Number(12.5, 1.0), True),
        (Number(10.0), Number(10.2), True),
        (Number(10.0), Number(10.0), False),
    ],
)
def test_compared_numbers_differ_beyond_both_errors(
    first: Number, second: Number, expected: bool
) -> None:
    """The limit is the sum of both errors. Without errors any visible difference counts."""
    assert compared_numbers.differs(first, second, 0.1) == expected


def test_compared_numbers_are_ordered_by_significance(tmp_path: Path) -> None:
    """Numbers are ordered by difference over the sum of errors.

    Those without errors follow, then equal ones.
    """
    numbers = {
        "slip_p99": (0.100, 0.130, 0.01),  # 1.5 errors
        "gap_p99": (0.010, 0.020, 0.001),  # 5 errors
        "motion_p99": (0.100, 0.101, 0.01),  # within
        "pressure_max": (1.0, 3.0, None),
        "shear_max": (1.0, 2.0, None),
        "dissipation": (4.0, 4.0, None),
    }
    cases = []
    for k, name in enumerate(("a", "b")):
        values = {key: row[k] for key, row in numbers.items()}
        errors = {f"{key}_error": e for key, (*_, e) in numbers.items() if e is not None}
        cases.append(run(tmp_path / name, interfaces={"stem_cement": values | errors}))
    ordered = compared_numbers.compared_numbers(cases)
    keys = [number.key.removeprefix("stem_cement.") for number in ordered]
    assert keys[:4] == ["gap_p99", "slip_p99", "pressure_max", "shear_max"]
    assert {*keys[4:]} == {"motion_p99", "dissipation"}
    gap = ordered[0]
    assert (gap.title, gap.text(0), gap.text(1)) == (
        "stem-cement gap, p99 (µm)",
        "10.0 ± 1.0",
        "20.0 ± 1.0",
    )
    assert gap.difference(1) == "10.0 ± 2.0 (+100.0 %)"
    assert gap.significance == pytest.approx(5.0)
    assert ordered[2].difference(1) == "2 (+200.0 %), errors unknown"
    by_key = dict(zip(keys, ordered, strict=True))
    assert by_key["motion_p99"].difference(1).endswith("within the errors")
    assert by_key["dissipation"].difference(1) == "0"


@pytest.mark.parametrize(
    ("first", "second", "text"),
    [
        (Number(2e-16), Number(4.0), "4, errors unknown"),
        (Number(0.5, 0.8), Number(4.0, 0.8), "3.5 ± 1.6"),
        (Number(2.0, 0.5), Number(4.0, 0.5), "2.0 ± 1.0 (+100.0 %)"),
    ],
)
def test_compared_numbers_have_no_difference_relative_to_about_zero(
    first: Number, second: Number, text: str
) -> None:
    """Within its rounding or its error a number may be zero."""
    number = compared_numbers.ComparedNumber("a.b", "a", "b", "µm", (first, second), 0.1)
    assert number.difference(1) == text


def test_compared_numbers_are_of_every_section(tmp_path: Path) -> None:
    """Sections are parts of interfaces, vectors, strains, temperatures, Gruen zones; not costs."""
    sections = {
        "interfaces": {"stem_cement": {"force": [1.0, 2.0, 3.0], "rim": {"slip_p99": 0.2}}},
        "regions": {"cement": {"volume_over_5_MPa": 3.0}},
        "stem": {"subsidence": 0.02},
        "femur": {"strain_lateral_40": 0.001},
        "thermal": {"regions": {"bone": {"temperature_max": 40.0}}},
        "gruen": {
            "7": {
                "strain_energy_density": {"cortical_bone": 0.004},
                "strain_energy_density_error": {"cortical_bone": 0.0004},
                "interfaces": {"stem_cement": {"slip_mean": 0.03, "slip_mean_error": 0.003}},
            }
        },
        "solver": {"newton_iterations": 5},
        "timing": {"total": 3.0},
    }
    cases = [run(tmp_path / name, **sections) for name in ("a", "b")]
    numbers = {number.key: number for number in compared_numbers.compared_numbers(cases)}
    assert {*numbers} == {
        "stem_cement.force.x",
        "stem_cement.force.y",
        "stem_cement.force.z",
        "stem_cement_rim.slip_p99",
        "cement.volume_over_5_MPa",
        "stem.subsidence",
        "femur.strain_lateral_40",
        "bone.temperature_max",
        "gruen.7.cortical_bone.strain_energy_density",
        "gruen.7.stem_cement.slip_mean",
    }
    assert numbers["stem_cement_rim.slip_p99"].title == "stem-cement rim slip, p99 (µm)"
    assert numbers["gruen.7.cortical_bone.strain_energy_density"].text(0) == "4.00 ± 0.40"
    assert numbers["gruen.7.stem_cement.slip_mean"].text(1) == "30.0 ± 3.0"
    assert not any(number.differs for number in numbers.values())


def test_compared_numbers_list_those_of_one_run(tmp_path: Path) -> None:
    """A hip with cement and one without have the stem in common."""
    cemented = {"stem_cement": {"slip_p99": 0.1, "gap_p99": 0.1}}
    cases = [
        run(tmp_path / "cemented", interfaces=cemented, stem={"subsidence": 0.02}),
        run(tmp_path / "pressed", stem={"subsidence": 0.05}),
    ]
    assert [n.key for n in compared_numbers.compared_numbers(cases)] == ["stem.subsidence"]
    sentences = compared_numbers.unshared(["cemented", "pressed"], cases)
    assert sentences == ["cemented alone has 2 of stem-cement."]
