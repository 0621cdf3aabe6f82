"""The commands as functions of Python."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import mantle
from app.foundation.errors import InputError
from tests.support import CONFIGS


@pytest.mark.parametrize("function", [mantle.check, mantle.mesh, mantle.run])
def test_actions_name_load_for_a_path(function: Callable[[str], object]) -> None:
    with pytest.raises(InputError, match=r"use mantle\.load\('blocks\.yaml'\)"):
        function("blocks.yaml")


def test_actions_name_arguments_of_python(tmp_path: Path) -> None:
    """The command line names its options in the same errors (`test_bad_input_run_folder`)."""
    case = mantle.load(CONFIGS / "blocks.yaml")
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "checkpoint-3.state").touch()
    with pytest.raises(InputError) as caught:
        mantle.run(case, folder)
    assert str(caught.value) == (
        f'output {folder}: is not empty; choose another folder, restart="auto" to continue from its'
        " checkpoint, or force=True to replace the results"
    )
    assert caught.value.messages == [str(caught.value)]
    with pytest.raises(InputError, match=r"^restart .*/none: cannot be "):
        mantle.run(case, folder, restart=str(tmp_path / "none"))
