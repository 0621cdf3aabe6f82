"""What a run says: messages on rank 0 through `logging`, lines per step, the closing table."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from mantle.results import heat_log

if TYPE_CHECKING:
    from mantle.stepping.heat_steps import HeatStep

log = logging.getLogger("mantle")

# How well what is summed has to be balanced: forces to rounding, heat to its solver's tolerance.
BALANCES = {"force": 1e-8, "moment": 1e-8, "energy": 1e-8, "heat": 1e-6}


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


def heat_header() -> str:
    """Column titles of the lines of heat steps."""
    return (
        f"{'step':>4} {'time':>11} {'step of':>10} {'newton':>6} {'krylov':>6} {'hottest':>10} "
        f"{'balance':>9} {'wall':>8}"
    )


def heat_line(number: int, accepted: HeatStep, row: dict[str, float], wall: float) -> str:
    """One line for a step of the heat."""
    hottest = max(v for k, v in row.items() if k.endswith("temperature_max [degC]"))
    outcome = accepted.outcome
    return (
        f"{number:>4} {accepted.seconds:>9.4g} s {accepted.dt:>8.3g} s {outcome.iterations:>6} "
        f"{outcome.linear_iterations:>6} {hottest:>5.1f} degC {row['heat balance [-]']:>9.1e} "
        f"{wall:>6.1f} s"
    )


def closing_table(summary: dict[str, Any]) -> str:
    """Interfaces in µm and MPa, regions in MPa, balances, and a plain verdict."""
    wide = 21 if "error" in summary else 15
    lines = []
    if summary["interfaces"]:
        titles = "".join(f" {q + ' max/p99':>{wide}}" for q in ("gap", "slip"))
        titles += "".join(f" {q + ' max/p99':>{wide + 2}}" for q in ("pressure", "shear"))
        lines.append(f"{'interface':<14}{titles} {'open/stick/slip':>18}")
        units = "".join(f" {u:>{w}}" for u, w in (("um", wide), ("MPa", wide + 2)) for _ in "ab")
        lines.append(f"{'':<14}{units} {'% of area':>18}")
    for name, q in summary["interfaces"].items():
        gap, slip = (_pair(q, k, 1e3, 1) for k in ("gap", "slip"))
        pressure, shear = (_pair(q, k, 1.0, 2) for k in ("pressure", "shear"))
        states = " / ".join(f"{100 * q[f'{s}_fraction']:.0f}" for s in ("open", "stick", "slip"))
        lines.append(
            f"{name:<14} {gap:>{wide}} {slip:>{wide}} {pressure:>{wide + 2}} "
            f"{shear:>{wide + 2}} {states:>18}"
        )
    if summary["regions"]:
        lines.append(
            f"{'region':<16} {'von Mises p99':>{wide}} {'tension max/p99':>{wide + 4}} "
            f"{'mean stress':>18}"
        )
        lines.append(f"{'':<16} {'MPa':>{wide}} {'MPa':>{wide + 4}} {'MPa':>18}")
    for name, r in summary["regions"].items():
        tension = _pair(r, "principal", 1.0, 2)
        mean = f"{r['mean_stress_min']:.2f} .. {r['mean_stress_max']:.2f}"
        lines.append(
            f"{name:<16} {with_error(r, 'von_mises_p99', 1.0, 2):>{wide}} {tension:>{wide + 4}} "
            f"{mean:>18}"
        )
    for name, bond in summary.get("bonds", {}).items():
        lines.append(
            f"{name}, bonded: {100 * bond['strength_fraction']:.0f} % of its area above its "
            f"strength; normal {bond['normal_mean']:.2f} MPa (mean), shear "
            f"{bond['shear_mean']:.2f} MPa"
        )
    lines += heat_log.tables(summary)
    if s := summary["stem"]:
        lines.append(
            f"stem against bone: subsidence {with_error(s, 'subsidence', 1e3, 1)} um, "
            f"retroversion {with_error(s, 'retroversion', 1.0, 3)} deg, "
            f"varus {with_error(s, 'varus', 1.0, 3)} deg"
        )
    b = summary["balance"]
    lines.append(
        "balance of " + ", ".join(f"{name} {b[name]:.1e}" for name in BALANCES if name in b)
    )
    if unsettled := summary.get("error", {}).get("unsettled"):
        lines.append(f"peaks that do not converge with the mesh: {', '.join(unsettled)}")
    lines.append(verdict(summary))
    return "\n".join(lines)


def _pair(numbers: dict[str, Any], key: str, scale: float, digits: int) -> str:
    """Maximum and percentile of a quantity."""
    peak = f"{scale * numbers[f'{key}_max']:.{digits}f}"
    return f"{peak} / {with_error(numbers, f'{key}_p99', scale, digits)}"


def with_error(numbers: dict[str, Any], key: str, scale: float, digits: int) -> str:
    """A number as people write it, ``41.3 ± 1.8`` where its error is known."""
    text = f"{scale * numbers[key]:.{digits}f}"
    error = numbers.get(f"{key}_error")
    return text if error is None else f"{text} ± {scale * error:.{digits}f}"


def verdict(summary: dict[str, Any]) -> str:
    """One sentence on how far the numbers can be trusted."""
    b, solver, t = summary["balance"], summary["solver"], summary["timing"]
    good = all(b[name] < limit for name, limit in BALANCES.items() if name in b)
    penetration = max((q["penetration_max"] for q in summary["interfaces"].values()), default=0.0)
    held = "equilibrium exact to rounding" if "force" in b else "no heat lost"
    balanced = held if good else "NOT balanced: do not use"
    if penetration >= 1e-9:
        balanced += f", the bodies penetrate by {1e3 * penetration:.2g} um"
    elif summary["interfaces"]:
        balanced += ", contact exact to rounding"
    far = [n for n, q in summary["interfaces"].items() if q["slip_max"] > q["facet_size"]]
    beyond = (
        f"; slip on {' and '.join(far)} exceeds the size of its facets: "
        "beyond small displacements, do not use"
        if far
        else ""
    )
    error = (
        "± is the estimated error of mesh and step"
        if summary.get("error", {}).get("companions")
        else "error of mesh and step not estimated (--error)"
    )
    m = summary.get("memory")
    took = f", {m['peak']:.0f} MB ({m['per_unknown']:.1f} kB per unknown)" if m else ""
    return (
        f"converged: {solver['dofs']} unknowns, {solver['steps']} steps, "
        f"{solver['newton_iterations']} Newton iterations on {solver['ranks']} rank(s) in "
        f"{t['total']:.1f} s{took}; {balanced}; {error}{beyond}"
    )
