"""Log of a run: messages on rank 0 through `logging`, lines per step, the closing table."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mantle.errors import UnusableError
from mantle.results import tables
from mantle.schema.quantities import TABLE

if TYPE_CHECKING:
    from mantle.stepping.heat_steps import HeatStep

log = logging.getLogger("mantle")

# The status of what is solved but not to be used.
UNUSABLE = "do not use"
BEYOND = "exceeds the size of its facets: beyond small displacements"

# How well what is summed has to be balanced: forces to rounding, heat to its solver's tolerance.
BALANCES: dict[str, float] = {"force": 1e-8, "moment": 1e-8, "energy": 1e-8, "heat": 1e-6}


def step_header() -> str:
    """Column titles of the step lines."""
    return (
        f"{'step':>4} {'time':>7} {'newton':>6} {'krylov':>6} {'residual':>9} "
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
    """Table of results at the end of a run, with balances and a plain verdict."""
    lines = list(tables.lines(summary))
    b = summary["balance"]
    lines.append(
        "balance of " + ", ".join(f"{name} {b[name]:.1e}" for name in BALANCES if name in b)
    )
    if unsettled := summary.get("error", {}).get("unsettled"):
        lines.append(f"peaks that do not converge with the mesh: {', '.join(unsettled)}")
    lines.append(verdict(summary))
    return "\n".join(lines)


def unbalanced(summary: Mapping[str, Any]) -> list[str]:
    """What is not in balance; a number that is none is not either."""
    b = summary.get("balance", {})
    return [name for name, limit in BALANCES.items() if name in b and not b[name] < limit]


def too_far(summary: Mapping[str, Any]) -> list[str]:
    """Interfaces on which bodies slip farther than their facets are wide."""
    return [
        name
        for name, q in summary.get("interfaces", {}).items()
        if q.get("slip_max", 0.0) > q.get("facet_size", np.inf)
    ]


def faults(summary: Mapping[str, Any]) -> list[str]:
    """Why the numbers of a solved case are not to be used; nothing if they are."""
    lost = [
        f"the balance of {name} is {summary['balance'][name]:.1e}, not below {BALANCES[name]:g}"
        for name in unbalanced(summary)
    ]
    return lost + [f"slip on {name} {BEYOND}" for name in too_far(summary)]


def check_usable(summaries: Mapping[Path, Mapping[str, Any]]) -> None:
    """Refuse results that are not to be used.

    Args:
        summaries: The summary of each run directory.

    Raises:
        UnusableError: With the reasons of each.
    """
    found = {folder: "; ".join(faults(s)) for folder, s in summaries.items()}
    if bad := [f"do not use the numbers in {f}: {why}" for f, why in found.items() if why]:
        raise UnusableError("\n".join(bad))


def _between(summary: dict[str, Any]) -> float:
    """Largest penetration between contact points [mm]."""
    return max(q["penetration_sampled"] for q in summary["interfaces"].values())


def verdict(summary: dict[str, Any]) -> str:
    """One sentence on how far the numbers can be trusted."""
    b, solver, t = summary["balance"], summary["solver"], summary["timing"]
    lost = unbalanced(summary)
    penetration = max((q["penetration_max"] for q in summary["interfaces"].values()), default=0.0)
    held = "equilibrium exact to rounding" if "force" in b else "no heat lost"
    balanced = f"NOT balanced ({', '.join(lost)}): do not use" if lost else held
    if penetration >= 1e-9:
        q = TABLE["interfaces"]["penetration_max"]
        balanced += f", the bodies penetrate by {q.factor * penetration:.2g} {q.shown}"
    elif summary["interfaces"]:
        q, most = TABLE["interfaces"]["penetration_sampled"], _between(summary)
        balanced += ", contact exact to rounding at points"
        if most >= 1e-9:
            balanced += f" and within {q.factor * most:.2g} {q.shown} between them"
    far = too_far(summary)
    beyond = f"; slip on {' and '.join(far)} {BEYOND}, do not use" if far else ""
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
