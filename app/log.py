"""What a run says: messages on rank 0 through `logging`, lines per step, the closing table."""

from __future__ import annotations

import logging
from typing import Any

log = logging.getLogger("mantle")


def step_header() -> str:
    """Column titles of the step lines."""
    return (
        f"{'step':>4} {'load':>7} {'newton':>6} {'krylov':>6} {'residual':>9} "
        f"{'open':>6} {'slip':>6} {'penetration':>12} {'wall':>8} {'left':>8}"
    )


def step_line(
    number: int,
    time: float,
    newton: int,
    krylov: int,
    residual: float,
    open_fraction: float,
    slip_fraction: float,
    penetration: float,
    wall: float,
    left: float,
) -> str:
    """One line for a converged step; lengths in mm, times in s."""
    return (
        f"{number:>4} {time:>7.4g} {newton:>6} {krylov:>6} {residual:>9.1e} "
        f"{100 * open_fraction:>5.1f}% {100 * slip_fraction:>5.1f}% {penetration:>9.1e} mm "
        f"{wall:>6.1f} s {left:>6.1f} s"
    )


def closing_table(summary: dict[str, Any]) -> str:
    """Interfaces in µm and MPa, regions in MPa, balances, and a plain verdict."""
    lines = []
    if summary["interfaces"]:
        lines.append(
            f"{'interface':<14} {'gap max/p99':>15} {'slip max/p99':>15} {'pressure max/p99':>17} "
            f"{'shear max/p99':>15} {'open/stick/slip':>18}"
        )
        lines.append(f"{'':<14} {'um':>15} {'um':>15} {'MPa':>17} {'MPa':>15} {'% of area':>18}")
    for name, q in summary["interfaces"].items():
        pairs = [
            f"{1e3 * q['gap_max']:.1f} / {1e3 * q['gap_p99']:.1f}",
            f"{1e3 * q['slip_max']:.1f} / {1e3 * q['slip_p99']:.1f}",
            f"{q['pressure_max']:.2f} / {q['pressure_p99']:.2f}",
            f"{q['shear_max']:.2f} / {q['shear_p99']:.2f}",
            " / ".join(f"{100 * q[f'{s}_fraction']:.0f}" for s in ("open", "stick", "slip")),
        ]
        lines.append(
            f"{name:<14} {pairs[0]:>15} {pairs[1]:>15} {pairs[2]:>17} {pairs[3]:>15} {pairs[4]:>18}"
        )
    lines.append(
        f"{'region':<16} {'von Mises p99':>14} {'tension max/p99':>18} {'mean stress':>17}"
    )
    lines.append(f"{'':<16} {'MPa':>14} {'MPa':>18} {'MPa':>17}")
    for name, r in summary["regions"].items():
        lines.append(
            f"{name:<16} {r['von_mises_p99']:>14.2f} "
            f"{r['principal_max']:>9.2f} / {r['principal_p99']:<6.2f} "
            f"{r['mean_stress_min']:>8.2f} .. {r['mean_stress_max']:<6.2f}"
        )
    if summary["stem"]:
        s = summary["stem"]
        lines.append(
            f"stem against bone: subsidence {1e3 * s['subsidence']:.1f} um, "
            f"retroversion {s['retroversion']:.3f} deg, varus {s['varus']:.3f} deg"
        )
    b = summary["balance"]
    lines.append(
        f"balance of force {b['force']:.1e}, moment {b['moment']:.1e}, energy {b['energy']:.1e}"
    )
    lines.append(verdict(summary))
    return "\n".join(lines)


def verdict(summary: dict[str, Any]) -> str:
    """One sentence on how far the numbers can be trusted."""
    b, solver, t = summary["balance"], summary["solver"], summary["timing"]
    worst = max(b.values())
    penetration = max((q["penetration_max"] for q in summary["interfaces"].values()), default=0.0)
    balanced = "equilibrium exact to rounding" if worst < 1e-8 else "NOT balanced: do not use"
    contact = (
        "contact exact to rounding"
        if penetration < 1e-9
        else f"the bodies penetrate by {1e3 * penetration:.2g} um"
    )
    far = [n for n, q in summary["interfaces"].items() if q["slip_max"] > q["facet_size"]]
    beyond = (
        f"; slip on {' and '.join(far)} exceeds the size of its facets: "
        "beyond small displacements, do not use"
        if far
        else ""
    )
    return (
        f"converged: {solver['dofs']} unknowns, {solver['steps']} steps, "
        f"{solver['newton_iterations']} Newton iterations on {solver['ranks']} rank(s) in "
        f"{t['total']:.1f} s; {balanced}, {contact} "
        f"(mesh error not included){beyond}"
    )
