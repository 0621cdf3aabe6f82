r"""Draw the picture of docs/theory.md on the strength of the bond of cement and bone.

./mantle run configs/interface_strength.yaml -o out/strength
./mantle shell -c 'python3 docs/strength.py out/strength'
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import mantle
from app.foundation.arrays import Floats
from app.plots import figures
from app.plots.curves import Line, Panel, draw_panel
from app.plots.figures import HEAT_COLOURS, PNG
from app.results.reading import Run

FIGURE = Path(__file__).with_name("interface_strength.png")
MOST_TIMES = 6.0  # times the stance, at the end
BONDS = {"bonded": "rigid", "layer_150": "150 MPa/mm", "layer_30": "30 MPa/mm"}


def first_failure(run: Run, rows: list[int]) -> Floats:
    """Multiple of the stance at which nodes begin to fail, infinite where they do not (n,)."""
    if "cement_bone_damage" not in run.point_fields:
        with np.errstate(divide="ignore"):
            multiple = MOST_TIMES / run.at_interface("cement_bone", "failure_index")[rows]
        return np.where(multiple > MOST_TIMES, np.inf, multiple)
    damage = [run.at_interface("cement_bone", "damage", k)[rows] for k in range(len(run.times))]
    multiples = MOST_TIMES * np.append(run.times, np.inf)
    return np.asarray(multiples[np.argmax([*(d > 0 for d in damage), damage[0] >= 0], axis=0)])


def main(folder: Path) -> None:
    """Share of the interface that fails over the load, and where it fails first."""
    runs = {name: mantle.read(folder / name).fields for name in BONDS}
    layer = runs["layer_150"]
    nodes = np.flatnonzero(layer.areas("cement_bone"))
    area = layer.areas("cement_bone")[nodes]
    lines: list[Line] = []
    figure, (share, *maps) = figures.figure_of_panels(4, 4, 3.0, 3.6)
    for k, (name, run) in enumerate(runs.items()):
        place = {tuple(x): row for row, x in enumerate(run.points.round(6))}
        at = first_failure(run, [place[tuple(x)] for x in layer.points[nodes].round(6)])
        at_load = np.linspace(0, MOST_TIMES, 121 if name == "bonded" else 13)
        failed = [100 * area[at <= load].sum() / area.sum() for load in at_load]
        lines.append(Line(BONDS[name], k, at_load.tolist(), failed, look="line"))
        x, y, z = layer.points[nodes].T
        angle, fails = np.degrees(np.arctan2(y, x)), np.isfinite(at)
        maps[k].scatter(angle[~fails], z[~fails], c="0.85", s=22, marker="s")
        drawn = maps[k].scatter(
            angle[fails],
            z[fails],
            c=at[fails],
            s=22,
            marker="s",
            cmap=HEAT_COLOURS,
            vmin=0,
            vmax=MOST_TIMES,
        )
        figures.set_title(maps[k], BONDS[name])
        maps[k].set_xticks([-180, -90, 0, 90, 180], ["lat.", "post.", "med.", "ant.", "lat."])
    maps[0].set_ylabel("height z (mm)")
    figure.colorbar(drawn, ax=maps, label="begins to fail at (times the stance)")
    draw_panel(share, Panel("failing part", "%", lines, "load (times the stance)", log=""))
    share.legend(frameon=False, title="bond")
    figures.save_figure(figure, FIGURE, 110, PNG)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
