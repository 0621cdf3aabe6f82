"""Judges of ``mantle stress``: an answer against a reference, an invariance, a balance.

Each takes the runs of a case, the one in question first, and returns its error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from app.campaigns.work_precision import fitted_order
from app.foundation.arrays import Floats
from app.foundation.verdict import Reason
from app.laws.interface_laws import InterfaceLaw
from app.results.reading import Run
from app.verification import closed_forms as exact
from app.verification.check import Sample, worst
from app.verification.closed_forms_coupled import Layers
from app.verification.measures import end_of_bar, step_at, work_lost

# Fraction of the friction limit that counts as zero.
NOTHING = 1e-6


def _off(values: Floats, reference: Floats, scale: float | None = None) -> float:
    """Largest difference over the largest value of the reference, or absolute if that is zero."""
    largest = float(np.abs(reference).max(initial=0.0)) if scale is None else scale
    return float(np.abs(values - reference).max(initial=0.0)) / (largest or 1.0)


def _partners(run: Run, points: Floats, other: Run) -> NDArray[np.int64]:
    """Node of another run at each point (n, 3) of the same region; ValueError if meshes differ."""
    from scipy.spatial import cKDTree

    if np.array_equal(points, other.points) and np.array_equal(run.region, other.region):
        return np.arange(len(points))  # two regions may have as many cells as each other

    def labelled(r: Run, x: Floats) -> Floats:
        # The two sides of an interface are at one place and in different regions, which a mesh
        # file may number in another order: they are identified by their number of cells.
        cells = np.bincount(r.region)[r.region].astype(float)
        first = np.full(len(x), len(r.cells) + 1.0)
        np.minimum.at(first, r.cells, np.repeat(cells[:, None], r.cells.shape[1], axis=1))
        return np.column_stack([x, first * 10 * np.ptp(other.points)])

    distance, found = cKDTree(labelled(other, other.points)).query(labelled(run, points))
    if distance.max() > 1e-6 * np.ptp(other.points):
        raise ValueError("the meshes are not the same")
    return np.asarray(found, dtype=np.int64)


def same(
    runs: Sequence[Run],
    lengths: float = 1.0,
    stresses: float = 1.0,
    points: float = 1.0,
    turn: Floats | None = None,
) -> Sample:
    """Difference of every field after every step from the second run, times a factor.

    Displacements, gaps and slips are multiplied by ``lengths``, tractions by ``stresses``, the mesh
    by ``points``; the model is turned by a rotation (3, 3).
    """
    run, other = runs
    R = np.eye(3) if turn is None else turn
    if len(run.times) != len(other.times) or not np.allclose(run.times, other.times):
        return Sample(np.inf, note=f"{len(run.times)} steps instead of {len(other.times)}")
    k = _partners(run, np.asarray(run.points @ R / points, dtype=float), other)
    found = []
    for step, time in enumerate(run.times):
        u = other.displacement(step)[k] @ R.T * lengths
        found.append(Sample(_off(run.displacement(step), u), note=f"displacement at time {time:g}"))
        for name in run.contacts:
            pressure = other.at_interface(name, "pressure", step)[k] * stresses
            gap = other.at_interface(name, "gap", step) * lengths
            slips = f"{name}_slip" in other.point_fields  # not where sides slide far
            slip = other.at_interface(name, "slip", step) * lengths if slips else 0 * u
            # Gap and slip are one vector; rounding alone has no scale of its own.
            jump = float(max(np.abs(gap).max(), np.abs(slip).max(), NOTHING * np.abs(u).max()))
            shear = other.at_interface(name, "shear", step)[k] * stresses
            peak = float(pressure.max())
            for quantity, reference, scale in (
                ("gap", gap[k], jump),
                *[("slip", slip[k] @ R.T, jump)] * slips,
                ("pressure", pressure, peak),
                ("shear", shear, peak),
            ):
                value = run.at_interface(name, quantity, step)
                words = f"{quantity} of {name} at time {time:g}"
                found.append(Sample(_off(value, reference, scale), note=words))
    return worst(found)


def augmented(runs: Sequence[Run], factor: float) -> Sample:
    """As `same`, against the default augmentation; notes the augmentation used."""
    run, other = runs
    judged = same(runs)
    used, usual = (r.summary["solver"]["augmentation"] for r in (run, other))
    multiple = ", ".join(sorted({f"{used[name] / usual[name]:.3g}" for name in used}))
    newton, by_default = (r.summary["solver"]["newton_iterations"] for r in (run, other))
    note = f"asked for {factor:g} r, used {multiple} r, {newton} Newton iterations "
    return Sample(judged.error, note=f"{note}({by_default} by default); {judged.note}")


def lawful(runs: Sequence[Run]) -> Sample:
    """Balance, no tension, no penetration, no more friction than Coulomb's, none created."""
    run = runs[0]
    off = {f"balance of {key}": abs(value) for key, value in run.summary["balance"].items()}
    moved = float(np.abs(run.displacement()).max())
    for name, q in run.summary["interfaces"].items():
        p, t, gap = (run.at_interface(name, key) for key in ("pressure", "shear", "gap"))
        peak = float(p.max())
        if not peak:
            continue
        off[f"friction of {name}"] = float((t - _law(run, name).friction * p).max()) / peak
        off[f"pressure across a gap of {name}"] = float((p * gap).max()) / (peak * moved)
        if layer := _law(run, name).layer:  # of one stiffness across and along
            off[f"layer of {name}"] = float(np.abs(p + layer[0] * np.minimum(gap, 0)).max()) / peak
        else:
            off[f"penetration of {name}"] = q["penetration_max"] / moved
        lost = abs(q["dissipation"]) or 1.0
        off[f"friction of {name} that drives"] = max(0.0, -q["dissipation_min"]) / lost
    most = _worst(off)
    limits = {n: q.get("critical_friction", np.inf) for n, q in run.summary["interfaces"].items()}
    beyond = ", ".join(n for n, limit in limits.items() if _law(run, n).friction > limit)
    if beyond and Reason.NOT_UNIQUE not in Reason.within(run.log):
        return Sample(np.inf, note=f"friction beyond the critical one of {beyond} and no warning")
    warned = f"; warns that {beyond} may have several solutions" if beyond else ""
    return Sample(most.error, note=most.note + warned)


