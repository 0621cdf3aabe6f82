r"""Draw the picture of docs/theory.md on a taper that sinks as its cement creeps.

./mantle run configs/creep_taper.yaml -o out/creep_taper
./mantle shell -c 'python3 docs/creep.py out/creep_taper'
"""

from __future__ import annotations

import sys
from pathlib import Path

from app.plots.figures import COLOURS, MARKERS, grid, panels
from app.results.reading import Results

FIGURE = Path(__file__).with_name("creep.png")
# Mean subsidence of polished stems of patients [mm] by years (Baryeh 2021), at 1e6 cycles a year.
PATIENTS = {1: 0.97, 2: 1.07, 5: 1.47, 10: 1.61}


def main(folder: Path) -> None:
    """Subsidence and mean pressure over cycles, by friction."""
    figure, (left, right) = panels(2, 2, 4.8, 3.6)
    for k, run in enumerate(Results(folder).variations.values()):
        h = run.history
        crept = h["creep cycles [-]"] > 0
        cycles = h["creep cycles [-]"][crept]
        law = run.case["interfaces"]["stem_cement"]
        friction = law.get("friction_coefficient")
        label = "bonded" if friction is None else f"friction {friction:g}"
        style = {"color": COLOURS[k], "marker": MARKERS[k], "ms": 4, "lw": 1.4, "label": label}
        left.plot(cycles, h["stem subsidence [mm]"][crept], **style)
        left.axhline(h["stem subsidence [mm]"][0], color=COLOURS[k], lw=0.7, ls=":")
        if friction is not None:
            right.plot(cycles, h["stem_cement pressure_p95 [MPa]"][crept], **style)
    years = [1e6 * year for year in PATIENTS]
    left.plot(years, PATIENTS.values(), "k_-", lw=1, ms=9, label="patients")
    left.set_title("subsidence (mm); dotted: elastic", fontsize=11, loc="left")
    right.set_title("pressure on the cement, p95 (MPa)", fontsize=11, loc="left")
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_xlabel("cycles of walking")
        axes.set_ylim(bottom=0)
        grid(axes)
    left.legend(frameon=False, fontsize=8, ncol=2, loc="center left", bbox_to_anchor=(0, 0.58))
    figure.savefig(FIGURE, dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
