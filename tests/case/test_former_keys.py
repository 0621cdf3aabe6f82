"""Versions of case files, and former names of keys, which are read with a note."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

import mantle
from app.case import former_keys
from app.case.case import Case, dump
from app.case.sweep import read as read_sweep
from app.foundation.errors import InputError
from tests.support import CONFIGS

HEAD = f"base: {CONFIGS / 'head_cup.yaml'}\n"
LIBRARY = """\
courses:
  slow:
    source: made up
    rows: ["time [s], force [N]", "0, 1", "9, 2"]
"""


def test_former_keys_of_a_file_are_read_with_a_note(tmp_path: Path) -> None:
    case = tmp_path / "case.yaml"
    case.write_text(HEAD + 'loads: {hip: {course: ["time [s], force [N]", "0, 5", "1, 7"]}}\n')
    loaded = mantle.load(case)
    table = loaded.config.loads["hip"].cycle_table
    assert table.columns["force"] == (5.0, 7.0)
    expected = "note: loads.hip.course: the key 'course' has a new name; use cycle_table"
    assert [str(note) for note in loaded.file.notes] == [expected]
    assert expected in str(mantle.check(loaded))


def test_former_keys_of_an_option_and_a_library_are_read(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(LIBRARY)
    case = tmp_path / "case.yaml"
    case.write_text(HEAD + "library: mine.yaml\n")
    loaded = mantle.load(case, **{"loads.hip.course": "slow"})
    assert loaded.config.loads["hip"].cycle_table.columns["force"] == (1.0, 2.0)
    assert [note.where for note in loaded.file.notes] == ["courses", "loads.hip.course"]


def test_former_keys_before_the_last_key_of_an_option_are_read(tmp_path: Path) -> None:
    """Both layers have one note on the former key, as in a file."""
    case = tmp_path / "case.yaml"
    case.write_text("base: blocks\n")
    keys = {f"interfaces.bone_cement.compliance.{k}": "9 MPa/mm" for k in ("normal", "tangential")}
    loaded = mantle.load(case, **keys)
    assert loaded.config.interfaces["bone_cement"].layer == (9.0, 9.0)
    assert [str(note) for note in loaded.file.notes] == [
        "note: interfaces.bone_cement.compliance: the key 'compliance' has a new name; "
        "use elastic_layer"
    ]


def test_former_keys_beside_present_ones_are_refused(tmp_path: Path) -> None:
    case = tmp_path / "case.yaml"
    case.write_text(HEAD + "loads: {hip: {course: a, cycle_table: b}}\n")
    with pytest.raises(InputError, match=r"is the former name of cycle_table; keep one"):
        mantle.load(case)


def test_former_keys_keep_their_place_in_messages(tmp_path: Path) -> None:
    case = tmp_path / "case.yaml"
    case.write_text(HEAD + "loads: {hip: {course: 3}}\n")
    with pytest.raises(
        InputError, match=r"case.yaml:2:15: loads.hip.cycle_table: 3 is not a cycle"
    ):
        mantle.load(case)


# Of each kept file, by formulas: at half of 2 MPa the blocks shorten by p h / E each.
ANSWERS = {
    "1": {
        "interfaces.lower_upper.pressure_mean": 1.0,
        "probes.top.displacement.2": -(1.0 * 5.0 / 2e3 + 1.0 * 5.0 / 4e3),
    },
}


@pytest.mark.parametrize("version", [str(k) for k in range(1, former_keys.VERSION + 1)])
def test_former_keys_files_of_each_version_keep_their_answers(version: str, tmp_path: Path) -> None:
    case = mantle.load(Path(__file__).with_name("versions") / f"{version}.yaml")
    summary = mantle.run(case, tmp_path / "out").summary
    for key, answer in ANSWERS[version].items():
        number = summary
        for part in key.split("."):
            number = number[int(part) if part.isdigit() else part]
        assert number == pytest.approx(answer, rel=1e-9), key


def test_former_keys_version_of_a_case_is_written(tmp_path: Path) -> None:
    """A file without a version is of the first version; a run writes its version."""
    case = tmp_path / "case.yaml"
    case.write_text("base: blocks\n")
    config = mantle.load(case).config
    assert config.mantle == Case.model_fields["mantle"].default
    assert former_keys.VERSION == Case.model_fields["mantle"].default
    assert dump(config).startswith("mantle: 1\n")
    for path in (CONFIGS / "start").iterdir():
        assert "\nmantle: 1 " in path.read_text(encoding="utf-8"), path.name


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("mantle: 2", "the file is of version 2, and mantle 0.1.0 reads versions up to 1; install"),
        ("mantle: 0.1", "0.1 is not a version of case files; expected 1"),
        ("mantle: '1'", "'1' is not a version of case files; expected 1"),
    ],
)
def test_former_keys_unknown_versions_are_refused(line: str, words: str, tmp_path: Path) -> None:
    """The version is the only error, because a newer file may have other keys."""
    below, above = tmp_path / "below.yaml", tmp_path / "above.yaml"
    below.write_text(f"title: newer\n{line}\nbodies: {{}}\n")
    above.write_text("base: below.yaml\n")
    for path in (below, above):
        with pytest.raises(InputError) as error:
            mantle.load(path)
        assert len(error.value.messages) == 1
        assert error.value.messages[0].startswith(f"{below}:2:1: mantle: {words}")
    sweep = tmp_path / "sweep.yaml"
    sweep.write_text(f"{line}\nbase: blocks\ngrid: {{mesh.size: [4 mm, 5 mm]}}\n")
    with pytest.raises(InputError, match=re.escape(words)):
        read_sweep(sweep)
    sweep.write_text(sweep.read_text().replace(line, "mantle: 1"))
    assert len(read_sweep(sweep)[1]) == 2


def test_former_keys_move_into_a_section(tmp_path: Path) -> None:
    case = tmp_path / "case.yaml"
    case.write_text(
        "base: stance\ngeometry: {resection_height: 4 mm, resection: {angle: 40 deg}}\n"
    )
    loaded = mantle.load(case, **{"geometry.resection_angle": "39 deg"})
    cut = loaded.config.geometry.resection
    assert (cut.height, round(math.degrees(cut.angle), 9)) == (4.0, 39.0)
    assert [str(note) for note in loaded.file.notes] == [
        f"note: geometry.{former}: the key '{former}' has a new name; use {present}"
        for former, present in (
            ("resection_height", "resection.height"),
            ("resection_angle", "resection.angle"),
        )
    ]
    case.write_text("base: stance\ngeometry: {resection_height: 4 mm, resection: {height: 5 mm}}\n")
    with pytest.raises(InputError, match=r"is the former name of resection.height; keep one"):
        mantle.load(case)