def _worst(errors: Mapping[str, float]) -> Sample:
    return worst([Sample(error, note=what) for what, error in errors.items()])


def _law(run: Run, name: str) -> InterfaceLaw:
    from app.case.case import load

    return load(run.folder / "case.yaml").config.interfaces[name]


def nothing_moves(runs: Sequence[Run]) -> Sample:
    """Displacement [mm] and pressure [MPa] without load: zero."""
    run = runs[0]
    values = [run.displacement(), *(run.at_interface(name, "pressure") for name in run.contacts)]
    return Sample(max(float(np.abs(v).max()) for v in values), note="displacement and pressure")


def mirrored(runs: Sequence[Run]) -> Sample:
    """A reversed load gives the reversed displacement along it."""
    ours, theirs = (np.array([r.displacement(k)[:, 0] for k in range(len(r.times))]) for r in runs)
    return Sample(_off(ours, -theirs), note="displacement along the load")


# Closed forms


def stack(runs: Sequence[Run], moduli: Sequence[float], ratios: Sequence[float]) -> Sample:
    """Blocks of 5 mm in a smooth box under 2 MPa: displacement and pressure are exact."""
    run = runs[0]
    p, h = 2.0, 5.0
    coefficients = map(exact.lame, zip(moduli, ratios, strict=True))
    strains = [p / (λ + 2 * μ) for λ, μ in coefficients]
    levels, falls = np.arange(len(moduli) + 1) * h, -np.cumsum([0.0, *strains]) * h
    u = run.displacement()
    should = np.zeros_like(u)
    should[:, 2] = np.interp(run.points[:, 2], levels, falls)
    off = {"displacement": _off(u, should)}
    for name in run.contacts:
        on = run.on_interface(name)
        pressure = run.at_interface(name, "pressure")[on]
        off[f"pressure of {name}"] = _off(pressure, np.full(on.sum(), p))
    return _worst(off)


def shrink_fit(
    runs: Sequence[Run],
    interference: float,
    radii: Sequence[float],
    materials: Sequence[exact.Elastic],
) -> Sample:
    """Mean pressures of a core in a mantle in a ring [MPa]; the outer where it is in contact."""
    numbers = runs[0].summary["interfaces"]
    swelling = interference / (1 + materials[0][1]) / radii[0]
    layers = Layers(radii, materials, (swelling, 0.0, 0.0), (True, True))
    off, notes = {}, []
    for i, name in enumerate(("stem_cement", "cement_bone")):
        if name in numbers:
            value, p = numbers[name]["pressure_mean"], -layers.at(i, radii[i])[1]
            off[name] = abs(value / p - 1)
            notes.append(f"{name} {value:.5g} MPa, exact {p:.5g}")
    return Sample(_worst(off).error, note="; ".join(notes))


def cycles(runs: Sequence[Run], count: int, force: float, friction: float) -> Sample:
    """Work lost in each cycle of the bar against F^3 / (12 EA f), and return of its end."""
    run = runs[0]
    law = exact.FoundationBar(force, friction, 1.1e6)
    ends = np.arange(count + 1) * 2 + 3.0  # unloaded
    lost = work_lost(run, "base_bar", ends)
    creep = float(np.abs(np.diff([end_of_bar(run, t) for t in ends])).max()) / law.end
    words = f"{count} cycles, {lost[0]:.5g} to {lost[-1]:.5g} N mm each, exact {law.cycle:.5g}"
    note = f"{words}; the end creeps by {creep:.1e} of its stroke in a cycle"
    return Sample(max(float(np.abs(lost / law.cycle - 1).max()), creep), note=note)


