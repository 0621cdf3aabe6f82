"""Checkpoints: complete or absent files, choice of one, refused ones."""

from __future__ import annotations

import logging
import shutil
import signal
import subprocess
import sys
import time as clock
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

from app.case.case import load_case
from app.cli import main
from app.foundation.errors import InputError
from app.numerics.saved_state import Rows
from app.simulation import checkpoint
from app.simulation.checkpoint import DamagedError
from app.system import stopping
from app.system.folders import saved
from tests import support
from tests.cases import restarted

COMM = MPI.COMM_SELF
FIELDS = "output.fields=false"
HEADER = {"mantle": "1", "step": 3}


def written(path: Path) -> Path:
    rows = Rows(np.array([7, 3, 5]), np.arange(6.0).reshape(3, 2))
    state = {"a": 1.5, "b": [rows], "c": None}
    checkpoint.write(COMM, path, HEADER, state)
    return path


def test_checkpoint_is_read_as_written(tmp_path: Path) -> None:
    saved = checkpoint.read(written(tmp_path / "checkpoint-1.state"))
    assert saved.header["step"] == 3
    assert saved.state["a"] == 1.5 and saved.state["c"] is None
    (rows,) = saved.state["b"]
    assert rows.keys.tolist() == [3, 5, 7]
    assert rows.of(np.array([7, 5])).tolist() == [[0.0, 1.0], [4.0, 5.0]]
    with pytest.raises(ValueError, match="missing"):
        rows.of(np.array([4]))
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint-1.state"]


@pytest.mark.parametrize("where", [b"PK", b'"step"', np.float64(5).tobytes(), b"keys "])
def test_checkpoint_with_a_changed_byte_is_damaged(tmp_path: Path, where: bytes) -> None:
    path = written(tmp_path / "checkpoint-1.state")
    content = bytearray(path.read_bytes())
    content[content.index(where)] ^= 1
    path.write_bytes(content)
    with pytest.raises(DamagedError):
        checkpoint.read(path)


