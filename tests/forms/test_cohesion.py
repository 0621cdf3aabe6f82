"""Cohesion at one point: energies, onset, crooked paths, unloading, slopes."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import pytest

from app.foundation.arrays import Floats
from app.laws.traction_laws import Cohesive
from app.mechanics.contact_state import ContactState, LocalPoints
from app.mechanics.point_forces import PointForces
from app.mechanics.point_laws import PointLaws
from app.mechanics.switches import Switches
from app.system.timing import Timing

K = 1e4  # stiffness [MPa/mm]
N = 2.0  # tensile strength [MPa]
S = 4.0  # shear strength [MPa]
G_I = 0.1  # energy in tension [N/mm]
G_II = 0.5  # energy in shear [N/mm]
ETA = 2.0  # exponent of the mixture
INTERNAL_VARIABLES: dict[str, tuple[int, ...]] = {"damage": (), "spent": ()}


class Points:
    """Points of a law that follow given jumps; forces are in equilibrium with the law."""

    def __init__(
        self,
        n: int,
        softening: str = "linear",
        faces: int = 1,
        μ: Sequence[float] = (0.0,),
        free: float = 0.0,
    ) -> None:
        normals, tensors = np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
        normals[:, :faces] = np.eye(3)[::-1][:faces]
        number, sides = np.arange(n), np.zeros((n, 2), dtype=np.int64)
        interface, x, given = np.arange(n) % len(μ), np.zeros((n, 3)), np.full(n, faces)
        points = LocalPoints(
            number, interface, x, sides, given, normals, np.ones(n), tensors, tensors
        )
        laws = [
            Cohesive.model_validate(
                {
                    "kind": "cohesive",
                    "friction_coefficient": friction,
                    "stiffness": f"{K} MPa/mm",
                    "tensile_strength": f"{N} MPa",
                    "shear_strength": f"{S} MPa",
                    "tensile_energy": f"{G_I} N/mm",
                    "shear_energy": f"{G_II} N/mm",
                    "mixing_exponent": ETA,
                    "softening": softening,
                    "unbonded": f"{100 * free} %",
                }
            )
            for friction in μ
        ]
        self.law = PointLaws(MPI.COMM_SELF, points, Timing())
        every = [{k: float(v) for k, v in law.constants.items()} for law in laws]
        values = {k: np.array([constants[k] for constants in every])[interface] for k in every[0]}
        values["μ"] = np.array(μ)[interface]
        self.law.begin(laws, values, 1.0, tensors + 1e3 * np.eye(3))
        self.state = ContactState.at_rest(n, INTERNAL_VARIABLES)
        self.force, self.work, self.spent = np.zeros((n, 3)), np.zeros(n), np.zeros(n)
        self.least = 0.0

    def at(self, force: Floats, jump: Floats) -> PointForces:
        """The law at a trial state."""
        none = Switches.off(len(jump))
        return self.law.evaluate(force, jump, np.zeros_like(jump), self.state, none)

    def lead(self, jump: Floats) -> PointForces:
        """Move the points to a jump and commit."""
        force, step = self.force, jump - self.state.jump
        for _ in range(3):  # the multiplier: nothing is pressed
            response = self.at(force, jump)
            force = response.force
        self.work = self.work + np.einsum("pi,pi->p", (force + self.force) / 2, step)
        used = response.outputs["dissipated"]
        self.least, self.spent = min(self.least, used.min()), self.spent + used
        self.force = force
        self.state.jump = jump
        self.state.internal_variables = dict(response.internal_variables)
        return response


@pytest.mark.parametrize("softening", ["linear", "exponential"])
def test_cohesion_energy_of_five_mixed_modes(softening: str) -> None:
    """Work and dissipation are G_I + (G_II - G_I) B^η; the peak is on the quadric of strengths."""
    angle = np.linspace(0, np.pi / 2, 5)
    towards = np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])
    points, peak = Points(5, softening), np.zeros(5)
    end = {"linear": 0.3, "exponential": 2.5}[softening]
    for size in (*np.linspace(1e-6, 0.01, 200), *np.geomspace(0.01, end, 300)[1:]):
        points.lead(size * towards)
        peak = np.maximum(peak, np.linalg.norm(points.force, axis=1))
    B = np.sin(angle) ** 2
    np.testing.assert_allclose(points.spent, G_I + (G_II - G_I) * B**ETA, rtol=1e-5)
    np.testing.assert_allclose(points.work, points.spent, rtol=5e-3)  # trapezoidal
    np.testing.assert_allclose(peak, 1 / np.sqrt((1 - B) / N**2 + B / S**2), rtol=1e-2)
    assert points.least >= 0


def test_cohesion_unloads_to_the_origin_without_damage_by_pressure() -> None:
    points, along = Points(1), np.array([[0.0, 0.0, 1.0]])
    points.lead(0.04 * along)
    kept, d = points.force.copy(), points.state.internal_variables["damage"].copy()
    assert 0 < d[0] < 1
    half = points.lead(0.02 * along)
    np.testing.assert_allclose(half.force, kept / 2, rtol=1e-9)
    assert half.outputs["dissipated"] == 0 and half.internal_variables["damage"] == d
    new = Points(1)
    pressed = new.lead(-0.01 * along)
    np.testing.assert_allclose(pressed.force, -0.01 * K * along)
    assert pressed.internal_variables["damage"] == 0


def test_cohesion_dissipates_on_nonproportional_paths() -> None:
    """Paths open then shear, and shear then open, with unloading. The work is between both G."""
    rng = np.random.default_rng(3)
    points = Points(40)
    corners = np.abs(rng.normal(size=(6, 40, 3))) * [0.06, 0.0, 0.03]
    corners[-1] = [0.4, 0.0, 0.4]
    last = np.zeros((40, 3))
    for corner in corners:
        for part in np.linspace(0, 1, 60)[1:]:
            points.lead(last + part * (corner - last))
        last = corner
    assert points.least >= -1e-12 * G_II
    assert (points.state.internal_variables["damage"] == 1).all()
    assert (points.spent > G_I * (1 - 1e-9)).all() and (points.spent < G_II * (1 + 1e-9)).all()


def test_cohesion_broken_share_has_friction() -> None:
    """A broken share has friction μ p. No bond is left in series with it."""
    points = Points(2, μ=(0.4,), free=1.0)
    pressed = np.tile([0.0, 0.0, -3.0], (2, 1))
    out = points.at(pressed, np.tile([0.5, 0.0, 0.0], (2, 1)))
    np.testing.assert_allclose(out.force[:, 0], 0.4 * 3.0, rtol=1e-9)
    np.testing.assert_allclose(
        out.debonded_friction_work, 0.4 * 3.0 * (0.5 - 1.2 / 1000), rtol=1e-9
    )
    each = Points(2, μ=(0.4, 0.2), free=1.0).at(pressed, np.tile([0.5, 0.0, 0.0], (2, 1)))
    np.testing.assert_allclose(each.force[:, 0], [0.4 * 3.0, 0.2 * 3.0], rtol=1e-9)
    # Contact beside a broken bond resists as contact alone: whole where it sticks.
    stuck = points.at(pressed, np.zeros((2, 3)))
    np.testing.assert_allclose(stuck.resisted, np.tile(np.eye(3), (2, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(out.resisted[:, 2, 2], 1.0, rtol=1e-9)
    assert not points.at(-pressed, np.tile([0.0, 0.0, 0.1], (2, 1))).resisted.any()
    share = Points(1, μ=(0.4,), free=0.25)
    slid = share.at(pressed[:1], np.array([[1e-4, 0.0, 0.0]]))
    assert slid.force[0, 0] == pytest.approx(0.75 * K * 1e-4, abs=0.25 * 0.4 * 3.0 + 1e-9)


@pytest.mark.parametrize("faces", [1, 2, 3])
@pytest.mark.parametrize("softening", ["linear", "exponential"])
def test_cohesion_slopes_are_derivatives(faces: int, softening: str) -> None:
    """Central differences are taken at whole, damaged, broken, open, stuck and sliding points."""
    n, rng = 300, np.random.default_rng(faces)
    points = Points(n, softening, faces, μ=(0.4,))
    damage = np.where(np.arange(n) < 80, 0.0, rng.uniform(0, 1, n))
    points.state.internal_variables = {"damage": damage, "spent": 0.3 * damage}
    points.state.jump = 1e-3 * rng.normal(size=(n, 3))
    jump, force = 3e-3 * rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    base = points.at(force, jump)
    for of_jump, slope, size in ((True, base.by_jump, 1e-8), (False, base.by_multiplier, 1e-4)):
        step = size * rng.normal(size=(n, 3))
        up, down = (
            points.at(force + k * step * (not of_jump), jump + k * step * of_jump) for k in (1, -1)
        )
        linear = np.einsum("pij,pj->pi", slope, step)
        error = np.abs((up.force - down.force) / 2 - linear).max(axis=1)
        smooth = (up.status == down.status) & (np.abs(up.force - down.force).max(axis=1) < 1)
        assert smooth.mean() > 0.95
        assert np.quantile(error[smooth], 0.98) < 1e-6 * max(np.abs(linear).max(), 1e-9)
        spent = (up.outputs["dissipated"] - down.outputs["dissipated"]) / 2
        if of_jump:
            expected = np.einsum("pi,pi->p", base.outputs["dissipated_by_jump"], step)
            assert np.quantile(np.abs(spent - expected), 0.98) < 1e-6 * np.abs(expected).max()
