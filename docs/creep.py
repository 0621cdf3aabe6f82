r"""Draw the picture of docs/theory.md on a taper that sinks as its cement creeps.

./mantle run configs/creep_taper.yaml -o out/creep_taper
./mantle shell -c 'python3 docs/creep.py out/creep_taper'
"""

from __future__ import annotations

import sys
from pathlib import Path

from app.plots.curves import Line, Panel, draw
from app.plots.figures import PNG
from app.results.reading import Results

FIGURE = Path(__file__).with_name("creep.png")
# Mean subsidence of polished stems of patients [mm] by years (Baryeh 2021), at 1e6 cycles a year.
PATIENTS = {1: 0.97, 2: 1.07, 5: 1.47, 10: 1.61}


def main(folder: Path) -> None:
    """Draw subsidence and mean pressure over cycles, by friction."""
    subsidence: list[Line] = []
    pressure: list[Line] = []
    for k, run in enumerate(Results(folder).variations.values()):
        h = run.step_record
        crept = h["creep cycles [-]"] > 0
        cycles = h["creep cycles [-]"][crept].tolist()
        sunk = h["stem subsidence [mm]"]
        friction = run.case["interfaces"]["stem_cement"].get("friction_coefficient")
        label = "bonded" if friction is None else f"friction {friction:g}"
        subsidence.append(Line(label, k, cycles, sunk[crept].tolist()))
        elastic = [float(sunk[0])] * 2
        subsidence.append(Line("", k, [cycles[0], cycles[-1]], elastic, look="dotted"))
        if friction is not None:
            values = h["stem_cement pressure_p95 [MPa]"][crept].tolist()
            pressure.append(Line(label, k, cycles, values))
    years = [1e6 * year for year in PATIENTS]
    subsidence.append(Line("patients", 0, years, list(PATIENTS.values()), look="bars"))
    x = "cycles of walking"
    panels = [
        Panel("subsidence (mm); dotted: elastic", "mm", subsidence, x, log="x"),
        Panel("pressure on the cement, p95", "MPa", pressure, x, log="x"),
    ]
    draw(FIGURE, panels, 2, suffixes=PNG)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
