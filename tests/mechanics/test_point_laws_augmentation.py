"""The augmentation r: its default from the softest stiffness, and its change for bad values."""

from __future__ import annotations

import logging
from pathlib import Path

from petsc4py import PETSc

import numpy as np
import pytest

from app.numerics.newton import NewtonResult, Solver
from app.numerics.remedies import solve
from tests import support

STEM = (
    support.STEM
    + """
stages:
  - {name: load, adaptive: false}
"""
)
# The same half as large, but for what the mesh generator makes of it.
HALF = """
geometry: {kind: cylinders, stem_radius: 3.5 mm, cement_thickness: 2 mm, bone_thickness: 2.5 mm,
           length: 10 mm, taper: 1.5 deg}
mesh: {order: 1, size: 2.5 mm}
"""


def chosen(text: str, *overrides: str) -> np.ndarray:
    """Augmentation of each contact point [MPa/mm]."""
    problem, _ = support.assemble(support.case(text, *overrides))
    return np.asarray(problem.contact.laws.augmentation)


def test_point_laws_augmentation_scales_as_stiffness_per_length() -> None:
    """Ten times the moduli give ten times r; half the size gives twice r."""
    r = chosen(STEM)
    stiffer = chosen(
        STEM,
        "regions.stem.youngs_modulus=1100 GPa",
        "regions.cement.youngs_modulus=22 GPa",
        "regions.bone.youngs_modulus=170 GPa",
    )
    np.testing.assert_allclose(stiffer, 10 * r, rtol=1e-9)
    half = HALF + STEM[STEM.index("regions:") :]
    np.testing.assert_allclose(np.median(chosen(half)), 2 * np.median(r), rtol=0.1)


def test_point_laws_augmentation_follows_softened_cement() -> None:
    """Softening of the cement lowers its augmentation in proportion to the earlier factor."""
    problem, _ = support.assemble(support.case(STEM))
    j = problem.contact
    j.laws.scale_augmentation(0.1)
    before = j.laws.augmentation.copy()
    coupling = j.coupling._assemble

    def softer(*arguments: object) -> object:
        matrices = coupling(*arguments)  # type: ignore[arg-type]
        for m in matrices:
            m.scale(0.01)
        return matrices

    j.coupling._assemble = softer  # type: ignore[method-assign,assignment]
    problem._reassemble()
    np.testing.assert_allclose(j.laws.augmentation, 0.01 * before, rtol=1e-12)


@pytest.mark.parametrize(
    "factor", [pytest.param(1e-4, marks=pytest.mark.slow), 1e-3, 1e-2, 1.0, 1e2, 1e3, 1e4]
)
def test_point_laws_augmentation_over_eight_decades_gives_equal_jumps(
    factor: float, caplog: pytest.LogCaptureFixture
) -> None:
    """Eight decades of r give the same jumps in one step, without a rejected one.

    Attempts are reported.
    """
    outcomes: list[NewtonResult] = []
    jumps = []
    for f in (1.0, factor):
        case = support.case(STEM, f"solver.augmentation_factor={0.1 * f!r}")
        analysis = support.analysis(case)
        assert analysis.solver is not None
        caplog.clear()
        with caplog.at_level(logging.INFO, "mantle"):
            effort = analysis.run(
                lambda step, trial: outcomes.append(step.outcome), on_trouble=pytest.fail
            )
        assert (len(analysis.scene.stages), effort.rejected) == (1, 0)
        q = analysis.solver.u_and_q()[1]
        assert q is not None
        jumps.append(q.array.copy())
    np.testing.assert_allclose(jumps[1], jumps[0], atol=1e-6 * np.abs(jumps[0]).max())
    if outcomes[-1].augmentation != 1.0:
        assert f"augmentation {outcomes[-1].augmentation:.3g} r" in caplog.text


def test_point_laws_augmentation_default_is_found_from_any_given_value() -> None:
    """The factor is the default augmentation divided by that of the case."""
    law = "interfaces.{}={{kind: contact, friction_coefficient: 0.4, augmentation: 1e9 MPa/mm}}"
    penalty = law.replace("contact", "penalty").replace("augmentation", "penalty")
    given, springs = (
        [text.format(name) for name in ("stem_cement", "cement_bone")] for text in (law, penalty)
    )
    for overrides, multiple in (
        ([], 1.0),
        (["solver.augmentation_factor=2e3"], 1e-4),
        (given, np.exp(np.log(chosen(STEM)).mean()) / 1e9),
        (springs, 1.0),
    ):
        _, solver = support.assemble(support.case(STEM, *overrides))
        assert solver.system.contact.laws.factor_to_default_augmentation() == pytest.approx(
            multiple
        )


def test_point_laws_augmentation_does_not_change_a_penalty() -> None:
    """Softer trial forces give the same jumps, forces, slip and dissipation."""
    law = "interfaces.{}={{kind: penalty, friction_coefficient: 0.4, penalty: {} MPa/mm}}"
    laws = [law.format("stem_cement", 2e3), law.format("cement_bone", 5e3)]
    path = "loads.hip.history=[1, 0.2]"
    stages = "stages=[{name: on, adaptive: false}, {name: off, adaptive: false}]"
    statuses = []
    for factor in (1.0, 0.1):
        tight = "solver.tolerance=1e-12"
        problem, solver = support.assemble(support.case(STEM, path, stages, tight, *laws))
        j = problem.contact
        solver.augmentation = factor
        states = []
        for time in (0.5, 1.0, 1.5, 2.0):
            problem.set_time(time)
            outcome = solve(solver)
            assert outcome.converged and outcome.augmentation == factor
            u, q = solver.u_and_q()
            problem.commit(problem.trial(u, q))
            h = j.state
            states.append(np.column_stack([h.jump, h.force, h.path, h.dissipation]))
        statuses.append(np.array(states))
        assert (j.laws.augmentation <= factor * 5e3).all()
    size = np.abs(statuses[0]).max(axis=(0, 1))
    assert (np.abs(statuses[1] - statuses[0]).max(axis=(0, 1)) <= 1e-8 * size).all()
    assert statuses[0][-1, :, -1].sum() > 0


def test_point_laws_augmentation_remedies_restore_the_line_search(tmp_path: Path) -> None:
    """Another line search begins with defaults of PETSc, and would keep them."""

    def described(solver: Solver) -> str:
        viewer = PETSc.Viewer().createASCII(str(tmp_path / "snes.txt"))
        solver.snes.view(viewer)
        viewer.destroy()
        return (tmp_path / "snes.txt").read_text()

    _, solver = support.assemble(support.case(STEM, "solver.petsc.snes_linesearch_order=2"))
    before = described(solver)
    assert "quadratic" in before
    solver.use_search("basic")
    assert described(solver) != before
    solver.use_search("bt")
    assert described(solver) == before
