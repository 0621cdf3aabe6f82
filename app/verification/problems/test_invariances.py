"""One model in several forms: augmentation, load size, units, symmetry, steps; floating bodies."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest

from app.campaigns.work_precision import fitted_order
from app.foundation.verdict import Reason
from app.results.reading import Run
from app.verification.changed_meshes import ROTATION
from app.verification.measures import (
    MESH,
    difference_between,
    largest_difference,
    largest_error,
    law_violation,
)
from app.verification.problem import (
    Comparison,
    KnownProblem,
    condensed,
    long,
    quick,
    run,
    stress,
)

STRESS_STEM = "stress/stem.yaml"
FOUNDATION_BAR = "verification/foundation_bar.yaml"
STEM_INTERFACES = ("stem_cement", "cement_bone")
FIELDS = "every field, over its largest value"
LINEAR = "displacements and tractions are proportional to the load, and to loads and gaps together"

# Under the full load a stem sinks by 9 mm into cement of 110 MPa, which is refused as too far.
SMALL_LOADS = (
    "loads.push.force=[0 N, 0 N, -90 N]",
    "loads.lateral.force=[30 N, 20 N, 0 N]",
)

# Augmentation over eight decades, by factors on the default

AUGMENTATION_FACTORS = {half: float(f"{10.0 ** (half / 2):.6g}") for half in range(-8, 9) if half}


def usual(ratio: int, μ: float, half: int) -> bool:
    """Return True if a ratio of moduli, friction and factor are of the tier "default"."""
    return ratio > 1 and μ in (0.05, 0.4) and half % 2 == 0


@stress
@condensed
@pytest.mark.parametrize(
    ("ratio", "μ", "factor"),
    [
        pytest.param(
            ratio,
            μ,
            factor,
            id=f"E {ratio}:1 mu {μ}/{factor:.2g}",
            marks=() if usual(ratio, μ, half) else long,
        )
        for ratio, μ in product((1, 50, 1000), (0.01, 0.05, 0.4, 1.0))
        for half, factor in AUGMENTATION_FACTORS.items()
        if μ != 0.05 or usual(ratio, μ, half)
    ],
)
def test_augmentation(problem: KnownProblem, ratio: int, μ: float, factor: float) -> None:
    problem.expects(FIELDS, tolerance=1e-6, source="the answer of the default augmentation")
    base = (
        f"regions.cement.youngs_modulus={110000 / ratio!r} MPa",
        f"interfaces.stem_cement.friction_coefficient={μ}",
        *(SMALL_LOADS if ratio == 1000 else ()),
    )
    augmentation = f"solver.augmentation_factor={0.2 * factor!r}"
    solved, default = problem.solve_each(STRESS_STEM, [(*base, augmentation), base])
    augmentation_used, default_r = (r.summary["solver"]["augmentation"] for r in (solved, default))
    multiple = ", ".join(
        sorted({f"{augmentation_used[name] / default_r[name]:.3g}" for name in augmentation_used})
    )
    newton, by_default = (r.summary["solver"]["newton_iterations"] for r in (solved, default))
    difference = difference_between(solved, default)
    note = (
        f"asked for {factor:g} r, used {multiple} r, {newton} Newton iterations "
        f"({by_default} by default); {difference.note}"
    )
    problem.compare(Comparison(difference.error, note=note))


# Size and sign of the load


def pushed(force: float) -> tuple[str, str]:
    """Overrides for the loads of the stem by a force [N]; the usual force is 900 N."""
    c = force / 900
    return (
        f"loads.push.force=[0 N, 0 N, {-force!r} N]",
        f"loads.lateral.force=[{300 * c!r} N, {200 * c!r} N, 0 N]",
    )


def gaps(c: float) -> tuple[str, str]:
    """Overrides for interfaces tight above and open below, by c times 4 um."""
    return (
        f"interfaces.stem_cement.gap={0.004 * c!r} * (1 - z / 10)",
        f"interfaces.cement_bone.gap={-0.002 * c!r} * (1 + x / 20)",
    )


def nothing_moves(run: Run) -> Comparison:
    """Displacement [mm] and pressure [MPa] without load: zero."""
    values = [run.displacement(), *(run.at_interface(name, "pressure") for name in run.contacts)]
    return Comparison(max(float(np.abs(v).max()) for v in values), note="displacement and pressure")


FORCES = (0.0, 1e-6, 1e-3, 1.0, 1e2, 1e4)


@stress
@condensed
@pytest.mark.parametrize("force", [pytest.param(force, id=f"{force:g} N") for force in FORCES])
def test_loads_stem(problem: KnownProblem, force: float) -> None:
    if force:
        problem.expects(FIELDS, tolerance=1e-10, source=LINEAR)
        solved, usual = problem.solve_each(STRESS_STEM, [pushed(force), ()])
        problem.compare(
            difference_between(solved, usual, lengths=force / 900, stresses=force / 900)
        )
    else:
        problem.expects("displacement and pressure without load", tolerance=1e-14, source="zero")
        problem.compare(nothing_moves(problem.solve(STRESS_STEM, *pushed(0.0))))


@stress
@condensed
def test_loads_stem_beyond_small_displacements(problem: KnownProblem) -> None:
    """The slip is proportional to the load: the stem of radius 7 mm would slip 100 mm."""
    problem.expects_refusal("a stem under 1e6 N", Reason.LARGE_DISPLACEMENT)
    problem.solve(STRESS_STEM, *pushed(1e6))


@stress
@condensed
@pytest.mark.parametrize(
    "c", [pytest.param(c, id=f"x {c:g}") for c in (1e-6, 1e-3, 0.1, 10.0, 1e2)]
)
def test_loads_stem_and_gaps(problem: KnownProblem, c: float) -> None:
    problem.expects(FIELDS, tolerance=1e-10, source=LINEAR)
    solved, usual = problem.solve_each(STRESS_STEM, [(*gaps(c), *pushed(900 * c)), gaps(1.0)])
    problem.compare(difference_between(solved, usual, lengths=c, stresses=c))


@stress
@condensed
def test_loads_reversed_bar(problem: KnownProblem) -> None:
    problem.expects(
        "displacement along a reversed load", tolerance=1e-2, source="the reversed displacement"
    )
    runs = problem.solve_each(FOUNDATION_BAR, [("loads.pull.force=[-500 N, 0 N, 0 N]",), ()])
    forward, backward = (
        np.array([r.displacement(k)[:, 0] for k in range(len(r.times))]) for r in runs
    )
    problem.compare(
        Comparison(largest_difference(forward, -backward), note="displacement along the load")
    )


@stress
@condensed
def test_loads_reversed_stem(problem: KnownProblem) -> None:
    problem.expects_refusal("a stem pulled out", Reason.FLOATING_BODY)
    problem.solve(STRESS_STEM, "loads.push.force=[0 N, 0 N, 900 N]")


# Units


OTHER_UNITS = (
    "geometry.stem_radius=0.007 m",
    "geometry.cement_thickness=0.4 cm",
    "geometry.bone_thickness=5000 um",
    "geometry.length=0.024 m",
    "geometry.taper=0.02617993877991494 rad",
    "mesh.size=0.0035 m",
    "mesh.far_size=0.5 cm",
    "regions.stem.youngs_modulus=1.1e11 Pa",
    "regions.cement.youngs_modulus=2.2 GPa",
    "regions.bone.youngs_modulus=1.7e10 N/m^2",
    "loads.push.force=[0 N, 0 N, -0.9 kN]",
    "loads.lateral.force=[3e5 mN, 0.2 kN, 0 N]",
)


@stress
@condensed
@pytest.mark.parametrize("words", [pytest.param(OTHER_UNITS, id="m, Pa, kN")])
def test_units(problem: KnownProblem, words: Sequence[str]) -> None:
    """The same case in other units."""
    problem.expects(FIELDS, tolerance=1e-8, source="the same case in mm, MPa, N")
    problem.compare(difference_between(*problem.solve_each(STRESS_STEM, [words, ()])))


@stress
@condensed
@pytest.mark.parametrize(
    ("mesh", "lengths", "stresses"),
    [
        pytest.param("metres", 1e-3, 1e6, id="m, Pa"),
        pytest.param("micrometres", 1e3, 1e-6, id="um"),
    ],
)
def test_units_numbers_of(
    problem: KnownProblem, mesh: str, lengths: float, stresses: float
) -> None:
    """The numbers are a thousand times smaller or larger in the other units."""
    problem.expects(FIELDS, tolerance=1e-8, source="the same model in numbers of mm, MPa")
    moduli = {"stem": 110e3, "cement": 2200.0, "bone": 17e3}
    scaled = (f"regions.{n}.youngs_modulus={E * stresses!r} MPa" for n, E in moduli.items())
    runs = problem.solve_all([run(STRESS_STEM, *scaled, mesh=mesh), run(STRESS_STEM)])
    problem.compare(difference_between(*runs, lengths=lengths, stresses=stresses, points=lengths))


# Unsupported bodies: refused by name

OPEN = tuple(f"interfaces.{side}.gap=0.1 mm" for side in STEM_INTERFACES)
SMOOTH = tuple(f"interfaces.{side}.friction_coefficient=0" for side in STEM_INTERFACES)
TWIST = (
    "loads.lateral={kind: force, boundary: stem_top, force: [0 N, 10 N, 0 N], "
    "at: [100 mm, 0 mm, 24 mm]}"
)
FLOATING = {
    "both open": (*OPEN, "loads.push.force=[0 N, 0 N, 900 N]"),
    "both open, pushed aside": (*OPEN, *SMOOTH, "loads.push.history=[0, 0]"),
    "both open, no load": (*OPEN, *pushed(0.0)),
    "smooth, straight": (*SMOOTH, "geometry.taper=0 deg"),
    "smooth, twisted": (*SMOOTH, TWIST),
    "no support": ("supports={}",),
    "held along x": ("supports={outer: {kind: roller, boundary: bone_surface, axis: x}}",),
    "rigid on rigid": ("regions.stem={rigid: true}", "regions.cement={rigid: true}"),
}


@stress
@quick
@condensed
@pytest.mark.parametrize("name", FLOATING)
def test_floating(problem: KnownProblem, name: str) -> None:
    reason = Reason.RIGID_CONTACT if name.startswith("rigid") else Reason.FLOATING_BODY
    description = f"a stem in its cement and bone: {name}"
    answers = {"both open, pushed aside": law_violation, "both open, no load": nothing_moves}
    if name not in answers:
        problem.expects_refusal(description, reason)
        problem.solve(STRESS_STEM, *FLOATING[name])
        return
    problem.expects(
        f"violation of balance and of the laws, {description}",
        tolerance=1e-7,
        source="Signorini's conditions and Coulomb's law",
        or_refusal=reason,
    )
    problem.compare(answers[name](problem.solve(STRESS_STEM, *FLOATING[name])))


# Steps and paths


def carried_round(first: str, count: int) -> tuple[str, str]:
    """Overrides that push the stem down, then turn its side load by a quarter.

    ``first`` is the history of the load along x, ``count`` the increments of each stage.
    """
    loads = (
        "loads={push: {kind: force, boundary: stem_top, force: [0 N, 0 N, -900 N], "
        "history: [1, 1]}, "
        f"one: {{kind: force, boundary: stem_top, force: [300 N, 0 N, 0 N], history: {first}}}, "
        "two: {kind: force, boundary: stem_top, force: [0 N, 300 N, 0 N], history: [0, 1]}}"
    )
    stages = (f"{{name: {n}, increments: {count}, adaptive: false}}" for n in ("push", "turn"))
    return loads, f"stages=[{', '.join(stages)}]"


def final(run: Run) -> np.ndarray:
    """Displacements and slips at the end, as one vector."""
    slips = (run.at_interface(name, "slip") for name in run.contacts)
    return np.concatenate([v.ravel() for v in (run.displacement(), *slips)])


@stress
@condensed
def test_increments_1_to_64(problem: KnownProblem) -> None:
    """The error falls in proportion to the length of steps."""
    problem.expects("order of steps, below 1", tolerance=0.2, source="implicit Euler: order 1")
    counts = (1, 2, 4, 8, 16, 32, 64, 128)
    runs = problem.solve_each(STRESS_STEM, [carried_round("[1, 0]", n) for n in counts])
    *coarse, finest = map(final, runs)
    errors = [float(np.linalg.norm(x - finest) / np.linalg.norm(finest)) for x in coarse]
    # The finest run has an error too, so differences scale with h - h_finest.
    sizes = [1 / n - 1 / counts[-1] for n in counts[:-1]]
    order = fitted_order(sizes, errors)
    tail = f"{errors[0]:.1e} with {counts[0]}, {errors[-1]:.1e} with {counts[-2]}"
    note = f"order {order:.2f}; error {tail} increments"
    problem.compare(Comparison(max(0.0, 1.0 - order), note=note))


@stress
@condensed
def test_increments_two_paths(problem: KnownProblem) -> None:
    """Two orders of the same loads differ at the end by more than the error of the steps."""
    problem.expects(
        "error of the steps over the difference of two paths",
        tolerance=0.2,
        source="friction makes the path matter",
    )
    paths = (("[1, 0]", 64), ("[1, 0]", 32), ("[0, 0]", 64))
    runs = problem.solve_each(STRESS_STEM, [carried_round(first, n) for first, n in paths])
    first_path, coarse_path, second_path = map(final, runs)
    size = np.linalg.norm(first_path)
    path_difference = np.linalg.norm(first_path - second_path)
    step_error = np.linalg.norm(first_path - coarse_path)
    note = f"{path_difference / size:.1e} apart, steps wrong by {step_error / size:.1e}"
    problem.compare(Comparison(float(step_error / path_difference), note=note))


# Symmetry


@stress
@condensed
def test_symmetry_whole_and_quarter(problem: KnownProblem) -> None:
    problem.expects(
        "numbers of interfaces of the whole and a quarter, relative",
        tolerance=MESH / 2,
        source="symmetry: four times the force",
    )
    mesh = ("mesh.size=4 mm", "mesh.far_size=6 mm", "mesh.order=1")
    planes = "".join(
        f"symmetry_{a}: {{kind: roller, boundary: symmetry_{a}, axis: {a}}}, " for a in "xy"
    )
    supports = (
        "table: {kind: roller, boundary: bone_bottom, axis: z}, "
        "mantle: {kind: roller, boundary: cement_bottom, axis: z}, "
        "bed: {kind: foundation, boundary: bone_surface, stiffness: "
        "[100 MPa/mm, 100 MPa/mm, 0 MPa/mm]}, "
        "push: {kind: displacement, boundary: stem_top, z: -0.1 mm, history: [0, 1]}"
    )
    whole, quarter = problem.solve_all(
        [
            run("cylinders.yaml", *mesh, f"supports={{{supports}}}", mesh="mirrored"),
            run("cylinders.yaml", *mesh, f"supports={{{planes}{supports}}}"),
        ]
    )
    problem.compare(close(whole, quarter, factor=4.0))


def close(run: Run, other: Run, *, factor: float) -> Comparison:
    """Numbers of each interface equal those of another run, forces multiplied by a factor."""
    errors = {}
    for name, other_numbers in other.summary["interfaces"].items():
        run_numbers = run.summary["interfaces"][name]
        for key in ("slip_path_mean", "pressure_mean", "shear_mean"):
            errors[f"{key} of {name}"] = abs(run_numbers[key] - other_numbers[key]) / (
                abs(other_numbers[key]) or 1.0
            )
        force = run_numbers["force"][2] / (factor * other_numbers["force"][2])
        errors[f"force of {name}"] = abs(force - 1)
    return largest_error(errors)


def rotated(force: Sequence[float]) -> str:
    """A force after the rotation of the mesh."""
    return "[" + ", ".join(f"{f!r} N" for f in (ROTATION @ force).tolist()) + "]"


@stress
@condensed
def test_symmetry_turned(problem: KnownProblem) -> None:
    """A model rotated so that no axis goes to an axis."""
    problem.expects(FIELDS, tolerance=1e-8, source="the model rotated back")
    loads = {"push": (0, 0, -900), "lateral": (300, 200, 0)}
    forces = (f"loads.{name}.force={rotated(force)}" for name, force in loads.items())
    runs = problem.solve_all([run(STRESS_STEM, *forces, mesh="turned"), run(STRESS_STEM)])
    problem.compare(difference_between(*runs, turn=ROTATION))
