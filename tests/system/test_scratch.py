"""The folder of a run for what goes with it: cleared away, whoever is killed."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from app.system import scratch
from tests.support import started


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(scratch, "SHARED", tmp_path)
    return tmp_path


def test_folders_of_runs_that_live_stay(place: Path) -> None:
    one, held = scratch.make()
    two, other = scratch.make()
    assert one.is_dir() and two.is_dir() and one != two
    assert scratch.variables(one)["OMPI_MCA_btl_sm_backing_directory"] == str(one)
    (one / "inside").write_text("x")
    scratch.remove(one, held)
    scratch.remove(two, other)
    assert not list(place.iterdir())


def test_folders_of_runs_that_were_killed_go(place: Path) -> None:
    setting = (
        "import time; from pathlib import Path; from app.system import scratch;"
        f"scratch.SHARED = Path('{place}'); print(scratch.make()[0], flush=True);"
    )
    child = started("-c", setting + "time.sleep(60)")
    assert child.stdout is not None
    old = Path(child.stdout.readline().strip())
    (old / "segment").write_text("x")
    mine, held = scratch.make()
    assert old.exists()
    os.close(held)  # as if this one had been killed
    child.send_signal(signal.SIGKILL)
    child.communicate()
    new, held = scratch.make()
    assert list(place.iterdir()) == [new] and not mine.exists()
    scratch.remove(new, held)
