"""A ball that oscillates in its cup: wear, torque and friction heat of a cycle."""

from __future__ import annotations

import numpy as np

from app.foundation.arrays import Floats
from app.results.reading import Run
from meshes.data import exterior_facets
from tests import support

RADIUS = 14.0  # of the ball [mm]
FRICTION = 0.06  # friction coefficient
WEAR = 1.07e-9  # wear coefficient [mm2/N]
LOAD = 2000.0  # along z [N]

TABLE = '["time [s], rotation y [deg]", "0, 0", "0.3, 20", "0.7, -10", "1, 0"]'

WORN = "finite, wear_coefficient: 1.07e-6 mm^3/(N m)"

CASE = f"""{support.HEAD_CUP.replace("finite", WORN)}
motions:
  ball: {{region: head, about: [0 mm, 0 mm, 0 mm], rotation: {{axes: yxz, cycle_table: {TABLE}}}}}
loads: {{hip: {{kind: force, boundary: head_surface, force: [0 N, 0 N, {LOAD} N]}}}}
stages: [{{name: press}}, {{name: turn, increments: 10, cycles: 2}}]
output: {{report: false}}
"""


def areas(run: Run, name: str) -> Floats:
    """Area of the nodes (n,) [mm2] of a region's surface that is within 1 mm of the ball's."""
    cells = run.cells[run.region == run.regions[name]]
    facets, _ = exterior_facets(cells)
    x = run.points[facets]
    facets = facets[(np.abs(np.linalg.norm(x, axis=2) - RADIUS) < 1).all(axis=1)]
    return run.area_by_node(facets)


SHARE = 0.7  # of the friction heat, into the head
NECK = 0.05  # heat transfer at the neck [mW/(mm2 K)]
SHELL = 0.02  # heat transfer at the shell [mW/(mm2 K)]
OUTSIDE = 20.0  # of neck and shell [degC]


def heated(k: tuple[float, float], conductance: str, *changes: str) -> list[str]:
    """Changes of CASE for conductivities of head and liner [W/(m K)], with surroundings."""
    given = "density: 1000 kg/m^3, specific_heat: 1000 J/(kg K), initial_temperature: 37 degC"
    out = "{{kind: convection, boundary: {}, coefficient: {} W/(m^2 K), ambient: {} degC}}"
    return [
        *changes,
        f"regions.head.thermal={{conductivity: {k[0]} W/(m K), {given}}}",
        f"regions.liner.thermal={{conductivity: {k[1]} W/(m K), {given}}}",
        f"interfaces.bearing.conductance={conductance}",
        f"heat.neck={out.format('head_bore', 1e3 * NECK, OUTSIDE)}",
        f"heat.shell={out.format('liner_outer', 1e3 * SHELL, OUTSIDE)}",
    ]


# Three steps of turning and a minute of warming.
WARM = heated(
    (14, 0.4),
    "5000 W/(m^2 K)",
    "stages=[{name: press}, {name: turn, increments: 3}, {name: warm, duration: 60 s}]",
    "loads.hip.force=[300 N, 200 N, 2000 N]",
    "motions.ball.largest_step=20 deg",
    "time={first_step: 5 s, tolerance: 1 K}",
    f"interfaces.bearing.friction_heating={SHARE}",
)
