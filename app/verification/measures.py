"""Measures that several subjects share: numbers and fields of runs against exact ones.

A measure of one subject alone stands with its problems.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from app.case import summary_numbers
from app.case.case import load_case
from app.foundation.arrays import Field, Floats, Ints
from app.foundation.verdict import Reason
from app.laws.interface_laws import InterfaceLaw
from app.results.reading import Run
from app.verification import closed_forms as exact
from app.verification.problem import Comparison, relative, worst

# Young's modulus [MPa] and Poisson's ratio of materials of the cases.
CEMENT = (2200.0, 0.3)
TITANIUM = (110e3, 0.3)
# Cortical bone and wood, by their fibres.
BONE = exact.Fibrous(E_l=17000, E_t=11500, nu_l=0.31, nu_t=0.51, mu_l=3280)
WOOD = exact.Fibrous(E_l=12e3, E_t=2e3, nu_l=0.4, nu_t=0.3, mu_l=1e3)
# Tolerance where a closed form is compared with a mesh.
MESH = 0.02
# Fraction of a displacement, or of the friction limit, that counts as zero.
NEGLIGIBLE_FRACTION = 1e-6


def slice_of(size: float) -> tuple[str, ...]:
    """Overrides for a slice of cylinders as long as its cells, on a mesh of one size [mm]."""
    keys = ("geometry.length", "mesh.size", "mesh.far_size")
    return tuple(f"{key}={size} mm" for key in keys)


# Numbers


def summary_number(run: Run, name: str, reference: float) -> Comparison:
    """A number of the summary, named as in studies."""
    value = summary_numbers.read(run.summary, name)
    return relative(math.nan if value is None else value, reference)


def largest_error(errors: Mapping[str, float]) -> Comparison:
    """The largest of named errors, with its name."""
    return worst([Comparison(error, note=quantity) for quantity, error in errors.items()])


def largest_difference(values: Floats, reference: Floats, scale: float | None = None) -> float:
    """Largest difference over the largest value of the reference, or absolute if that is zero."""
    size = float(np.abs(reference).max(initial=0.0)) if scale is None else scale
    return float(np.abs(values - reference).max(initial=0.0)) / (size or 1.0)


def step_at(run: Run, time: float) -> int:
    """The written step nearest to a time."""
    return int(np.argmin(np.abs(run.times - time)))


def work_lost(run: Run, interface: str, times: ArrayLike) -> Floats:
    """Work that an interface loses from each of n times to the next (n - 1,) [N mm]."""
    dissipation = run.step_record[f"{interface} dissipation [N mm]"]
    return np.diff(
        np.interp(np.asarray(times, dtype=float), run.step_record["time [-]"], dissipation)
    )


# Fields


def by_region(region: Ints, values: Sequence[NDArray[np.floating]]) -> Floats:
    """Select for each of n points the values (n, k) of its region.

    Points of further regions have those of the last one.
    """
    return np.asarray(np.choose(np.minimum(region, len(values))[:, None] - 1, values))


def in_l2(run: Run, fields: Sequence[Field]) -> Comparison:
    """Displacement against exact fields, one for each region, relative in L2."""
    error, norm, reference = run.norms(lambda x, region: by_region(region, [u(x) for u in fields]))
    return Comparison(error / reference, norm, reference)


# Invariances and balances


def _partners(run: Run, points: Floats, other: Run) -> NDArray[np.int64]:
    """Node of another run at each point (n, 3) of the same region; ValueError if meshes differ."""
    if np.array_equal(points, other.points) and np.array_equal(run.region, other.region):
        return np.arange(len(points))  # two regions may have equally many cells

    def labelled(r: Run, x: Floats) -> Floats:
        # The two sides of an interface are at one place and in different regions, which a mesh
        # file may number in another order: they are identified by their number of cells.
        cells = np.bincount(r.region)[r.region].astype(float)
        first_cell = np.full(len(x), len(r.cells) + 1.0)
        np.minimum.at(first_cell, r.cells, np.repeat(cells[:, None], r.cells.shape[1], axis=1))
        return np.column_stack([x, first_cell * 10 * np.ptp(other.points)])

    distance, nodes = cKDTree(labelled(other, other.points)).query(labelled(run, points))
    if distance.max() > 1e-6 * np.ptp(other.points):
        raise ValueError("the meshes are not the same")
    return np.asarray(nodes, dtype=np.int64)


def difference_between(
    run: Run,
    other: Run,
    *,
    lengths: float = 1.0,
    stresses: float = 1.0,
    points: float = 1.0,
    turn: Floats | None = None,
) -> Comparison:
    """Difference of every field after every step from another run, times a factor.

    Displacements, gaps and slips are multiplied by ``lengths``, tractions by ``stresses``, the mesh
    by ``points``; the model is turned by a rotation (3, 3).
    """
    R = np.eye(3) if turn is None else turn
    if len(run.times) != len(other.times) or not np.allclose(run.times, other.times):
        return Comparison(np.inf, note=f"{len(run.times)} steps instead of {len(other.times)}")
    k = _partners(run, np.asarray(run.points @ R / points, dtype=float), other)
    errors = {}
    for step, time in enumerate(run.times):
        u = other.displacement(step)[k] @ R.T * lengths
        errors[f"displacement at time {time:g}"] = largest_difference(run.displacement(step), u)
        for name in run.contacts:
            pressure = other.at_interface(name, "pressure", step)[k] * stresses
            shear = other.at_interface(name, "shear", step)[k] * stresses
            gap = other.at_interface(name, "gap", step) * lengths
            peak = float(pressure.max())
            # Gap and slip are one vector; rounding alone has no scale.
            jump = max(float(np.abs(gap).max()), NEGLIGIBLE_FRACTION * float(np.abs(u).max()))
            fields = {"pressure": (pressure, peak), "shear": (shear, peak)}
            if f"{name}_slip" in other.point_fields:  # not with finite sliding
                slip = other.at_interface(name, "slip", step) * lengths
                jump = max(jump, float(np.abs(slip).max()))
                fields["slip"] = (slip[k] @ R.T, jump)
            fields["gap"] = (gap[k], jump)
            for quantity, (reference, scale) in fields.items():
                value = run.at_interface(name, quantity, step)
                errors[f"{quantity} of {name} at time {time:g}"] = largest_difference(
                    value, reference, scale
                )
    return largest_error(errors)


def law_of(run: Run, name: str) -> InterfaceLaw:
    """The law of an interface of a run."""
    return load_case(run.folder / "case.yaml").config.interfaces[name]


def law_violation(run: Run) -> Comparison:
    """Largest violation of balances, of the contact and friction law; energy that is created."""
    errors = {f"balance of {key}": abs(value) for key, value in run.summary["balance"].items()}
    interfaces = run.summary["interfaces"]
    largest_displacement = float(np.abs(run.displacement()).max())
    for name, q in interfaces.items():
        p, t, gap = (run.at_interface(name, key) for key in ("pressure", "shear", "gap"))
        peak = float(p.max())
        if not peak:
            continue
        law = law_of(run, name)
        errors[f"friction of {name}"] = float((t - law.largest_friction * p).max()) / peak
        errors[f"pressure across a gap of {name}"] = float((p * gap).max()) / (
            peak * largest_displacement
        )
        # A layer without a normal stiffness does not compress.
        if law.layer and np.isfinite(law.layer[0]):
            borne = p + law.layer[0] * np.minimum(gap, 0)
            errors[f"layer of {name}"] = float(np.abs(borne).max()) / peak
        else:
            errors[f"penetration of {name}"] = q["penetration_max"] / largest_displacement
        dissipation = abs(q["dissipation"]) or 1.0
        errors[f"friction of {name} that drives"] = max(0.0, -q["dissipation_min"]) / dissipation
    violation = largest_error(errors)
    limits = {name: q.get("critical_friction", np.inf) for name, q in interfaces.items()}
    above_critical = ", ".join(
        n for n, critical in limits.items() if law_of(run, n).largest_friction > critical
    )
    if not above_critical:
        return violation
    if Reason.NOT_UNIQUE not in Reason.within(run.log):
        message = f"friction beyond the critical one of {above_critical} and no warning"
        return Comparison(np.inf, note=message)
    return Comparison(
        violation.error,
        note=f"{violation.note}; warns that {above_critical} may have several solutions",
    )
