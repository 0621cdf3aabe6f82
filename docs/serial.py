"""CPU seconds of the serial parts of a run, start and page, compared with another checkout.

    ./mantle run configs/stance.yaml -o out/stance
    ./mantle shell -c 'python3 docs/serial.py out/stance ../older'   # measure into docs/serial.json
    ./mantle shell -c 'python3 docs/serial.py'                       # print the table

The checkouts take turns. A figure is the smallest of `TIMES`, as other processes only slow one
down; a ratio is the median of those of the turns. The start has all imports of a run of a hip and
its checked case; `libraries` is the part of it that imports what is not mantle's. The page is that
of a run of `SHORT` seconds, which has no maps of the interfaces, and that of a run of `LONG`.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from app import extensions  # noqa: F401  (registers keys that cases have)
from app.foundation.layout import text_table

ROOT = Path(__file__).resolve().parents[1]
KEPT = Path(__file__).with_suffix(".json")
TIMES = 5
SHORT = 16.0  # s
LONG = 60.0  # s
LIBRARIES = """
from time import process_time

import numpy, pydantic, ruamel.yaml, petsc4py
petsc4py.init(["mantle", "-skip_petscrc"])
from mpi4py import MPI
import dolfinx.fem.petsc, h5py, scipy.linalg, scipy.sparse, scipy.spatial
print(process_time())
"""
START = """
import sys
from pathlib import Path
from time import process_time

from app.cli import main
from app.case.case import load_case

case = load_case(Path("configs/stance.yaml")).config
import petsc4py
petsc4py.init(["mantle", "-skip_petscrc"])
import app.numerics.condensed, app.simulation.session, meshes.gruen
case.geometry.placement
start = process_time()
"""
PAGE = """
from app.report import run_report

run_report.write(Path(sys.argv[1]), run_report.SHARE)
print(process_time() - start)
"""
PROGRAMS = {
    "libraries": (LIBRARIES, SHORT),
    "start": (f"{START}print(start)", SHORT),
    "page": (START + PAGE, SHORT),
    "page with maps": (START + PAGE, LONG),
}


def seconds(checkout: Path, program: str, run: Path, total: float) -> float:
    """CPU seconds that a program prints, on a run's folder without its page."""
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for path in run.iterdir():
            if path.suffix not in (".png", ".html"):
                (folder / path.name).symlink_to(path.resolve())
        summary = json.loads((run / "summary.json").read_text())
        summary["timing"]["total"] = total
        (folder / "summary.json").unlink()
        (folder / "summary.json").write_text(json.dumps(summary))
        done = subprocess.run(
            [sys.executable, "-c", program, folder],
            cwd=checkout,
            env={**kept, "PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"},
            check=True,
            capture_output=True,
            text=True,
        )
    return float(done.stdout.split()[-1])


def measure(run: Path, before: Path) -> None:
    """Measure both checkouts in turn and keep the figures."""
    figures: dict[str, dict[str, float]] = {}
    for name, (program, total) in PROGRAMS.items():
        turns = [
            [seconds(checkout.resolve(), program, run, total) for checkout in (before, ROOT)]
            for _ in range(TIMES)
        ]
        old, new = (min(times) for times in zip(*turns, strict=True))
        ratio = median(now / then for then, now in turns)
        figures[name] = {"before": round(old, 3), "now": round(new, 3), "ratio": round(ratio, 3)}
    KEPT.write_text(json.dumps(figures, indent=1) + "\n")


def main() -> None:
    """Measure, or print."""
    if len(sys.argv) > 1:
        measure(*map(Path, sys.argv[1:]))
    rows = [[name, *row.values()] for name, row in json.loads(KEPT.read_text()).items()]
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    logging.info("%s", text_table(["CPU seconds", "before", "now", "ratio"], rows))


if __name__ == "__main__":
    main()
