"""A folder with a case and a sweep, where a stand-in runs in place of ``mantle run``."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from app.campaigns import batch
from app.campaigns.runs import Job, Result
from tests.campaigns.test_points import CASE, SWEEP

STAND_IN = Path(__file__).with_name("stand_in.py")


class Bench:
    """The folder; its files tell `stand_in` what to do."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.out = folder, folder / "out put"
        self.case, self.sweep = folder / "case.yaml", folder / "sweep.yaml"
        self.tell(broken="", code="1", seconds="0", meet="1", awaited=".")
        self.tell(interrupted="5")
        self.tell(**{"case.yaml": CASE, "sweep.yaml": SWEEP})

    def tell(self, **files: str) -> None:
        for name, text in files.items():
            (self.folder / name).write_text(text)

    def told(self, name: str) -> list[str]:
        """The ``calls`` of the stand-in since the last time, or the ``runs`` that it finished."""
        path = self.folder / name
        lines = path.read_text().splitlines() if path.exists() else []
        path.unlink(missing_ok=True)
        return sorted(lines)

    def sizes(self) -> list[float]:
        """The mesh sizes of the calls since the last time."""
        return [float(line.split()[0]) for line in self.told("calls")]

    def job(self, size: float, *more: str, **options: object) -> Job:
        return Job(f"size-{size}", self.case, (f"mesh.size={size} mm", *more), **options)  # type: ignore[arg-type]

    def run(self, *jobs: Job) -> list[Result]:
        return batch.run(jobs, self.out, 2)

    def finished(self) -> list[Path]:
        """The DONE of every finished run."""
        runs = self.out / "runs"
        return [*runs.glob("case-*/DONE"), *runs.glob("shared-*/case-*/DONE")]

    def processes(self) -> list[int]:
        """Other processes that have to do with the batch."""
        here, found = str(self.folder).encode(), []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                if here in path.read_bytes() and path.parent.name != str(os.getpid()):
                    found.append(int(path.parent.name))
        return found


def wait(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.setattr(batch, "MANTLE_RUN", (sys.executable, str(STAND_IN), str(tmp_path)))
    return Bench(tmp_path)
