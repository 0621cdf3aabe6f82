"""Static condensation: S, inverse of the Jacobian, choice of the method, errors in S."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from app.numerics import substructures
from app.numerics.choice import SolverChoice
from app.numerics.condensed import Condensed
from app.numerics.krylov import condition_number
from app.numerics.mumps import Mumps
from app.numerics.paired_compliance import PairedCompliance
from tests import support

CONDENSED = "solver.linear=condensed"


def test_condensed_bodies_with_new_pairs_reuse_factors() -> None:
    """S and displacements of a floating body with new pairs agree with dense matrices."""
    random = np.random.default_rng(2)
    held, loose = (v @ v.T + np.eye(9) for v in random.normal(size=(2, 9, 9)))
    ways = np.linalg.qr(random.normal(size=(9, 3)))[0]
    stays = np.eye(9) - ways @ ways.T
    loose = stays @ loose @ stays
    Q1, Q2 = random.normal(size=(2, 9, 9))
    tied = [np.block([[loose + Q.T @ held @ Q, Q.T @ held], [held @ Q, held]]) for Q in (Q1, Q2)]
    K, C = tied[1][:9, :9], tied[1][:9, 9:]
    compliance = PairedCompliance(tied[0].copy(), csr_array(Q1))
    S = held - C.T @ np.linalg.solve(K, C)
    np.testing.assert_allclose(compliance.constrain(csr_array(Q2)), S, atol=1e-9)
    g, q = random.normal(size=18), random.normal(size=9)
    forces, v = compliance.solve(g, q)
    # Forces g and motions are those of the first ties: g on m also acts through the points.
    m = np.linalg.solve(K, g[:9] + (Q2 - Q1).T @ g[9:] - C @ q)
    np.testing.assert_allclose(v, np.concatenate([m, q + (Q2 - Q1) @ m]), atol=1e-9)
    np.testing.assert_allclose(forces, C.T @ m + held @ q - g[9:], atol=1e-9)


# Order, unknowns of displacement and jumps, million entries of the factors; the number of solves
# from which it pays: measured on a hip's mesh, beside multigrid.
MEASURED = [
    ((2, 23_730, 1_488, 15.6), 1),
    ((2, 45_819, 2_412, 38.5), 1),
    ((2, 90_072, 4_242, 96.9), 2),
    ((2, 120_024, 5_250, 148), 4),
    ((1, 4_818, 1_584, 2.9), 4),
    ((1, 97_335, 12_774, 213), np.inf),
    ((2, 853_299, 15_078, 2_038), np.inf),
]


@pytest.mark.parametrize(("size", "least"), MEASURED)
def test_condensed_method_is_chosen_by_size(size: tuple[int, ...], least: float) -> None:
    order, unknowns, jumps, entries = size
    for solves in (1, 2, 4):
        guessed = SolverChoice(order, unknowns, jumps, solves)
        known = replace(guessed, entries=1e6 * entries)
        assert known.condenses("auto") == (solves >= least)
        assert guessed.memory_needed == pytest.approx(known.memory_needed, rel=0.2)
        assert not replace(known, memory=known.memory_needed).condenses("condensed")


def test_condensed_method_states_memory_in_plain_numbers() -> None:
    text = SolverChoice(2, 2_664_960, 53_784, 1, memory=16e9).description("auto", False)
    assert re.search(r"condensation needs [1-9][0-9]{1,2} GB of memory and may take 8 GB", text)


LAWS = [
    "{kind: contact, friction_coefficient: 0.4}",
    "{kind: contact, friction_coefficient: 0}",
    "{kind: contact, friction_coefficient: 0.3, gap: 5 um}",
    "{kind: penalty, friction_coefficient: 0.4, penalty: 500 MPa/mm}",
]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("order", [1, 2])
def test_condensed_jumps_equal_krylov_jumps(law: str, order: int) -> None:
    changes = f"mesh.order={order}", f"interfaces.stem_cement={law}"
    krylov = support.solve(support.STEM, *changes, "solver.linear=multigrid")
    condensed = support.solve(support.STEM, *changes, CONDENSED)
    assert condensed.solver.linear.exact and not krylov.solver.linear.exact
    expected, condensed_state = (s.problem.contact.state.jump for s in (krylov, condensed))
    assert condensed_state == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.mark.skipif(substructures.factor_class() is Mumps, reason="PETSc has no CHOLMOD")
def test_condensed_jumps_equal_with_mumps_factors(monkeypatch: pytest.MonkeyPatch) -> None:
    """MUMPS is used if there is no CHOLMOD. Rounding grows by the condition number of K."""
    law = f"interfaces.stem_cement={LAWS[0]}"
    expected = support.solve(support.STEM, "mesh.order=2", law, CONDENSED)
    monkeypatch.setattr(substructures, "factor_class", lambda: Mumps)
    condensed_state = support.solve(support.STEM, "mesh.order=2", law, CONDENSED)
    a, b = (s.problem.contact.state.jump for s in (expected, condensed_state))
    rounding = np.finfo(float).eps * condition_number(expected.problem.stiffness.K)
    assert rounding < 1e-11
    assert b == pytest.approx(a, abs=rounding * np.abs(a).max())
    assert not np.array_equal(a, b)


def exchanged(c: Condensed) -> None:
    c._S[:, [0, 40]] = c._S[:, [40, 0]]


def doubled(c: Condensed) -> None:
    c._S[np.diag_indices(len(c._S))] *= 2.0


@pytest.mark.parametrize("error", [exchanged, doubled])
def test_condensed_error_in_schur_complement_fails_to_converge(
    error: Callable[[Condensed], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Newton tests the residual of the whole system, which does not depend on S."""
    right = Condensed.renew

    def wrong(self: Condensed) -> None:
        current = self._matrix_version
        right(self)
        if current != self._matrix_version:
            error(self)
            self._S_single = self._S.astype(np.float32)

    monkeypatch.setattr(Condensed, "renew", wrong)
    with pytest.raises(support.mantle.ConvergenceError):
        support.solve(support.STEM, CONDENSED)


def test_condensed_bodies_are_factored_again_after_a_released_support() -> None:
    """Newton in the jumps then needs no fallback to the whole system."""
    held = "supports.held={kind: roller, boundary: stem_top, axis: x, stages: [first]}"
    stages = "stages=[{name: first}, {name: second}]"
    history = "loads.hip.history=[1, 1.2]"
    solved = support.solve(support.STEM, CONDENSED, held, stages, history)
    assert [step.outcome.linear_iterations for step in solved.steps] == [0, 0]
    assert solved.steps[1].outcome.iterations > 1


def test_condensed_cycles_start_from_extrapolated_cycles() -> None:
    """A line through two cycles leaves a tenth of the error of repeating the last one."""
    walk = "stages=[{name: walk, cycles: 8, valley: 0.1}]"
    solved = support.solve(support.STEM, "mesh.order=2", walk, CONDENSED)
    first, *_, last = (step.outcome.iterations for step in solved.steps[2:])
    assert last <= 2 < first


def test_condensed_singular_jacobian_names_the_floating_body() -> None:
    """Motions of the body make the Jacobian in the jumps singular, so no step helps."""
    gaps = [f"interfaces.{name}.gap=0.1 mm" for name in ("stem_cement", "cement_bone")]
    lifted = "interfaces.cement_bone.friction_coefficient=0.4", "loads.hip.force=[0 N, 0 N, 1 N]"
    with pytest.raises(support.mantle.ConvergenceError, match="nothing holds body 'stem'"):
        support.solve(support.STEM, CONDENSED, *gaps, *lifted)
