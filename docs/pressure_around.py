r"""Draw the pressure on the stem around three sections of the stance, for docs/verification.md.

./mantle shell -c 'python3 docs/pressure_around.py'

On three meshes: few lines around and means over the areas of points; the default; the reference of
`error_estimate.py`. Five minutes and 8 GB.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from app.foundation.arrays import Floats
from app.plots.curves import Line, Panel, draw
from app.plots.figures import PNG
from app.results.interface_numbers import ContactSamples
from tests import support

FIGURE = Path(__file__).with_name("pressure_around.png")
LEVELS = (-20.0, -55.0, -90.0)  # of the sections [mm]
# Names of angles [deg].
WAYS = {0.0: "medial", 90.0: "anterior", 180.0: "lateral", 270.0: "posterior", 360.0: ""}
# Overrides of the stance, and whether the means are drawn in place of the point values.
MESHES: dict[str, tuple[tuple[str, ...], bool]] = {
    "4 mm, 14 lines, means": (("mesh.size=4 mm", "mesh.around=14"), True),
    "6 mm, 36 lines, point values": (("mesh.size=6 mm",), False),
    "3.2 mm, 57 lines, point values": (("mesh.size=3.2 mm", "mesh.around=57"), False),
}


def around(samples: ContactSamples, means: bool, z: float) -> tuple[Floats, Floats]:
    """Angle from medial towards anterior [deg] and pressure [MPa] in a section of the stem."""
    surface, traction = samples.surfaces[0], samples.tractions[0]["pressure"]
    values = (traction.mean if means else traction.value)[:, 0][surface.triangles]
    x = surface.corners
    curves = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        part = (z - x[:, a, 2]) / np.where(
            x[:, b, 2] == x[:, a, 2], np.inf, x[:, b, 2] - x[:, a, 2]
        )
        cut = (part > 0) & (part <= 1)
        at = x[cut, a] + part[cut, None] * (x[cut, b] - x[cut, a])
        p = values[cut, a] + part[cut] * (values[cut, b] - values[cut, a])
        curves.append(np.column_stack([np.rad2deg(np.arctan2(at[:, 1], at[:, 0])) % 360, p]))
    angle, pressure = np.concatenate(curves).T
    order = np.argsort(angle)
    return angle[order], pressure[order]


def main() -> None:
    """Solve and draw."""
    around_the_stem: dict[float, list[Line]] = {z: [] for z in LEVELS}
    text = (support.CONFIGS / "stance.yaml").read_text(encoding="utf-8")
    for k, (label, (overrides, means)) in enumerate(MESHES.items()):
        solved = support.solve(text, "stages.0.increments=1", *overrides)
        for z, lines in around_the_stem.items():
            angle, pressure = around(solved.last, means, z)
            lines.append(Line(label, k, angle.tolist(), pressure.tolist(), look="line"))
    panels = [
        Panel(f"pressure on the stem at z = {z:g} mm", "MPa", lines, log="", ticks=WAYS)
        for z, lines in around_the_stem.items()
    ]
    draw(FIGURE, panels, 1, (9.0, 2.6), PNG)


if __name__ == "__main__":
    main()
