"""Contact on the debonded share: forces by hand, derivatives by differences, its assumption."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

from app.foundation.arrays import Floats
from app.laws.contact_laws import Contact
from app.laws.traction_laws import Cohesive
from app.mechanics.contact_state import ContactState, LocalPoints
from app.mechanics.debonded_contact import DebondedContact, Debonding, debonded_contact
from app.mechanics.point_forces import PointForces
from app.mechanics.point_laws import PointLaws
from app.mechanics.prescribed_slip import Inputs, Outputs
from app.mechanics.switches import Switches
from app.system.timing import Timing
from forms.contact import OPEN, SLIP, STICK

K = 50.0  # stiffness of the cohesion [MPa/mm]
R = 100.0  # augmentation [MPa/mm]
MU = 0.4
EYE = np.eye(3)


def coulomb(inputs: Inputs) -> Outputs:
    """Coulomb's law of points with the normal z, in numpy."""
    F, r, μ = inputs["multiplier"], inputs["r"][:, None], inputs["μ"]
    S = F + r * (inputs["jump"] + inputs["initial_gap"])
    T = (F + r * (inputs["jump"] - inputs["jump_old"])) * [1.0, 1.0, 0.0]
    pressure, size = np.maximum(-S[:, 2], 0), np.linalg.norm(T, axis=1)
    sticks = size <= μ * pressure
    ratio = np.where(sticks, 1.0, μ * pressure / np.where(sticks, 1.0, size))
    t = T / np.where(size > 0, size, 1.0)[:, None]
    slipping = np.where(~sticks & (pressure > 0), 1.0, 0.0)
    P = ratio[:, None, None] * np.diag([1.0, 1.0, 0.0])
    P = P - np.einsum("p,pi,pj->pij", slipping * ratio, t, t)
    P = P + np.einsum("p,pi,j->pij", slipping * μ, t, -EYE[2])
    P = P + (pressure > 0)[:, None, None] * np.outer(EYE[2], EYE[2])
    return {
        "force": ratio[:, None] * T - pressure[:, None] * EYE[2],
        "by_multiplier": P,
        "pressures": pressure[:, None],
        "status": np.where(pressure == 0, OPEN, np.where(sticks, STICK, SLIP)).astype(float),
    }


def cohesion(jump: Floats) -> Debonding:
    """Cohesion whose debonded share grows with the jump: s = q_x/2 (0 to 1), T = (1-s) K q."""
    n, share = len(jump), np.clip(jump[:, 0] / 2, 0.0, 1.0)
    share_by_jump = np.zeros((n, 3))
    share_by_jump[:, 0] = np.where((share > 0) & (share < 1), 0.5, 0.0)
    traction_by_jump = (1 - share)[:, None, None] * K * EYE
    traction_by_jump = traction_by_jump - K * jump[:, :, None] * share_by_jump[:, None, :]
    return Debonding((1 - share)[:, None] * K * jump, traction_by_jump, share, share_by_jump)


def points_of(normals: Floats, faces: int) -> LocalPoints:
    """Points with normals (n, 3, 3), free of supports, on 1 mm2 each."""
    n = len(normals)
    none, sides, tensors = np.zeros((n, 3)), np.zeros((n, 2), dtype=np.int64), np.zeros((n, 3, 3))
    interface, count = np.zeros(n, dtype=np.int64), np.full(n, faces)
    return LocalPoints(
        np.arange(n), interface, none, sides, count, normals, np.ones(n), tensors, tensors
    )


def contact_at(force: Floats, jump: Floats, prescribed: Floats | None = None) -> DebondedContact:
    n = len(jump)
    none = np.zeros((n, 3))
    inputs = {
        "multiplier": force,
        "jump": jump,
        "jump_old": none,
        "initial_gap": none,
        "r": np.full(n, R),
        "μ": np.full(n, MU),
    }
    normals = np.zeros((n, 3, 3))
    normals[:, 0, 2] = 1.0
    prescribed_tangents = np.tile(0 * EYE if prescribed is None else prescribed, (n, 1, 1))
    return debonded_contact(coulomb, inputs, cohesion(jump), normals, prescribed_tangents)


def test_debonded_contact_has_the_friction_of_its_share() -> None:
    """A point with the share s = 1/4 under the pressure p = 8 MPa slips at s μ p = 0.8 MPa.

    The multiplier is in equilibrium: the traction T and the contact force. The work is friction
    times the slip of 0.5 mm.
    """
    jump = np.array([[0.5, 0.0, 0.0]])
    force = np.array([[0.75 * K * 0.5 + 0.8, 0.0, -8.0]])
    contact = contact_at(force, jump)
    np.testing.assert_allclose(contact.force, [[0.25 * MU * 8.0, 0.0, -8.0]], rtol=1e-12)
    np.testing.assert_allclose(contact.pressures, [[8.0]])
    assert contact.status.tolist() == [SLIP]
    np.testing.assert_allclose(contact.friction_work, [0.8 * 0.5], rtol=1e-12)
    # Off equilibrium by 1 MPa, the slip is longer by 1 MPa over r.
    off = contact_at(force + EYE[:1], jump)
    np.testing.assert_allclose(off.friction_work, [0.8 * (0.5 + 1.0 / R)], rtol=1e-12)


