r"""How wrong the numbers of a run are, from coarser companions of it.

A number X on a mesh of size h is taken as :math:`X_h = X + C h^p`. Companions on the meshes of size
:math:`c h` give one estimate each of what is missing,

.. math:: |X_h - X| = |X_h - X_{ch}| / (c^p - 1),

and the larger is reported: unstructured meshes do not nest, so that one difference may be small by
chance. The order p is not fitted, for the same reason: `ORDERS` holds the orders that gave the best
estimates on cases with known answers (effectivity in the closing table of ``mantle study``).

Where friction makes the path matter, the error of the load step is of first order in it (the
incremental minimisation is an implicit Euler method). The coarser companions take half the steps,
so that the differences hold both errors; a run of one step has a companion of two on the coarsest
mesh, whose difference is added.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from app import config

COARSER = (2.0, 3.0)
# What converges like the displacement, and what like stress: orders of P1 and P2.
ORDERS = {1: (1.5, 0.8), 2: (1.5, 1.5)}
MOTIONS = (
    *("gap_mean", "gap_p99", "slip_mean", "slip_p99", "dissipation", "force"),
    *("pressure_mean", "shear_mean", "subsidence", "retroversion", "varus"),
)
TRACTIONS = ("pressure_p99", "shear_p99", "von_mises_p99", "hoop_p99", "principal_p99")
PEAKS = ("gap_max", "slip_max", "pressure_max", "shear_max", "von_mises_max", "principal_max")
# A peak that still changes by more than this part of itself when the mesh is halved.
UNSETTLED = 0.1
# A mesh that is not coarser than this tells nothing: the mesher could not do what was asked.
LEAST = 1.25

Numbers = dict[str, Any]


@dataclass(frozen=True)
class Companion:
    """A cheaper relative of a run.

    Attributes:
        case: What is solved.
        coarsening: Its mesh size over that of the run.
        steps: Its increments over those of the run.
    """

    case: config.Case
    coarsening: float
    steps: float

    def __str__(self) -> str:
        """What it is, for people."""
        fewer = f", {self.steps:g} times the increments" if self.steps != 1 else ""
        return f"mesh {self.case.mesh.size:g} mm{fewer}"


def companions(case: config.Case) -> tuple[Companion, ...]:
    """What has to be solved to know the errors of a case; nothing unless it asks for them.

    The mesh of a ``.msh`` file cannot be made coarser: only its step error is estimated.
    """
    if not case.output.error:
        return ()
    most = max(stage.increments for stage in case.stages)
    frictional = any(
        getattr(law, "friction_coefficient", 0) > 0 for law in case.interfaces.values()
    )
    half = most // 2 / most if frictional and most > 1 else 1.0
    meshes = tuple(_companion(case, c, half) for c in _coarsenings(case))
    if not frictional or (meshes and most > 1):
        return meshes
    # Of one step, or on a mesh that cannot be coarser.
    coarsest = (1.0, *_coarsenings(case))[-1]
    return (*meshes, _companion(case, coarsest, 2.0 if most == 1 else half))


def _companion(case: config.Case, coarsening: float, steps: float) -> Companion:
    """The case on a coarser mesh with another number of steps."""
    mesh = case.mesh.model_copy(
        update={"size": coarsening * case.mesh.size, "far_size": coarsening * case.mesh.far}
    )
    stages = tuple(
        s.model_copy(update={"increments": max(1, round(s.increments * steps))})
        for s in case.stages
    )
    changed = {"mesh": mesh, "stages": stages}
    return Companion(case.model_copy(update=changed), coarsening, steps)


def _coarsenings(case: config.Case) -> tuple[float, ...]:
    """Mesh sizes of the companions over that of the run, as far as the geometry can be meshed."""
    limit = case.geometry.coarsest_size / case.mesh.size
    return tuple(dict.fromkeys(c for f in COARSER if (c := min(f, limit)) > LEAST))


def measured(companion: Companion, run: Numbers, numbers: Numbers) -> Companion:
    """A companion with the coarsening that its mesh really has at the interfaces."""
    if not run["interfaces"]:
        return companion
    ratios = [
        numbers["interfaces"][name]["facet_size"] / q["facet_size"]
        for name, q in run["interfaces"].items()
    ]
    return replace(companion, coarsening=float(np.mean(ratios)))


def estimate(run: Numbers, order: int, solved: Sequence[tuple[Companion, Numbers]]) -> list[str]:
    """Put an ``X_error`` beside each headline number X.

    Args:
        run: Sections interfaces, regions and stem of the run's summary; changed in place.
        order: Degree of its displacement.
        solved: Its companions with the same sections.

    Returns:
        Peaks that have not converged with the mesh, as ``interface.pressure_max``.
    """
    unsettled: list[str] = []
    tables = _tables(run)
    largest = {k: max((abs(q[k]) for _, q in tables if k in q), default=0.0) for k in PEAKS}
    largest |= dict.fromkeys(("gap_max", "slip_max"), max(largest["gap_max"], largest["slip_max"]))
    for (section, name), numbers in tables:
        others = [
            (measured(c, run, o), o[section][name] if name else o[section]) for c, o in solved
        ]
        for keys, p in zip((MOTIONS, TRACTIONS), ORDERS[order], strict=True):
            for key in [k for k in numbers if k in keys]:
                if (error := _error(key, p, numbers, others)) is not None:
                    numbers[f"{key}_error"] = error
        for other in [o for c, o in others if c.coarsening > LEAST][:1]:
            for k in [k for k in PEAKS if k in numbers]:
                # What is next to nothing beside its like on other interfaces is no peak.
                size = max(abs(numbers[k]), UNSETTLED * largest[k])
                if abs(numbers[k] - other[k]) > UNSETTLED * size:
                    unsettled.append(f"{name}.{k}")
    return unsettled


def _tables(run: Numbers) -> list[tuple[tuple[str, str], Numbers]]:
    """Each mapping of numbers, with its section and name."""
    named = [((s, n), q) for s in ("interfaces", "regions") for n, q in run[s].items()]
    return [*named, (("stem", ""), run["stem"])]


def _error(
    key: str, p: float, run: Numbers, others: Sequence[tuple[Companion, Mapping[str, Any]]]
) -> Any:
    """Error of one number or vector; None if nothing is known of it."""
    value = np.asarray(run[key])
    known = [(c, np.asarray(o[key])) for c, o in others]
    coarser = [(c, o) for c, o in known if c.coarsening > LEAST and c.steps <= 1]
    differences = [abs(value - o) / (c.coarsening**p - 1) for c, o in coarser]
    parts = [np.max(differences, axis=0)] if differences else []
    for c, o in known:
        base = next((m for d, m in coarser if d.case.mesh == c.case.mesh), value)
        if base is not o and (c.steps > 1 or not differences):
            # e = C / n: the difference of n and s n steps is C / n (1 - 1 / s).
            parts.append(abs(o - base) / abs(1 - 1 / c.steps))
    return np.sum(parts, axis=0).tolist() if parts else None
