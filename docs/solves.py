"""Time over number of solves for both ways of contact: figure and table of docs/verification.md.

    ./mantle shell -c 'python3 docs/solves.py 2 "4 mm" condensed'   # measure into docs/solves.json
    ./mantle shell -c 'python3 docs/solves.py'                      # print the table, draw

CPU seconds of one core: assembly, set-up, the stance's whole load, then the hip's force by a tenth
more in each of three steps. Later solves are the mean of these three.
"""

from __future__ import annotations

import json
import logging
import sys
from itertools import groupby, pairwise
from pathlib import Path
from time import process_time
from typing import Any

from mpi4py import MPI

from app import extensions  # noqa: F401  (registers keys that cases have)
from app.case.case import load_case
from app.foundation.layout import text_table
from app.numerics.choice import SolverChoice
from app.plots import figures
from app.plots.figures import COLOURS, PNG
from app.simulation.model import Model
from app.system.timing import Timing
from app.verification.cost_figures import FEMUR, STANCE, STEPS
from app.verification.problem import CONFIGS

KEPT = Path(__file__).with_suffix(".json")
FIGURE = Path(__file__).with_suffix(".png")
COUNTS = (1, 4, 24)
HEAD = (
    *("order", "size", "unknowns", "solves", "condensed", "Krylov"),
    *("chosen", "over the better"),
)


def measure(order: str, size: str, way: str) -> dict[str, Any]:
    """Times of one way on one mesh."""
    keys = (f"mesh.order={order}", f"mesh.size={size}", f"solver.linear={way}")
    case = load_case(CONFIGS / FEMUR, [*STANCE, *STEPS, *keys]).config
    timing, begin, ends = Timing(), process_time(), [0.0]
    model = Model(case, MPI.COMM_WORLD, {}, timing, str)
    model.run(lambda *_: ends.append(process_time() - begin))
    assert model.mechanics
    ends[0] = sum(timing.cpu.get(phase, 0.0) for phase in ("mesh", "compile"))
    first, *later = (b - a for a, b in pairwise(ends))
    times = {"first": round(first, 2), "later": round(sum(later) / len(later), 3)}
    return {"order": int(order), "size": size, "way": way, **model.sizes(), **times}


def main() -> None:
    """Measure, or print and draw."""
    known = json.loads(KEPT.read_text()) if KEPT.exists() else []
    if len(sys.argv) > 1:
        new = measure(*sys.argv[1:])
        key = lambda r: (r["order"], -float(r["size"].split()[0]), r["way"])  # noqa: E731
        kept = [r for r in known if key(r) != key(new)]
        rows = sorted([*kept, new], key=key)
        KEPT.write_text("[\n " + ",\n ".join(map(json.dumps, rows)) + "\n]\n")
        return
    lines = []
    meshes = [list(rows) for _, rows in groupby(known, lambda r: (r["order"], r["size"]))]
    figure, every = figures.figure_of_panels(len(meshes), 4, 3.1, 2.7)
    for axes, ways in zip(every, meshes, strict=True):
        row = ways[0]  # condensed
        unknowns = f"{row['displacement'] + row['jump']:,}"
        for way, colour, label in zip(ways, COLOURS, ("condensed", "Krylov method"), strict=False):
            times = [_total(way, n) for n in range(1, 101)]
            axes.loglog(range(1, 101), times, color=colour, lw=1.8, label=label)
        for n in COUNTS:
            sizes = row["order"], row["displacement"], row["jump"], n
            took = [_total(r, n) for r in ways]
            chosen = not SolverChoice(*sizes).condenses("auto")
            axes.plot(n, took[chosen], "o", color="black", ms=5, zorder=4)
            each = [f"{seconds:.3g}" for seconds in took]
            over = f"{took[chosen] / min(took):.2f}"
            lines.append((row["order"], row["size"], unknowns, n, *each, ways[chosen]["way"], over))
        axes.set_title(f"order {row['order']}, {row['size']}: {unknowns} unknowns", fontsize=8)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_major_formatter("{x:g}")
        figures.grid(axes)
    every[0].legend(fontsize=8)
    figure.supxlabel("solves on one mesh", fontsize=9)
    figure.supylabel("CPU time (s)", fontsize=9)
    figures.save_figure(figure, FIGURE, 110, PNG)
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    logging.info("%s", text_table(HEAD, lines))


def _total(row: dict[str, Any], solves: int) -> float:
    return float(row["first"] + (solves - 1) * row["later"])


if __name__ == "__main__":
    main()
