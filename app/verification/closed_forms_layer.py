r"""Problems of ``mantle verify`` on an elastic layer in series with contact, with closed forms.

With the stiffnesses :math:`k_n, k_t` and pushed along by d under a pressure p, the layer bears
:math:`k_t d` up to :math:`μ p` and slips by the rest, :math:`d - μ p / k_t`, which dissipates
:math:`μ p` on the way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from app.results.reading import Run
from app.verification.check import Check, Sample, problem
from app.verification.measures import number, relative

ACROSS, ALONG, LIMIT = 150.0, 130.0, 0.9  # of layer.yaml: MPa/mm, MPa/mm, MPa
PRESS, PUSH, AREA = 0.02, 0.02, 16.0  # mm, mm, mm2
SLIP = PUSH - LIMIT / ALONG


def at(run: Run, key: str, time: float, reference: float) -> Sample:
    """A number of history.csv of the layer at the end of a stage."""
    times, name = run.history["time [-]"], f"wall_bar {key}"
    return relative(float(run.history[name][np.argmin(np.abs(times - time))]), reference)


def held(x: float, z: float) -> tuple[str, ...]:
    """Changes of the case to one step that moves the top (mm)."""
    top = f"kind: displacement, boundary: top, x: {x!r} mm, y: 0 mm, z: {z!r} mm"
    return f"supports.press={{{top}}}", "supports.push=null", "stages=[{name: all}]"


def layer_problems() -> Iterator[Check]:
    """All of them."""
    lost, back = LIMIT * AREA * SLIP, PUSH - 2 * LIMIT / ALONG
    press = "{kind: pressure, boundary: top, pressure: 3 MPa, history: [1, 1, 1, 1]}"
    pressed = ("supports.press=null", f"loads.press={press}")
    rows = {
        "approach": ("approach p / k_n [mm]", "penetration_max [mm]", 1, PRESS, pressed),
        "shear": ("shear k_t d [MPa]", "shear_max [MPa]", 2, ALONG * PUSH / 4, ()),
        "limit": ("shear at its limit mu p [MPa]", "shear_max [MPa]", 3, LIMIT, ()),
        "slip": ("slip d - mu p / k_t [mm]", "slip_max [mm]", 3, SLIP, ()),
        "work": ("dissipation [N mm]", "dissipation [N mm]", 3, lost, ()),
        "back": ("slip left after a way back [mm]", "slip_max [mm]", 4, SLIP - back, ()),
        "cycle": ("its work [N mm]", "dissipation [N mm]", 4, lost + LIMIT * AREA * back, ()),
    }
    for name, (what, key, time, reference, changes) in rows.items():
        judge = partial(at, key=key, time=time, reference=reference)
        yield problem(f"layer_{name}", f"{what}, relative", "layer", judge, 2e-6, [changes])
    what = "pressure u / (1 / k + L / E) of a layer and a bar, k over eight decades, relative"
    stiff = [10.0**k for k in range(9)]
    pressures = (PRESS / (1 / k + 2 / 2200) for k in stiff)
    series = [partial(number, name="wall_bar.pressure_mean", reference=p) for p in pressures]
    case = ("regions.bar.youngs_modulus=2200 MPa", *held(0.0, -PRESS))
    law = "interfaces.wall_bar.compliance.normal={} MPa/mm"
    runs = [(*case, law.format(k)) for k in stiff]
    yield problem("layer_series", what, "layer", series, 1e-8, runs)
    c, s = math.cos(math.radians(25)), math.sin(math.radians(25))
    what = "slip at 25 degrees to the axes, pressed and pushed in one step [mm], relative"
    turned = ("geometry.tilt=25 deg", *held(c * PUSH + s * PRESS, s * PUSH - c * PRESS))
    slid = partial(number, name="wall_bar.slip_mean", reference=SLIP)
    yield problem("layer_turned", what, "layer", slid, 2e-6, [turned])
    what = "motion F / (A (k_n + 2 k_t)) of a cube into a corner [mm], relative"
    moved = partial(number, name="socket_cube.motion_mean", reference=0.01 * math.sqrt(3))
    yield problem("layer_corner", what, "socket", moved, 1e-6)
