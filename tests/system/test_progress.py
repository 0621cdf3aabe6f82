"""A command says what goes on: never silent for long, and no line for what is short."""

from __future__ import annotations

import io
import logging
import time
from collections.abc import Iterator

import pytest

from mantle.command_line import streams
from mantle.command_line.streams import ProgressHandler
from mantle.system.progress import LEVEL, doing
from mantle.system.timing import Timing


@pytest.fixture
def printed(monkeypatch: pytest.MonkeyPatch) -> Iterator[io.StringIO]:
    """What is printed with a patience of a tenth of a second."""
    monkeypatch.setattr(streams, "SILENCE", 0.1)
    monkeypatch.setattr(streams, "LOOK", 0.01)
    stream, logger = io.StringIO(), logging.getLogger("mantle")
    handler = ProgressHandler(stream)
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(LEVEL)
    yield stream
    logger.removeHandler(handler)
    logger.setLevel(before)
    handler.end()


def test_what_is_short_adds_no_line(printed: io.StringIO) -> None:
    for k in range(20):
        doing(f"step {k}")
        logging.getLogger("mantle").info("done %d", k)
    assert printed.getvalue().split() == [w for k in range(20) for w in ("done", str(k))]


def test_a_long_phase_is_told_while_it_goes_on(printed: io.StringIO) -> None:
    timing = Timing()
    with timing.phase("compile"):
        time.sleep(0.5)
    lines = printed.getvalue().splitlines()
    assert len(lines) >= 2
    assert all("compiling forms" in line for line in lines)


def test_what_has_ended_is_not_told(printed: io.StringIO) -> None:
    timing = Timing().of("estimating errors")
    with timing.phase("solve"):
        with timing.phase("factorize"):
            pass
        time.sleep(0.3)
    assert "estimating errors: solving" in printed.getvalue()
    assert "preconditioner" not in printed.getvalue()


def test_nothing_goes_on_between_phases(printed: io.StringIO) -> None:
    with Timing().phase("mesh"):
        pass
    time.sleep(0.3)
    assert printed.getvalue() == ""


def test_seconds_are_told(printed: io.StringIO) -> None:
    doing("meshing")
    time.sleep(1.4)
    assert "meshing (1 s)" in printed.getvalue()


def test_a_record_of_the_log_ends_what_went_on(printed: io.StringIO) -> None:
    doing("meshing")
    logging.getLogger("mantle").info("a mesh")
    time.sleep(0.3)
    assert printed.getvalue() == "a mesh\n"


def test_in_a_slow_run_what_blocks_is_told_at_once_and_once(printed: io.StringIO) -> None:
    doing("compiling")
    time.sleep(0.15)
    for _ in range(3):
        doing("setting the equations up", blocking=True)
        doing("compiling")
    assert printed.getvalue().split("\n")[-2] == "     setting the equations up"
    assert printed.getvalue().count("setting") == 1


def test_a_phase_says_what_it_is_at_work_on(printed: io.StringIO) -> None:
    with Timing().phase("compile", "stiffness"):
        time.sleep(0.2)
    assert "later runs find: stiffness" in printed.getvalue()
