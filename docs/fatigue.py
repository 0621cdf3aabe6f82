r"""Draw the picture of docs/theory.md on the fatigue of two mantles.

./mantle run configs/fatigue.yaml --set mesh.size="4 mm" -o out/f4
./mantle run configs/fatigue.yaml --set mesh.size="4 mm" \
    --set geometry.cement_thickness="2 mm" -o out/f2
./mantle shell -c 'python3 docs/fatigue.py out/f4 out/f2'
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from app.case.quantities import STRESSED
from app.plots.figures import COLOURS, MARKERS, grid, panels

FIGURE = Path(__file__).with_name("fatigue.png")


def numbers(q: dict[str, Any], keys: list[str]) -> tuple[list[float], list[float]]:
    """Numbers of a section and their errors; 0 where none is known."""
    return [q[key] for key in keys], [q.get(f"{key}_error", 0.0) for key in keys]


def main(folders: list[Path]) -> None:
    """Volume over tension, and damage by law, of each run."""
    figure, (left, right) = panels(2, 2, 4.8, 3.4)
    for k, folder in enumerate(folders):
        summary = json.loads((folder / "summary.json").read_text())
        own: dict[str, Any] = {
            "color": COLOURS[k],
            "marker": MARKERS[k],
            "capsize": 3,
            "label": f"mantle of {summary['mantle']['thickness']['nominal']:g} mm",
        }
        keys = [f"volume_over_{level}_MPa" for level in STRESSED]
        left.errorbar(STRESSED, *numbers(summary["regions"]["cement"], keys), lw=1.6, **own)
        laws = summary["fatigue"]
        for i, law in enumerate(laws.values()):
            right.errorbar([i + 0.16 * (k - 0.5)], *numbers(law, ["damage_p99"]), ls="", **own)
        right.set_xticks(range(len(laws)), [name.capitalize() for name in laws])
    left.set_title("cement under tension, stumbling", fontsize=11, loc="left")
    left.set_xlabel("tension (MPa)")
    left.set_ylabel("volume above it (mm³)")
    left.set_ylim(bottom=0)
    left.legend(frameon=False)
    right.set_title("damage in a year, 99th percentile", fontsize=11, loc="left")
    right.set_ylabel("1/year")
    right.set_ylim(bottom=0)
    right.set_xlim(-0.6, len(laws) - 0.4)
    grid(left)
    grid(right, "y")
    figure.savefig(FIGURE, dpi=110)


if __name__ == "__main__":
    main([Path(folder) for folder in sys.argv[1:]])
