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

from app.case.quantities import TENSION_LEVELS
from app.plots.curves import Line, Panel, draw
from app.plots.figures import PNG

FIGURE = Path(__file__).with_name("fatigue.png")


def main(folders: list[Path]) -> None:
    """Draw volume over tension, and damage by law, of each run."""
    volumes: list[Line] = []
    damages: list[Line] = []
    names: dict[float, str] = {}
    for k, folder in enumerate(folders):
        summary = json.loads((folder / "summary.json").read_text())
        label = f"mantle of {summary['mantle']['thickness']['nominal']:g} mm"
        cement = summary["regions"]["cement"]
        keys = [f"volume_over_{level}_MPa" for level in TENSION_LEVELS]
        values = [cement[key] for key in keys]
        errors = [cement.get(f"{key}_error", 0.0) for key in keys]
        volumes.append(Line(label, k, [float(level) for level in TENSION_LEVELS], values, errors))
        laws = summary["fatigue"]
        names = {float(i): name.capitalize() for i, name in enumerate(laws)}
        damage = [law["damage_p99"] for law in laws.values()]
        errors = [law.get("damage_p99_error", 0.0) for law in laws.values()]
        damages.append(Line(label, k, list(names), damage, errors, "points"))
    panels = [
        Panel("cement under tension, stumbling", "volume (mm³)", volumes, "tension (MPa)", log=""),
        Panel("damage in a year, p99", "1/year", damages, log="", ticks=names),
    ]
    draw(FIGURE, panels, 2, suffixes=PNG)


if __name__ == "__main__":
    main([Path(folder) for folder in sys.argv[1:]])