def shakedown(runs: Sequence[Run], count: int) -> Sample:
    """Subsidence of a taper in the last cycle over that in the first: it shakes down."""
    run = runs[0]
    top = run.points[:, 2] > run.points[:, 2].max() - 1e-6
    top &= np.hypot(run.points[:, 0], run.points[:, 1]) < 1.0
    pushed = np.arange(count + 1) * 2 + 1.0
    down = np.array([-run.displacement(step_at(run, t))[top, 2].mean() for t in pushed])
    sunk = np.diff(down)
    lost = work_lost(run, "stem_cement", pushed)
    share = abs(sunk[-1]) / down[0]
    words = f"sinks {1e3 * down[0]:.4g} um, then {1e3 * sunk[0]:.2e} .. {1e3 * sunk[-1]:.2e} um"
    return Sample(share, note=f"{words} in a cycle; loses {lost[0]:.3g} .. {lost[-1]:.3g} N mm")


def wedge(runs: Sequence[Run], half_angle: float, friction: float, left: float) -> Sample:
    """Force over integral of pressure of a cone pushed in by 100 N, then unloaded to a part.

    Where it slides it is sin a +- m cos a; where friction holds it, the law of friction and the
    balances hold and pressure stays. ``half_angle`` is that of the cone [rad], ``left`` the part of
    the force that is left.
    """
    run = runs[0]
    s, c = np.sin(half_angle), np.cos(half_angle)
    area = run.areas("stem_cement")
    pushed, now = (
        float((area * run.at_interface("stem_cement", "pressure", k)).sum())
        for k in (step_at(run, 1.0), -1)
    )
    into = abs(100 / (pushed * (s + friction * c)) - 1)
    words = f"{100 * now / pushed:.0f} % of the pressure stays; sliding in off by {into:.1e}"
    if friction <= s / c:
        out = abs(100 * left / (now * (s - friction * c)) - 1)
        return Sample(max(into, out), note=f"{words}, sliding out by {out:.1e}")
    held = lawful(runs)
    return Sample(held.error if now > 0.1 * pushed else np.inf, note=f"held; {words}")


def unpenalized(runs: Sequence[Run], penalties: Sequence[float], name: str) -> Sample:
    """Penetration and error of a penalty against the augmented Lagrangian: of order -1 in it."""
    *penalized, other = (r.summary["interfaces"][name] for r in runs)
    errors = [abs(q["pressure_mean"] / other["pressure_mean"] - 1) for q in penalized]
    first = fitted_order(penalties, errors)
    second = fitted_order(penalties, [q["penetration_max"] for q in penalized])
    note = f"order of the pressure's error {first:.3f}, of the penetration {second:.3f}"
    return Sample(max(abs(first + 1), abs(second + 1)), note=note)


# Steps and paths


def _final(run: Run) -> Floats:
    slips = (run.at_interface(name, "slip") for name in run.contacts)
    return np.concatenate([v.ravel() for v in (run.displacement(), *slips)])


def first_order(runs: Sequence[Run], counts: Sequence[int]) -> Sample:
    """The answer converges to that of the finest steps with the first power of their length."""
    *coarse, finest = map(_final, runs)
    errors = [float(np.linalg.norm(x - finest) / np.linalg.norm(finest)) for x in coarse]
    # The finest has an error of its own: h - h_finest is what the differences measure.
    sizes = [1 / n - 1 / counts[-1] for n in counts[:-1]]
    order = fitted_order(sizes, errors)
    tail = f"{errors[0]:.1e} with {counts[0]}, {errors[-1]:.1e} with {counts[-2]}"
    return Sample(max(0.0, 1.0 - order), note=f"order {order:.2f}; error {tail} increments")


def path_matters(runs: Sequence[Run]) -> Sample:
    """Two orders of the same loads differ at the end by more than the error of the steps.

    Runs: one order with fine and coarse steps, the other with fine steps.
    """
    one, coarse, other = map(_final, runs)
    apart, wrong = np.linalg.norm(one - other), np.linalg.norm(one - coarse)
    words = f"{apart / np.linalg.norm(one):.1e} apart, steps wrong by"
    return Sample(float(wrong / apart), note=f"{words} {wrong / np.linalg.norm(one):.1e}")


def close(runs: Sequence[Run], factor: float = 1.0) -> Sample:
    """Numbers of each interface equal those of the second run, forces multiplied by a factor."""
    run, other = runs
    off = {}
    for name, q in other.summary["interfaces"].items():
        mine = run.summary["interfaces"][name]
        for key in ("slip_path_mean", "pressure_mean", "shear_mean"):
            off[f"{key} of {name}"] = abs(mine[key] - q[key]) / (abs(q[key]) or 1.0)
        off[f"force of {name}"] = abs(mine["force"][2] / (factor * q["force"][2]) - 1)
    return _worst(off)
