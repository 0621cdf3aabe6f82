"""Rows of ``mantle stress`` on cohesive interfaces: energy, strength, stiffness, length of steps.

The bar of cohesive_bar.yaml is pulled until it breaks; traction and energy are exact throughout.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from app.verification.check import Check, each, row, run
from app.verification.closed_forms_cohesion import AREA, G_I, N, breaks

# Length over Young's modulus of the bar [mm/MPa].
SOFT = 40 / 2000


def breaking() -> Iterator[Check]:
    """All checks of cohesive interfaces at extremes."""
    for k in range(-4, 3):
        yield _bar(f"energy/{10.0**k:g} N per mm", energy=10.0**k)
    for k in range(-2, 3):
        yield _bar(f"strength/{10.0**k:g} MPa", strength=10.0**k)
    for k in range(9):
        yield _bar(f"stiffness/1e{k} of the least", above=1.25 * 10.0**k)
    for k in range(7):
        yield _bar(f"steps/{2**k}", steps=2**k)


def _bar(
    name: str, energy: float = G_I, strength: float = N, above: float = 10.0, steps: int = 16
) -> Check:
    """The bar with a stiffness ``above`` the least, in steps of a part of its energy."""
    least = 1.125 * strength**2 / energy
    law = (
        f"stiffness={above * least!r} MPa/mm",
        *(f"{m}_strength={k * strength!r} MPa" for m, k in (("tensile", 1), ("shear", 1.5))),
        *(f"{m}_energy={k * energy!r} N/mm" for m, k in (("tensile", 1), ("shear", 2))),
    )
    end = 1.5 * max(SOFT * strength + 1 / (above * least) * strength, 2 * energy / strength)
    case = run(
        "verification/cohesive_bar.yaml",
        *(f"interfaces.lower_upper.{value}" for value in law),
        f"supports.pull.z={end!r} mm",
        f"stages.0.fracture_step={AREA * energy / steps!r} N mm",
    )
    judge = each(partial(breaks, strength=strength, whole=energy))
    return row(f"cohesion/{name}", case, judge, 1e-5)