def test_checkpoint_failed_write_keeps_the_previous(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path / "checkpoint-1.state")
    before = path.read_bytes()

    def full(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("app.system.folders.os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        checkpoint.write(COMM, path, HEADER, {"a": 2})
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


@pytest.fixture(scope="module")
def run_of_blocks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with a checkpoint after every step, which keeps two of them."""
    folder = tmp_path_factory.mktemp("blocks")
    (folder / "case.yaml").write_text(restarted.RUBBING)
    options = ["--set", FIELDS, "--set", "output.checkpoint.steps=1"]
    assert main(["run", str(folder / "case.yaml"), "-o", str(folder / "out"), *options]) == 0
    return folder


def copied(folder: Path, to: Path) -> Path:
    """The run directory in the state after a kill at the end."""
    shutil.copytree(folder / "out", to)
    (to / "DONE").unlink()
    return to


def choose(out: Path, folder: Path, wanted: str = "auto", force: bool = False) -> Path | None:
    case = load_case(folder / "case.yaml", [FIELDS]).config
    chosen = checkpoint.checkpoint_to_resume(COMM, wanted, out, case, force)
    return chosen and chosen.path


def test_checkpoint_keeps_two_files(run_of_blocks: Path) -> None:
    names = [p.name for p in saved(run_of_blocks / "out")]
    assert names == ["checkpoint-6.state", "checkpoint-5.state"]


@pytest.mark.parametrize("damage", ["cut", "garbage", "empty"])
def test_checkpoint_damaged_file_is_skipped(
    run_of_blocks: Path, tmp_path: Path, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    out = copied(run_of_blocks, tmp_path / "out")
    newest, before = saved(out)
    content = newest.read_bytes()
    kinds = {"cut": content[: len(content) // 2], "garbage": b"\x00abc" * 999, "empty": b""}
    newest.write_bytes(kinds[damage])
    assert choose(out, run_of_blocks) == before
    assert f"{newest} cannot be used" in caplog.text
    with pytest.raises(InputError, match="cannot be used"):
        choose(out, run_of_blocks, str(newest))
    before.unlink()
    with caplog.at_level(logging.INFO):
        assert choose(out, run_of_blocks) is None
    assert "from the beginning" in caplog.text


def test_checkpoint_of_another_case_is_refused(
    run_of_blocks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = copied(run_of_blocks, tmp_path / "out")
    other = "interfaces.lower_upper.friction_coefficient=0.2"
    command = ["run", str(run_of_blocks / "case.yaml"), "-o", str(out), "--set", FIELDS]
    command += ["--restart", "auto"]
    assert main([*command, "--set", other]) == 2
    printed = capsys.readouterr().err
    assert "of another case" in printed
    assert "interfaces.lower_upper.friction_coefficient: 0.2; in the checkpoint 0.3" in printed
    assert main([*command, "--set", "mesh.size=1 mm", "--force"]) == 2
    assert "another mesh" in capsys.readouterr().err
    assert main([*command, "--set", other, "--force"]) == 0


def test_checkpoint_of_another_version_is_refused(
    run_of_blocks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = copied(run_of_blocks, tmp_path / "out")
    newest, before = saved(out)
    read_back = checkpoint.read(newest)
    checkpoint.write(COMM, newest, {**read_back.header, "mantle": "0.0"}, read_back.state)
    with pytest.raises(InputError, match=r"mantle 0\.0, this is .*--force"):
        choose(out, run_of_blocks)
    assert choose(out, run_of_blocks, force=True) == newest
    # What is laid out in another way cannot be read at all.
    monkeypatch.setattr(checkpoint, "FORMAT", 0)
    checkpoint.write(COMM, newest, {**read_back.header, "mantle": "0.0"}, read_back.state)
    monkeypatch.undo()
    assert choose(out, run_of_blocks) == before
    with pytest.raises(InputError, match=r"mantle 0\.0 in another format"):
        choose(out, run_of_blocks, str(newest), force=True)


@pytest.mark.parametrize(("minutes", "kept"), [(1e-9, 2), (60, 0)])
def test_checkpoint_minutes_do_not_change_steps(
    run_of_blocks: Path, tmp_path: Path, minutes: float, kept: int
) -> None:
    """Any number of checkpoints leaves the steps the same."""
    case, out = run_of_blocks / "case.yaml", tmp_path / "out"
    options = ["--set", FIELDS, "--set", f"output.checkpoint.minutes={minutes}"]
    assert main(["run", str(case), "-o", str(out), *options]) == 0
    assert len(saved(out)) == kept
    assert restarted.rows(out) == restarted.rows(run_of_blocks / "out")


def test_checkpoint_restart_is_reported(
    run_of_blocks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = copied(run_of_blocks, tmp_path / "out")
    command = ["run", str(run_of_blocks / "case.yaml"), "-o", str(out), "--restart", "auto"]
    options = ["--set", FIELDS, "--set", "output.checkpoint.steps=1"]
    assert main([*command, *options]) == 0
    printed = capsys.readouterr().out
    assert "restart from" in printed and "step 6, time 3 in stage 'back'" in printed
    assert main([*command, *options]) == 0
    assert capsys.readouterr().out.startswith(
        f"{out} has the finished results of this case already"
    )


def test_checkpoint_time_spans() -> None:
    assert stopping.seconds_of_duration("2:00:00") == 7200
    assert stopping.seconds_of_duration("30:05") == 1805
    assert stopping.seconds_of_duration("1-1:00:00") == 90000
    assert [stopping.seconds_of_duration(t) for t in ("2 h", "1.5h", "90 min", "7 s")] == [
        7200,
        5400,
        5400,
        7,
    ]
    for wrong in ("", "5", "2 x", "0 s", "1:2:3", "0:00"):
        with pytest.raises(InputError, match="walltime"):
            stopping.seconds_of_duration(wrong)


LONG = ["--set", "stages.1.increments=400", "--set", FIELDS]


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGHUP,
        signal.SIGUSR1,
        *(pytest.param(n, marks=pytest.mark.slow) for n in (signal.SIGTERM, signal.SIGINT)),
    ],
)
def test_checkpoint_is_saved_on_a_signal(tmp_path: Path, number: signal.Signals) -> None:
    out = tmp_path / "out"
    process = begun(tmp_path, out, signal.SIG_DFL)
    process.send_signal(number)
    _, message = process.communicate(timeout=60)
    assert process.returncode == 5
    (path,) = saved(out)
    assert f"stopped by {number.name}" in message and f"state saved in {path}" in message
    assert len(restarted.rows(out)) == 1 + int(path.stem.split("-")[1])


def test_checkpoint_run_under_nohup_continues(tmp_path: Path) -> None:
    process = begun(tmp_path, tmp_path / "out", signal.SIG_IGN)
    process.send_signal(signal.SIGHUP)
    wait_for(process, 3)
    process.send_signal(signal.SIGUSR1)
    _, message = process.communicate(timeout=60)
    assert process.returncode == 5 and "stopped by SIGUSR1" in message


def begun(folder: Path, out: Path, hung_up: signal.Handlers) -> subprocess.Popen[str]:
    """A run that has made a step, started with a handling of SIGHUP."""
    case = folder / "case.yaml"
    case.write_text(restarted.RUBBING)
    process = subprocess.Popen(
        [sys.executable, "-m", "mantle", "run", str(case), "-o", str(out), *LONG],
        env=support.environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, hung_up),
    )
    wait_for(process, 1)
    return process


def wait_for(process: subprocess.Popen[str], step: int) -> None:
    """Wait until a run reports a step."""
    assert process.stdout is not None
    while not process.stdout.readline().startswith(f"{step:4d} "):
        assert process.poll() is None


@pytest.mark.parametrize("first", [signal.SIGINT, signal.SIGTERM])
def test_checkpoint_second_interrupt_stops_at_once(
    first: signal.Signals, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The same signal may arrive twice, and a scheduler sends several signals.

    These do not stop the run.
    """
    handlers: dict[int, Any] = {}
    now, ended = [10.0], list[int]()
    monkeypatch.setattr(signal, "signal", handlers.__setitem__)
    monkeypatch.setattr("app.system.stopping.clock", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr("app.system.ranks.world_size", lambda: None)
    monkeypatch.setattr("os._exit", ended.append)
    stop = stopping.signals()
    handlers[first](first, None)
    assert stop() == first.name
    now[0] += 0.9
    handlers[signal.SIGINT](signal.SIGINT, None)
    now[0] += 0.2
    handlers[signal.SIGTERM](signal.SIGTERM, None)
    assert not ended
    handlers[signal.SIGINT](signal.SIGINT, None)
    assert ended == [130]
    assert capfd.readouterr().err == (
        "mantle: stopping when the state is saved (a second signal stops at once)\n"
        "mantle: stopped before the state was saved; --restart auto goes on from an earlier "
        "checkpoint, if any\n"
    )


@pytest.mark.parametrize("tick", [0.02, 0.05])
def test_checkpoint_is_saved_at_the_wall_time(
    tmp_path: Path, tick: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each look at the clock advances it by a tick."""

    class Clock:
        now = 0.0

        def perf_counter(self) -> float:
            self.now += tick
            return self.now

    clock = Clock()
    monkeypatch.setattr("app.simulation.session.clock", clock)
    monkeypatch.setattr("app.system.stopping.clock", clock)
    case, out = tmp_path / "case.yaml", tmp_path / "out"
    case.write_text(restarted.RUBBING)
    command = ["run", str(case), "-o", str(out), *LONG, "--restart", "auto"]
    assert main([*command, "--walltime", "0:00:02"]) == 5
    (path,) = saved(out)
    steps = len(restarted.rows(out))
    assert main([*command, "--walltime", "0:00:02"]) == 5
    assert saved(out)[0] != path and len(restarted.rows(out)) > steps


@pytest.mark.slow
def test_checkpoint_restarts_after_twenty_kills(tmp_path: Path) -> None:
    """A run killed at any moment continues to the same numbers."""
    case, _ = restarted.whole(restarted.RUBBING, tmp_path, FIELDS)
    command = ["run", str(case), "--set", FIELDS, "--set", "output.checkpoint.steps=1"]
    random = np.random.default_rng(7)
    left = []
    for k in range(20):
        out = tmp_path / f"out-{k}"
        process = subprocess.Popen(
            [sys.executable, "-m", "mantle", *command, "-o", str(out)],
            env=support.environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        wanted = f"checkpoint-{random.integers(1, 6)}.state"
        while process.poll() is None and wanted not in [p.name for p in saved(out)]:
            clock.sleep(0.001)
        clock.sleep(random.uniform(0.0, 0.05))  # in the middle of whatever comes next
        process.kill()
        process.wait()
        left.append(len(saved(out)))
        assert main([*command, "-o", str(out), "--restart", "auto"]) == 0
        restarted.assert_same(tmp_path / "whole", out)
        shutil.rmtree(out)
    print(f"killed 20 times, checkpoints left: {np.bincount(left).tolist()}")
    assert left.count(2) > 4
