"""Former names of keys: read from files, bases, libraries and options, with a note for each."""

from __future__ import annotations

from pathlib import Path

import pytest

import mantle
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
