r"""Draw the picture of docs/howto/head_cup.md: torque through a cycle, and where the liner wears.

./mantle run configs/head_cup.yaml -o out/head_cup
./mantle shell -c 'python3 docs/head_cup.py out/head_cup'
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from app.plots import figures
from app.plots.curves import Line, Panel, draw_panel
from app.plots.figures import LOADED, PNG
from app.results.reading import Run

FIGURE = Path(__file__).with_name("head_cup.png")
PLACE = "bearing"


def main(folder: Path) -> None:
    """Friction torque with that of a hand formula; wear depth and pressure on the liner."""
    run = Run(folder)
    figure, (left, middle, right) = figures.figure_of_panels(3, 3, 4.2, 3.6)
    h, radius = run.step_record, float(run.case["geometry"]["head_diameter"].split()[0]) / 2
    friction = run.case["interfaces"][PLACE]["friction_coefficient"]
    part = h["time [-]"] - (len(run.case["stages"]) - 1)
    on = part > 0
    force = np.sqrt(sum(h[f"{PLACE} force.{axis} [N]"] ** 2 for axis in "xyz"))
    torque = h[f"{PLACE} torque_size [N mm]"]
    percent = (100 * part[on]).tolist()
    by_hand = 1e-3 * friction * radius * force[on]
    lines = [
        Line("finite elements", 0, percent, (1e-3 * torque[on]).tolist()),
        Line("μ F R", 1, percent, by_hand.tolist()),
    ]
    draw_panel(left, Panel("friction torque", "N m", lines, "part of the cycle (%)", log=""))
    left.set_ylim(bottom=0.0)
    left.legend(frameon=False, loc="center right", fontsize=8)
    body = np.isin(np.arange(len(run.points)), run.cells[run.region == run.regions["liner"]])
    at = body & run.on_interface(PLACE) & (run.points[:, 2] > 0)  # from above once
    x = run.points[at]
    peak = int(
        np.argmax([run.at_interface(PLACE, "pressure", k).max() for k in range(len(run.times))])
    )
    fields = {
        "wear depth per million cycles (mm)": 1e6 * run.at_interface(PLACE, "wear")[at],
        "pressure when it is largest (MPa)": run.at_interface(PLACE, "pressure", peak)[at],
    }
    for axes, (title, values) in zip((middle, right), fields.items(), strict=True):
        filled = axes.tricontourf(x[:, 0], x[:, 1], values, 14, cmap=LOADED)
        figures.set_title(axes, title)
        axes.set_xlabel("medial x (mm)")
        axes.set_ylabel("anterior y (mm)")
        axes.set_aspect("equal")
        figure.colorbar(filled, ax=axes)
    figures.save_figure(figure, FIGURE, 110, PNG)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
