"""Explanations of failed solves."""

from __future__ import annotations

import logging
import re

from mpi4py import MPI

import numpy as np
import pytest

from app.foundation.errors import ConvergenceError
from app.numerics.newton import ActiveSet
from app.soundness.floating_bodies_of_state import texts_of_pulled_bodies
from tests import support
from tests.soundness.judged import TWO
from tests.support import CONFIGS


def test_failure_states_that_repeat_are_a_cycle() -> None:
    """Two points change in turn, one has settled, one has never moved."""
    active = ActiveSet(MPI.COMM_SELF)
    for k in range(7):
        active.add(np.array([k % 2, 1 + (k + 1) % 2, int(k > 1), 1]))
    assert active.changes() == 2 and active.period() == 2
    assert active.oscillating() == [(0, 6, 6, (0, 1)), (1, 6, 6, (1, 2))]
    active.add(np.array([2, 2, 1, 1]))
    assert active.period() == 0
    active.forget()
    assert active.changes() == 0
    assert active.period() == 0
    assert active.oscillating() == []


def test_failure_message_names_places_states_and_remedies(caplog: pytest.LogCaptureFixture) -> None:
    """Two iterations at a time do not suffice.

    The message has places, states, remedies, residuals.
    """
    caplog.set_level(logging.INFO, "mantle")
    case = (CONFIGS / "stress" / "stem.yaml").read_text()
    with pytest.raises(ConvergenceError) as caught:
        support.solve(case, "solver.max_iterations=2", "mesh.size=5 mm", "mesh.far_size=5 mm")
    text = str(caught.value)
    place = r"\(-?[\d.]+, -?[\d.]+, -?[\d.]+\) mm"
    assert re.search(
        rf"largest residual: .* N on interface '\w+' at {place}, (open|stick|slip)", text
    )
    changing = rf"changing: \w+ <-> .* on interface '\w+' at {place}, in \d+ of the last \d+ iter"
    assert len(re.findall(changing, text)) == 3
    (tried,) = [line for line in text.splitlines() if line.startswith("  tried: ")]
    logged = [m.partition("): ")[2] for m in caplog.messages if "not converging" in m]
    # As many as the log lists, and the best of them.
    assert len(logged) > 5
    best = re.search(
        r"tried: (\d+) remedies, of which the best \((.+)\) left a residual of [\d.]+e[-+]\d\d",
        tried,
    )
    assert best and int(best[1]) == len(logged) and best[2] in logged
    assert any(re.fullmatch(r"augmentation 0\.1 r \(up to [\d.e+]+ MPa/mm\)", m) for m in logged)
    assert "what to do: " in text


def test_failure_names_a_lifted_body() -> None:
    pull = "loads={pull: {kind: force, boundary: top, force: [0 N, 0 N, 500 N]}}"
    with pytest.raises(ConvergenceError, match="nothing holds body 'metal'"):
        support.solve(TWO, pull)


def test_failure_names_a_stem_off_its_taper() -> None:
    """Half of the load fails too, from rest and without gaps."""
    finer = "mesh.size=4 mm", "mesh.order=2"
    named = "100 % of it: nothing holds body 'stem': it is free to move along z, and the loads act"
    with pytest.raises(ConvergenceError, match=named) as caught:
        support.solve(support.STEM, *finer, "loads.hip.force=[0 N, 0 N, 2 N]")
    assert "steps of" not in str(caught.value)


@pytest.mark.parametrize(("push", "held"), [(70, True), (90, False)])
def test_failure_body_held_by_friction_is_not_lifted(push: float, held: bool) -> None:
    """A force of 200 N presses a block on another, with a friction of 0.4."""
    aside = f"loads.aside={{kind: force, boundary: top, force: [{push} N, 0 N, 0 N]}}"
    problem, _ = support.assemble(support.case(TWO, aside))
    problem.set_time(1.0)
    assert problem.contact
    reasons = texts_of_pulled_bodies(problem, problem.contact)
    assert held == (not reasons) and all(
        "'metal': it is free to move along x," in f for f in reasons
    )
