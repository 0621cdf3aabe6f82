r"""Draw the picture of docs/theory.md on two years of bone around two stems.

for size in 6 8; do
    ./mantle run configs/remodelling.yaml --set mesh.size="$size mm" -o out/ti$size
    ./mantle run configs/remodelling.yaml --set mesh.size="$size mm" \
        --set regions.stem.material=CoCrMo -o out/cocr$size
done
./mantle shell -c 'python3 docs/remodelling.py out'
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from app.plots import figures
from app.plots.figures import PNG, SIGNED
from app.results.reading import Run

FIGURE = Path(__file__).with_name("remodelling.png")
STEMS = {"ti": "titanium", "cocr": "cobalt-chromium"}
# Size of a pixel [mm].
PIXEL = 2.0
# Points in a cell.
POINTS = 40
# Largest change that is coloured [g/cm2].
LARGEST = 0.25
# Change in a year, 88 cemented hips (PMC2899162, abstract), and of zone 7 in five.
MEASURED = {"1": (-0.020,), "7": (-0.115, -0.129)}


def seen_from_the_front(axes: Any, run: Run) -> Any:
    """Change of the density along lines of sight from anterior [g/cm2], as in radiographs."""
    change = run.on_cells("density") - run.on_cells("density", "stance")
    shares = np.random.default_rng(0).dirichlet(np.ones(4), POINTS)
    x = np.einsum("pn,cni->cpi", shares, run.points[run.cells[:, :4]])[..., [0, 2]].reshape(-1, 2)
    weight = np.repeat(change * run.volumes() / POINTS, POINTS)
    low, high = run.points[:, [0, 2]].min(axis=0), run.points[:, [0, 2]].max(axis=0)
    edges = [np.arange(a, b + PIXEL, PIXEL) for a, b in zip(low, high, strict=True)]
    grams = np.histogram2d(*x.T, edges, weights=weight)[0] / PIXEL**2 / 10
    there = np.histogram2d(*x.T, edges)[0] > 0
    axes.set_aspect("equal")
    axes.set_axis_off()
    shown = np.where(there, grams, np.nan).T
    limits = {"vmin": -LARGEST, "vmax": LARGEST, "cmap": SIGNED}
    return axes.pcolormesh(*edges, shown, rasterized=True, **limits)


def main(folder: Path) -> None:
    """Both stems from the front, and the change by Gruen zone on two meshes."""
    figure = figures.new(11.0, 4.6)
    *maps, bars = figure.subplots(1, 3, width_ratios=(1, 1, 3.4))
    for k, (name, words) in enumerate(STEMS.items()):
        colours = seen_from_the_front(maps[k], Run(folder / f"{name}6"))
        maps[k].set_title(words, fontsize=11)
        for size, marker in ((6, "o"), (8, "x")):
            run = Run(folder / f"{name}{size}")
            zones = run.summary["gruen"]
            for n, part in enumerate(("all", "cortical_bone")):
                change = [100 * zones[str(z)]["bone_mass_change"][part] for z in range(1, 8)]
                at = np.arange(1, 8) + 0.18 * (2 * k + n - 1.5)
                style = {"color": figures.colour(k), "ls": "", "marker": marker, "ms": 7 - n}
                style |= {"mfc": "none"} if n else {}
                label = f"{words}, {'cortex' if n else 'all bone'}" if size == 6 else None
                bars.plot(at, change, label=label, **style)
    for zone, values in MEASURED.items():
        width = {"lw": 2, "color": "0.2", "label": "measured" if zone == "1" else None}
        for value in values:
            bars.plot([int(zone) - 0.42, int(zone) + 0.42], [100 * value] * 2, **width)
    bars.axhline(0, color="0.6", lw=0.8)
    bars.set_xlabel("Gruen zone")
    bars.set_ylabel("mass of bone after two years (%)")
    bars.legend(frameon=False, fontsize=9, loc="lower left", ncols=2)
    figures.grid(bars, "y")
    label = "change along the line of sight (g/cm²)"
    figure.colorbar(colours, ax=maps, location="bottom", label=label, shrink=0.9)
    figures.save_figure(figure, FIGURE, 110, PNG)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
