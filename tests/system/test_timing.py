"""Seconds by phase, by wall clock and processor clock."""

from __future__ import annotations

import pytest

from app.system import timing
from tests import support


class Clock:
    """Replaces the two clocks. The wall's is twice as fast."""

    now = 0.0

    def perf_counter(self) -> float:
        return 2 * self.now

    def process_time(self) -> float:
        return self.now


def test_timing_phase_is_printed_once_with_its_estimate(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("DEBUG", "mantle")
    t = timing.Timing(about={"factorize": 6.3, "mesh": 0.4, "stiffness": 7.0})
    for phase in (("factorize",), ("mesh",), ("compile", "stiffness"), ("factorize",)):
        with t.phase(*phase):
            pass
    t.of("a part").about["mesh"] = 1.0
    assert not t.about
    preconditioner = "setting up the preconditioner"
    compiling = "loading forms, or compiling them: stiffness, about 7 s"
    assert [(r.levelname, r.message.strip()) for r in caplog.records] == [
        ("INFO", f"{preconditioner}, about 6 s"),
        ("INFO", "meshing"),
        ("DEBUG", compiling),
        ("DEBUG", preconditioner),
    ]


def test_timing_nested_phases_are_separate(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(timing, "time", clock)
    t = timing.Timing()
    with t.phase("output"):
        clock.now += 1
        with t.phase("compile"):
            clock.now += 4
            with pytest.raises(ValueError), t.phase("solve"):
                clock.now += 16
                raise ValueError
        clock.now += 64
    with t.phase("compile"):
        clock.now += 256
    assert t.cpu == {"output": 65, "compile": 260, "solve": 16}
    assert t.seconds == {name: 2 * cpu for name, cpu in t.cpu.items()}
    t.clear()
    assert t.cpu == {}
    assert t.seconds == {}


def test_timing_peak_memory_is_that_of_arrays() -> None:
    """A separate process begins with little memory."""
    code = (
        "import numpy as np; from app.system import timing; before = timing.peak_memory();"
        "size = int(before + 100); assert np.ones((size, 125_000)).nbytes == size * 1e6;"
        "print(timing.peak_memory() - size)"
    )
    assert float(support.python("-c", code).stdout) >= 0  # MB
