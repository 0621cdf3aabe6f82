r"""Cohesive interfaces: closed forms, and the problems of ``mantle verify`` compared with them.

Nothing of the forms comes from the code under test. Lengths in mm, stresses in MPa, fracture energy
per area in N/mm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from app.foundation.arrays import Floats
from app.results.reading import Run
from app.verification.check import Check, CheckRun, Sample, problem, worst
from app.verification.measures import number, relative

# Of cohesive_bar.yaml: strengths, fracture energies, exponent of the mixture, area, stiffness.
N, S, G_I, G_II, ETA, AREA, K = 10.0, 15.0, 0.1, 0.2, 2.0, 16.0, 1e4
# Of an arm of cohesive_beams.yaml: E, width, height, and fracture energy.
ARM, G_ARM = (70e3, 1.0, 3.0), 0.25
ZONE = 3.0  # mm that the crack runs before its zone is whole
RIGID = tuple(f"regions.{side}={{rigid: true, tissue: other}}" for side in ("lower", "upper"))
SHORT = tuple(f"geometry.blocks.{k}.size=[4 mm, 4 mm, 2 mm]" for k in (0, 1))


def energy(mixture: float) -> float:
    """Fracture energy of a mixture B = D_t^2/|D|^2 (Benzeggagh and Kenane 1996)."""
    return G_I + (G_II - G_I) * mixture**ETA


def column(run: Run, name: str) -> Floats:
    """A column of the history of the interface."""
    return np.asarray(run.history[f"lower_upper {name}"])


def breaks(run: Run, mixture: float = 0.0, strength: float = N, whole: float = G_I) -> Sample:
    """A point led to its end in one direction: what it has used up, and its traction on the way.

    With linear softening the traction is on the quadric of the strengths, shrunk by the part of the
    energy that is used up. Strength and energy are those in tension.
    """
    used = column(run, "dissipation [N mm]") / (whole / G_I * energy(mixture) * AREA)
    pull = np.maximum(-column(run, "pressure_p95 [MPa]"), 0)  # a sheared block tips and presses
    left = np.hypot(pull / strength, column(run, "shear_p95 [MPa]") / S)
    softens = (used > 0) & (used < 1 - 1e-9)
    off = float(np.abs(left + used - 1)[softens].max(initial=0.0))
    solver = run.summary["solver"]
    note = f"traction off by {off:.1e} of the strength in {softens.sum()} steps, "
    note += f"{solver['rejected_steps']} of {solver['steps']} failed"
    return Sample(max(off, abs(used[-1] - 1)), used[-1], 1.0, note)


def unloads(run: Run) -> Sample:
    """Pulled to 0.005 mm and back in two steps: the traction falls on the line to the origin."""
    times, pull = run.history["time [-]"], -column(run, "pressure_p95 [MPa]")
    at = [float(pull[np.argmin(np.abs(times - t))]) for t in (1, 1.5, 2)]
    end = 2 * G_I / N
    soft = N * (end - 0.005) / (end - N / K)
    off = max(abs(at[0] / soft - 1), abs(2 * at[1] / at[0] - 1), abs(at[2] / at[0]))
    return Sample(off, at[0], soft)


def rubs(run: Run) -> Sample:
    """Shear over normal force of what is broken and pressed together again."""
    x, _, z = np.abs(run.summary["interfaces"]["lower_upper"]["force"])
    return relative(float(x / z), 0.3)


def beams(run: Run) -> Sample:
    """J of two arms turned apart while the crack runs: 12 M^2 / (E b^2 h^3), M = E I dθ/da.

    The crack's length is what is used up over G b; its slope is that of the steady part.
    """
    E, b, h = ARM
    crack = column(run, "dissipation [N mm]") / (G_ARM * b)
    steady = (crack > ZONE) & (np.asarray(run.history["time [-]"]) < 1)
    turned = 0.06 * np.asarray(run.history["time [-]"])
    slope = np.polyfit(crack[steady], turned[steady], 1)[0]
    moment = E * b * h**3 / 12 * slope
    newton = np.asarray(run.history["newton [-]"])[steady]
    failed = run.summary["solver"]["rejected_steps"] / len(newton)
    note = f"{newton.mean():.1f} Newton iterations a step, {100 * failed:.0f} % of steps failed"
    found = relative(12 * moment**2 / (E * b**2 * h**3), G_ARM)
    easy = newton.mean() <= 5 and failed <= 0.05
    return Sample(found.error if easy else math.inf, found.value, found.reference, note)


def converged(runs: Sequence[Run]) -> Sample:
    """Energy that the whole turn uses up, and work that the interface takes, by two meshes."""
    names = ("contact_work [N mm]", "dissipation [N mm]")
    return worst([relative(*(float(column(run, n)[-1]) for run in runs)) for n in names])


def balanced(run: Run) -> Sample:
    """Balance of energy of each step, and the least that a step used up, over all of it."""
    used = column(run, "dissipation [N mm]")
    least = max(0.0, -column(run, "dissipation_min [N mm]").min() / used[-1])
    return Sample(max(least, float(np.max(run.history["energy balance [-]"]))))


def cohesion_problems() -> Iterator[Check]:
    """All problems of cohesive interfaces."""
    top = "{{kind: displacement, boundary: top, {} mm, history: {}}}"

    def pull(x: float, z: float, history: str = "[1]") -> str:
        return f"supports.pull={top.format(f'x: {x!r} mm, y: 0 mm, z: {z!r}', history)}"

    stiff = ("regions.lower={rigid: true, tissue: other}", "regions.upper.youngs_modulus=1e6 GPa")
    what = "traction of a bar that snaps back, over its strength, and energy used up"
    yield problem("cohesive_bar", what, "cohesive_bar", breaks, 1e-6)
    what = "the same of a point in five mixtures of modes"
    angles = np.linspace(0, math.pi / 2, 5)
    smooth = (*stiff, *SHORT, "interfaces.lower_upper.friction_coefficient=0")
    runs = [(*smooth, pull(0.4 * math.sin(a), 0.4 * math.cos(a))) for a in angles]
    mixtures = [partial(breaks, mixture=math.sin(a) ** 2) for a in angles]
    yield problem("cohesive_mixtures", what, "cohesive_bar", mixtures, 1e-3, runs)
    what = "traction of a bond pulled to 0.005 mm and let go, relative"
    back = "stages=[{name: pull}, {name: back, increments: 2}]"
    let_go = pull(0, 0.005, "[1, 0]")
    runs = [(*stiff, *SHORT, let_go, back)]
    yield problem("cohesive_unloading", what, "cohesive_bar", unloads, 1e-4, runs)
    what = "pressure of a bond and bars in series, whole [MPa], relative"
    whole = partial(number, name="lower_upper.pressure_mean", reference=0.4 / (1 / K + 4 / 2000))
    runs = [(*SHORT, pull(0, -0.4))]
    yield problem("cohesive_pressed", what, "cohesive_bar", whole, 1e-9, runs)
    what = "friction of a bond that is broken and pressed"
    slide = f"supports.slide={top.format('x: 0.1', '[0, 0, 1]')}"
    press = f"supports.pull={top.format('y: 0 mm, z: -0.01', '[-4, 1, 1]')}"
    stages = "stages=[{name: pull, fracture_step: 0.1 N mm}, {name: press}, {name: slide}]"
    runs = [(*SHORT, slide, press, stages)]
    yield problem("cohesive_friction", what, "cohesive_bar", rubs, 1e-6, runs)
    what = "J of a double cantilever beam turned apart [N/mm], relative"
    yield problem("cohesive_beams", what, "cohesive_beams", beams, 0.01)
    what = "energy and work of the turn by cells of 2 mm, against 1 mm [N mm], relative"
    case = partial(CheckRun, "verification/cohesive_beams.yaml")
    yield Check("cohesive_mesh", what, (case(("mesh.size=2 mm",)), case()), converged, 0.02)
    what = "balance of energy over its work, and least dissipation of a step"
    yield problem("cohesive_balance", what, "cohesive_beams", balanced, 1e-10)
