"""Switches of remedies at contact points: one face with the normal z, forces by hand."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np

from app.foundation.arrays import Floats
from app.laws.contact_laws import Contact
from app.mechanics.contact_state import ContactState, LocalPoints
from app.mechanics.point_forces import PointForces
from app.mechanics.point_laws import PointLaws
from app.mechanics.switches import Switches
from app.system.timing import Timing
from forms.contact import OPEN, SLIP, STICK

R = 100.0  # augmentation [MPa/mm]
MU = 0.5
# Trial forces: a point that slips, one that sticks, one that is open.
FORCE = np.array([[9.0, 0.0, -10.0], [3.0, 0.0, -10.0], [3.0, 0.0, 10.0]])


def forces(switches: Switches) -> PointForces:
    """The contact law under `FORCE`, at zero jumps."""
    n = len(FORCE)
    normals, tensors = np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
    normals[:, 0, 2] = 1.0
    none, zeros = np.zeros((n, 3)), np.zeros(n, dtype=np.int64)
    sides = np.zeros((n, 2), dtype=np.int64)
    points = LocalPoints(
        np.arange(n), zeros, none, sides, zeros + 1, normals, np.ones(n), tensors, tensors
    )
    laws = PointLaws(MPI.COMM_SELF, points, Timing())
    stiffness = np.tile(R * np.eye(3), (n, 1, 1))
    laws.begin([Contact(friction_coefficient=MU)], {"μ": np.full(n, MU)}, 1.0, stiffness)
    return laws.evaluate(FORCE, none, none, ContactState.at_rest(len(none), {}), switches)


def rows(*values: list[float]) -> Floats:
    return np.array(values)


def test_switches_off_is_coulombs_law() -> None:
    out = forces(Switches.off(3))
    np.testing.assert_allclose(out.force, rows([5, 0, -10], [3, 0, -10], [0, 0, 0]), atol=1e-12)
    assert out.status.tolist() == [SLIP, STICK, OPEN]
    np.testing.assert_allclose(out.trial_force, FORCE)


def test_switches_stuck_points_stick() -> None:
    """They carry the whole trial force, in tension too, with the stiffness r."""
    stuck = np.array([True, False, True])
    out = forces(replace(Switches.off(3), stuck=stuck))
    np.testing.assert_allclose(out.force, rows([9, 0, -10], [3, 0, -10], [3, 0, 10]), atol=1e-12)
    assert out.status.tolist() == [STICK, STICK, STICK]
    np.testing.assert_allclose(out.by_jump[stuck], np.tile(R * np.eye(3), (2, 1, 1)))


def test_switches_opened_points_have_no_force() -> None:
    out = forces(replace(Switches.off(3), opened=np.array([True, False, False])))
    np.testing.assert_allclose(out.force, rows([0, 0, 0], [3, 0, -10], [0, 0, 0]), atol=1e-12)
    assert out.status.tolist() == [OPEN, STICK, OPEN]
    assert not out.by_multiplier[0].any() and not out.pressures[0].any()


def test_switches_tresca_friction_is_limited_by_given_pressures() -> None:
    """The limits are 2, 2 and 0 MPa for given pressures of 4, 4 and 0 MPa.

    The pressures are those of the state.
    """
    given = rows([0, 0, -4], [0, 0, -4], [0, 0, 4])
    out = forces(replace(Switches.off(3), tresca_trial_force=given))
    np.testing.assert_allclose(out.force, rows([2, 0, -10], [2, 0, -10], [0, 0, 0]), atol=1e-12)
    np.testing.assert_allclose(out.pressures[:, 0], [10, 10, 0], atol=1e-12)
    assert out.status.tolist() == [SLIP, SLIP, OPEN]
    # The friction no longer changes with the pressure of the state.
    np.testing.assert_allclose(out.by_multiplier[0], np.diag([0, 2 / 9, 1]), atol=1e-12)


def test_switches_tresca_friction_without_pressures_is_none() -> None:
    out = forces(replace(Switches.off(3), tresca_trial_force=np.zeros((3, 3))))
    np.testing.assert_allclose(out.force, rows([0, 0, -10], [0, 0, -10], [0, 0, 0]), atol=1e-12)