def test_debonded_contact_does_not_act_on_bonded_or_opened_points() -> None:
    """Points with the debonded shares 0, 1, 1 and 1/2 under the trial pressure 8 MPa.

    The third one is opened, and contact acts on the second and the fourth. On the second, whose
    trial force along x is r q = 6 MPa, friction is at its limit of μ p = 3.2 MPa. The limit of the
    fourth is half of it.
    """
    share = np.array([0.0, 1.0, 1.0, 0.5])
    normals = np.zeros((4, 3, 3))
    normals[:, 0, 2] = 1.0
    law = Cohesive.model_validate(
        {
            "kind": "cohesive",
            "friction_coefficient": MU,
            "stiffness": f"{K} MPa/mm",
            "tensile_strength": "1e6 MPa",
            "shear_strength": "1e6 MPa",
            "tensile_energy": "1e12 N/mm",
            "shear_energy": "1e12 N/mm",
            "unbonded": 0.5,
        }
    )
    values = {name: np.full(4, float(value)) for name, value in law.constants.items()}
    values |= {"unbonded": share, "μ": np.full(4, MU)}
    laws = PointLaws(MPI.COMM_SELF, points_of(normals, 1), Timing())
    laws.begin([law], values, R, np.tile(EYE, (4, 1, 1)))
    rest, jump = ContactState.at_rest(4, {"damage": (), "spent": ()}), np.tile([0.06, 0, 0], (4, 1))
    # The cohesion of the bonded share carries its part of the shear.
    traction = (1 - share)[:, None] * K * jump
    switches = replace(Switches.off(4), opened=np.arange(4) == 2)
    out = laws.evaluate(traction - 8.0 * EYE[2], jump, 0 * jump, rest, switches)
    friction = np.array([0.0, MU * 8.0, 0.0, 0.5 * MU * 8.0])
    pressure = np.array([0.0, 8.0, 0.0, 8.0])
    np.testing.assert_allclose(out.pressures[:, 0], pressure, rtol=1e-12)
    expected = traction + friction[:, None] * EYE[0] - pressure[:, None] * EYE[2]
    np.testing.assert_allclose(out.force, expected, atol=1e-12)
    # The slip of the law is (S - P) / r.
    slip = jump[:, 0] - friction / R
    np.testing.assert_allclose(out.debonded_friction_work, friction * slip, atol=1e-12)


@pytest.mark.parametrize("prescribed", [None, np.diag([0.0, 1.0, 0.0])], ids=["free", "held y"])
def test_debonded_contact_slopes_are_derivatives(prescribed: Floats | None) -> None:
    """Central differences at points that are open, stick and slip, with a growing share."""
    n, rng = 400, np.random.default_rng(3)
    jump = np.column_stack([rng.uniform(0.2, 1.8, n), 0.1 * rng.normal(size=(n, 2))])
    # Trial forces of contact near the friction limit, so that all states occur.
    trial = rng.normal(size=(n, 3)) * [2.0, 2.0, 10.0]
    force = cohesion(jump).traction + trial - R * jump
    base = contact_at(force, jump, prescribed=prescribed)
    assert {OPEN, STICK, SLIP} == set(base.status.tolist())
    step = rng.normal(size=(n, 3))
    for by_jump, size, slope in ((1, 1e-7, base.by_jump), (0, 1e-5, base.by_multiplier)):
        up, down = (
            contact_at(
                force + k * size * (1 - by_jump) * step,
                jump + k * size * by_jump * step,
                prescribed=prescribed,
            )
            for k in (1, -1)
        )
        same = (up.status == down.status) & (up.status == base.status)
        assert same.mean() > 0.95
        difference = (up.force - down.force) / (2 * size)
        error = np.abs(difference - np.einsum("pij,pj->pi", slope, step)).max(axis=1)
        assert error[same].max() < 1e-5 * np.abs(difference).max()


@pytest.mark.parametrize("faces", [1, 2])
def test_debonded_contact_may_assume_friction_proportional_to_its_coefficient(faces: int) -> None:
    """In `forms.contact`, twice the coefficient gives twice the friction of points that slip.

    The derivative with respect to the debonded share relies on this.
    """
    n, rng = 500, np.random.default_rng(faces)
    normals = np.zeros((n, 3, 3))
    normals[:, :faces] = EYE[:faces]
    pressure = np.zeros((n, 3))
    pressure[:, :faces] = rng.uniform(1, 5, size=(n, faces))
    force = rng.normal(size=(n, 3)) * 5.0
    force = np.where(np.arange(3) < faces, 0.0, force) - pressure
    low, high = (response(force, normals, faces, μ) for μ in (0.1, 0.2))
    slips = (low.status == SLIP) & (high.status == SLIP)
    assert slips.sum() > 200
    friction = [out.force + pressure for out in (low, high)]
    np.testing.assert_allclose(friction[1][slips], 2 * friction[0][slips], atol=1e-12)
    size = np.linalg.norm(friction[0][slips], axis=1)
    np.testing.assert_allclose(size, 0.1 * pressure[slips].sum(axis=1), rtol=1e-12)


def response(force: Floats, normals: Floats, faces: int, μ: float) -> PointForces:
    """The compiled contact law at zero jumps."""
    n = len(force)
    none, points = np.zeros((n, 3)), points_of(normals, faces)
    laws = PointLaws(MPI.COMM_SELF, points, Timing())
    laws.begin(
        [Contact(friction_coefficient=μ)], {"μ": np.full(n, μ)}, 1.0, np.tile(EYE, (n, 1, 1))
    )
    return laws.evaluate(force, none, none, ContactState.at_rest(len(none), {}), Switches.off(n))
