"""Output of the command line: colours on terminals, plain text in files, closed pipes."""

from __future__ import annotations

import io
import logging
import os
import pty
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from app.command_line import streams
from app.command_line.streams import COLOURS, Handler, coloured
from tests import support
from tests.support import ROOT


@pytest.mark.parametrize(
    ("command", "reader", "read"),
    [
        ("explain --schema", "head -n 1", "{\n"),
        ("run configs/blocks.yaml -o {} 2>&1", "head -n 0", ""),
    ],
)
def test_streams_closed_output_is_no_error(
    command: str, reader: str, read: str, tmp_path: Path
) -> None:
    """The run continues after its output is closed."""
    line = f"{sys.executable} -m mantle {command.format(tmp_path)} | {reader}; echo ${{PIPESTATUS}}"
    result = subprocess.run(
        ["bash", "-c", line], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert (result.stdout, result.stderr) == (f"{read}0\n", "")
    assert "run" not in command or (tmp_path / "DONE").exists()


WRONG = [sys.executable, "-m", "mantle", "check", "no_such_case.yaml"]


@contextmanager
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[io.TextIOWrapper]:
    """A terminal with colours, independent of the terminal of the tests."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr(streams, "world_size", lambda: None)
    master, slave = pty.openpty()
    with os.fdopen(master, "rb"), os.fdopen(slave, "w") as stream:
        yield stream


def shown(stream: io.TextIOWrapper) -> str:
    """A warning, and a line with a tone, formatted by a handler of the stream."""
    handler = Handler(stream)
    warning = logging.makeLogRecord({"msg": "look", "levelno": logging.WARNING})
    good = logging.makeLogRecord({"msg": "exact", "levelno": logging.INFO, "tone": "good"})
    return f"{handler.format(warning)} {handler.format(good)}"


@pytest.mark.parametrize(
    ("name", "value", "printed"),
    [
        ("NO_COLOR", "", "\033[33mlook\033[m \033[32mexact\033[m"),
        ("NO_COLOR", "1", "look exact"),
        ("TERM", "dumb", "look exact"),
    ],
)
def test_streams_have_colours_only_on_a_terminal(
    name: str, value: str, printed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with terminal(monkeypatch) as stream:
        monkeypatch.setenv(name, value)
        assert shown(stream) == printed


def test_streams_of_ranks_follow_the_launcher(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under mpirun a rank has a terminal even if all output goes to a file."""
    with terminal(monkeypatch) as stream:
        monkeypatch.setattr(streams, "world_size", lambda: 2)
        monkeypatch.delenv(COLOURS, raising=False)
        assert not coloured(stream)
        monkeypatch.setenv(COLOURS, "1")
        assert coloured(stream)


def test_streams_error_is_plain_in_a_file_and_red_on_a_terminal() -> None:
    alone = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_", "PMI", "SLURM"))}
    environ = {**alone, "TERM": "xterm", "NO_COLOR": ""}
    plain = subprocess.run(WRONG, cwd=support.ROOT, env=environ, capture_output=True, check=False)
    assert plain.returncode == 2 and plain.stderr and b"\033" not in plain.stderr
    master, slave = pty.openpty()
    with os.fdopen(slave, "wb") as stream:
        subprocess.run(WRONG, cwd=support.ROOT, env=environ, stderr=stream, check=False)
        assert os.read(master, 1000).startswith(b"\033[1;31m")
    os.close(master)
