r"""Draw the picture of docs/theory.md on a bond that breaks.

./mantle run configs/debonding.yaml -o out/d6
./mantle run configs/debonding.yaml --set mesh.size="4 mm" -o out/d4
./mantle shell -c 'python3 docs/debonding.py out/d6 out/d4'
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from app.plots import figures
from app.plots.curves import Line, Panel, draw_panel
from app.plots.figures import LOADED, PNG
from app.results.reading import Run

FIGURE = Path(__file__).with_name("debonding.png")
PLACE = "cement_bone"
# Directions around the shaft: x is medial, y anterior.
SIDES = {-180: "lateral", -90: "posterior", 0: "medial", 90: "anterior", 180: "lateral"}


def main(folders: list[Path]) -> None:
    """Damaged area over the load of each run; where the damage of the last one is."""
    figure, (left, right) = figures.figure_of_panels(2, 2, 4.8, 3.6)
    lines: list[Line] = []
    for k, folder in enumerate(folders):
        run = Run(folder)
        area = run.step_record[f"{PLACE} area_damaged [mm^2]"]
        size = run.summary["interfaces"][PLACE]["facet_size"]
        label = f"facets of {size:.1f} mm"
        load = [100 * t for t in run.step_record["time [-]"]]
        lines.append(Line(label, k, load, area.tolist()))
    x_of_load = "load (% of the stance)"
    draw_panel(left, Panel("damaged area of the bond", "area (mm²)", lines, x_of_load, log=""))
    left.legend(frameon=False)
    on = run.on_interface(PLACE)
    x, damage = run.points[on], run.at_interface(PLACE, "damage")[on]
    angle = np.degrees(np.arctan2(x[:, 1], x[:, 0]))
    order = np.argsort(damage)
    dots = right.scatter(
        angle[order], x[order, 2], c=damage[order], s=34, marker="s", cmap=LOADED, vmin=0
    )
    right.set_facecolor("0.93")
    right.set_xticks(list(SIDES), list(SIDES.values()), fontsize=8)
    right.set_ylabel("height z (mm)")
    figures.set_title(right, "damage at the full load, finest mesh")
    figure.colorbar(dots, ax=right)
    figures.save_figure(figure, FIGURE, 110, PNG)


if __name__ == "__main__":
    main([Path(folder) for folder in sys.argv[1:]])
