"""Compile what the shipped cases need: ``python3 -m app.warm``, when an image is built.

Compiled forms depend on materials, laws and orders, not on the mesh: each case is set up, not
solved, with elements of first and second order. Each in a process of its own, as when it is run:
the names of compiled expressions depend on what a process has made before them.
"""

from __future__ import annotations

import logging
import subprocess
import sys
import time
from pathlib import Path

from mpi4py import MPI

import numpy as np

from app import config
from app.model import Model
from app.timing import Timing

log = logging.getLogger("mantle")

CASES = Path(__file__).resolve().parents[1] / "configs"
ORDERS = (1, 2)
COARSER = 2.0


def warm(path: Path, order: int) -> None:
    """Set a case up on a coarse mesh with elements of an order."""
    mesh = config.load(path).mesh
    sizes = {"size": mesh.size, "far_size": mesh.far_size}
    overrides = [f"mesh.order={order}", "output.error=false"]
    overrides += [f"mesh.{name}={COARSER * size} mm" for name, size in sizes.items() if size]
    case = config.load(path, overrides)
    model = Model(case, MPI.COMM_SELF, {}, Timing(), str)
    for m in model.mechanics:
        m.balance(np.zeros(3))


def main() -> None:
    """Set all cases up that stand in the folder of cases itself."""
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    for path in sorted(CASES.glob("*.yaml")):
        for order in ORDERS:
            begin = time.perf_counter()
            subprocess.run([sys.executable, "-m", "app.warm", path, str(order)], check=True)
            log.info("%s, order %d: %.1f s", path.stem, order, time.perf_counter() - begin)


if __name__ == "__main__":
    if sys.argv[1:]:
        warm(Path(sys.argv[1]), int(sys.argv[2]))
    else:
        main()
