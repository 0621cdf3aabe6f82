"""A command says what goes on: never silent for long, and no line for what is short."""

from __future__ import annotations

import ctypes
import io
import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from app.command_line import streams
from app.command_line.streams import ProgressHandler
from app.system.progress import LEVEL, doing
from app.system.timing import Timing

Printed = Callable[[], str]


@pytest.fixture
def printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Printed]:
    """What has been printed, with a patience of a tenth of a second."""
    monkeypatch.setattr(streams, "SILENCE", 0.1)
    logger, before = logging.getLogger("mantle"), logging.getLogger("mantle").level
    with (tmp_path / "log").open("a") as stream:
        handler = ProgressHandler(stream)
        logger.addHandler(handler)
        logger.setLevel(LEVEL)
        doing("starting")
        while not (log := (tmp_path / "log").read_text()):
            time.sleep(0.01)
        logger.info("started")
        yield lambda: (tmp_path / "log").read_text().removeprefix(f"{log}started\n")
        logger.removeHandler(handler)
        logger.setLevel(before)
        handler.end()


def test_what_is_short_adds_no_line(printed: Printed) -> None:
    for k in range(20):
        doing(f"step {k}")
        logging.getLogger("mantle").info("done %d", k)
    assert printed().split() == [w for k in range(20) for w in ("done", str(k))]


def test_a_long_phase_is_told_while_it_goes_on(printed: Printed) -> None:
    timing = Timing()
    with timing.phase("compile"):
        time.sleep(0.5)
    lines = printed().splitlines()
    assert len(lines) >= 2
    assert all("compiling forms" in line for line in lines)


def test_what_has_ended_is_not_told(printed: Printed) -> None:
    timing = Timing().of("estimating errors")
    with timing.phase("solve"):
        with timing.phase("factorize"):
            pass
        time.sleep(0.3)
    assert "estimating errors: solving" in printed()
    assert "preconditioner" not in printed()


def test_nothing_goes_on_between_phases(printed: Printed) -> None:
    with Timing().phase("mesh"):
        pass
    time.sleep(0.3)
    assert printed() == ""


def test_seconds_are_told(printed: Printed) -> None:
    doing("meshing")
    time.sleep(1.4)
    assert "meshing (1 s)" in printed()


def test_a_record_of_the_log_ends_what_went_on(printed: Printed) -> None:
    doing("meshing")
    logging.getLogger("mantle").info("a mesh")
    time.sleep(0.3)
    assert printed() == "a mesh\n"


def test_in_a_slow_run_what_blocks_is_told_at_once_and_once(printed: Printed) -> None:
    doing("compiling")
    time.sleep(0.2)
    for _ in range(3):
        doing("setting the equations up", blocking=True)
        doing("compiling")
    time.sleep(0.05)
    assert printed().split("\n")[-2] == "     setting the equations up"
    assert printed().count("setting") == 1


def test_a_phase_says_what_it_is_at_work_on(printed: Printed) -> None:
    with Timing().phase("compile", "stiffness"):
        time.sleep(0.2)
    assert "later runs find: stiffness" in printed()


def test_what_lets_no_other_thread_run_is_told(printed: Printed) -> None:
    doing("setting the preconditioner up")
    ctypes.PyDLL(None).usleep(500_000)  # unlike CDLL, this keeps the interpreter locked
    assert printed().count("preconditioner") >= 2


def test_a_stream_that_no_other_process_can_have_gets_its_records() -> None:
    stream = io.StringIO()
    handler = ProgressHandler(stream)
    for level, text in ((LEVEL, "meshing"), (logging.INFO, "a mesh")):
        handler.handle(logging.LogRecord("mantle", level, "", 0, text, (), None))
    handler.end()
    assert stream.getvalue() == "a mesh\n"
