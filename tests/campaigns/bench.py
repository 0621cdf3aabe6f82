"""A folder with a case, a sweep and a study. A stand-in replaces ``mantle run``."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path

from app.campaigns import batch
from app.campaigns.runs import Result
from app.case.case import PlannedRun
from tests.cases.blocks import BLOCKS

CASE = (
    BLOCKS.replace("size: 4 mm}", "size: 4 mm, far_size: 6 mm}")
    .replace("ratio: 0.3}", "ratio: 0.3, tissue: other}")
    .replace("  push: {kind: force, boundary: top, force: [3 N, 0 N, -4 N]}\n", "")
)
FRICTION = "interfaces.lower_upper.friction_coefficient"
SWEEP = f"""\
base: case.yaml
set: {{regions.upper.poisson_ratio: 0.25}}
table:
  soft: {{regions.lower.youngs_modulus: 1 GPa}}
  hard: {{regions.lower.youngs_modulus: 2 GPa}}
grid:
  {FRICTION}: [0.2, 0.4]
  loads.press.pressure: [1 MPa, 3 MPa]
"""
STUDY = """\
base: case.yaml
set: {output.condition: true}
study:
  quantities: [lower_upper.slip_p99, lower_upper.pressure_p99, solver.condition]
  lines:
    P1: {mesh.order: 1, mesh.size: [4 mm, 2 mm, 1 mm]}
    P2: {mesh.order: 2, mesh.size: [4 mm, 2 mm, 1.5 mm], mesh.far_size: [5 mm, 4 mm, 3 mm]}
  reference:
    run: {mesh.order: 2, mesh.size: [0.8 mm, 0.5 mm]}
"""
STAND_IN = Path(__file__).with_name("stand_in.py")


class Bench:
    """The folder, whose files control `stand_in`."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.out = folder, folder / "out put"
        self.case, self.sweep = folder / "case.yaml", folder / "sweep.yaml"
        self.write(broken="", code="1", seconds="0", meet="1", awaited=".")
        self.write(interrupted="5")
        self.write(**{"case.yaml": CASE, "sweep.yaml": SWEEP})

    def write(self, **files: str) -> None:
        for name, text in files.items():
            (self.folder / name).write_text(text)

    def taken(self, name: str) -> list[str]:
        """The ``calls`` of the stand-in since the previous look, or its finished ``runs``."""
        path = self.folder / name
        lines = path.read_text().splitlines() if path.exists() else []
        path.unlink(missing_ok=True)
        return sorted(lines)

    def sizes(self) -> list[float]:
        """The mesh sizes of the calls since the previous look."""
        return [float(line.split()[0]) for line in self.taken("calls")]

    def job(self, size: float, *more: str, ranks: int = 1, timed: bool = False) -> PlannedRun:
        overrides = (f"mesh.size={size} mm", *more)
        return PlannedRun.load(f"size-{size}", self.case, overrides, ranks, timed)

    def run(self, *jobs: PlannedRun) -> list[Result]:
        return batch.run(jobs, self.out, 2)

    def finished(self) -> list[Path]:
        """The DONE of every finished run."""
        runs = self.out / "runs"
        return [*runs.glob("case-*/DONE"), *runs.glob("shared-*/case-*/DONE")]

    def processes(self) -> list[int]:
        """Processes of the batch, without this one."""
        here, numbers = str(self.folder).encode(), []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                if here in path.read_bytes() and path.parent.name != str(os.getpid()):
                    numbers.append(int(path.parent.name))
        return numbers


def wait(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)
