r"""Draw the picture of docs/theory.md on a bond that breaks.

./mantle run configs/debonding.yaml -o out/d6
./mantle run configs/debonding.yaml --set mesh.size="4 mm" -o out/d4
./mantle shell -c 'python3 docs/debonding.py out/d6 out/d4'
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from app.plots.curves import curve
from app.plots.figures import grid, panels
from app.results.reading import Run

FIGURE = Path(__file__).with_name("debonding.png")
PLACE = "cement_bone"
# Directions around the shaft: x is medial, y anterior.
SIDES = {-180: "lateral", -90: "posterior", 0: "medial", 90: "anterior", 180: "lateral"}


def main(folders: list[Path]) -> None:
    """Damaged area over the load of each run; where the damage of the last one is."""
    figure, (left, right) = panels(2, 2, 4.8, 3.6)
    for k, folder in enumerate(folders):
        run = Run(folder)
        area = run.history[f"{PLACE} area_damaged [mm^2]"]
        size = run.summary["interfaces"][PLACE]["facet_size"]
        label = f"facets of {size:.1f} mm"
        curve(left, [100 * t for t in run.history["time [-]"]], list(area), k, label)
    left.set_title("damaged area of the bond", fontsize=11, loc="left")
    left.set_xlabel("load (% of the stance)")
    left.set_ylabel("area (mm²)")
    left.legend(frameon=False)
    grid(left)
    on = run.on_interface(PLACE)
    x, damage = run.points[on], run.at_interface(PLACE, "damage")[on]
    angle = np.degrees(np.arctan2(x[:, 1], x[:, 0]))
    order = np.argsort(damage)
    dots = right.scatter(
        angle[order], x[order, 2], c=damage[order], s=34, marker="s", cmap="YlOrRd", vmin=0
    )
    right.set_facecolor("0.93")
    right.set_xticks(list(SIDES), list(SIDES.values()), fontsize=8)
    right.set_ylabel("height z (mm)")
    right.set_title("damage at the full load, finest mesh", fontsize=11, loc="left")
    figure.colorbar(dots, ax=right)
    figure.savefig(FIGURE, dpi=110)


if __name__ == "__main__":
    main([Path(folder) for folder in sys.argv[1:]])
