"""All commands: cores, ranks, exit codes, names of shipped cases."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import mantle
from app import cli
from app.cli import main
from app.command_line.commands import dispatch
from app.command_line.parser import parser
from app.foundation.errors import ConvergenceError, InputError
from app.system import ranks
from tests.support import CONFIGS, ROOT


@pytest.mark.parametrize("command", ["study", "sweep", "verify", "stress"])
def test_commands_cores_are_those_of_the_process(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {3, 5, 6})
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    file = [f"{command}.yaml"] if command in ("study", "sweep") else []
    assert cli.parser().parse_args([command, *file]).cores == 3


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (ConvergenceError("stem_cement did not settle"), 4, "stem_cement did not settle"),
        (KeyboardInterrupt(), 5, "stopped: no step had converged, so nothing was written"),
        (ZeroDivisionError("a bug"), 70, "ZeroDivisionError: a bug"),
    ],
)
def test_commands_exit_codes(
    error: BaseException,
    code: int,
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(arguments: list[str]) -> int:
        raise error

    monkeypatch.setattr(cli, "dispatch", fail)
    aborted: list[int] = []
    monkeypatch.setattr(cli, "_abort", aborted.append)
    assert main(["run"]) == code
    assert capsys.readouterr().err.rstrip().endswith(message)
    # Errors that all ranks have alike leave by themselves; others end the ranks that would wait.
    assert aborted == ([] if code == 4 else [code])


@pytest.mark.parametrize("variable", ranks.RANK_VARIABLES)
def test_commands_one_rank_prints(
    variable: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for other in ranks.RANK_VARIABLES:
        monkeypatch.delenv(other, raising=False)
    assert ranks.rank() == 0
    monkeypatch.setenv(variable, "3")
    monkeypatch.setattr(cli, "GRACE", 0.0)
    assert ranks.rank() == 3
    assert main(["check", "none.yaml"]) == 2
    assert capsys.readouterr() == ("", "")


def test_commands_take_a_shipped_case_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert dispatch(["check", "cylinders"]) == 0
    assert capsys.readouterr().out.startswith(mantle.load(CONFIGS / "cylinders.yaml").config.title)
    with pytest.raises(InputError, match="cylinder"):
        dispatch(["check", "cylinder"])
    assert ROOT != tmp_path


def test_commands_options_do_not_reach_the_next(tmp_path: Path) -> None:
    case = tmp_path / "missing.yaml"
    assert main(["run", str(case), "--error", "--accuracy", "0.05"]) == 2
    assert parser().parse_args(["run", str(case)]).overrides == []
