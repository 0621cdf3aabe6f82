"""Regions that set: stress in rate form, with a growing modulus."""

from __future__ import annotations

import numpy as np
import pytest

from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.results.stresses import Stresses
from tests.cases.heated import (
    BAR,
    CLAMPS,
    CYLINDERS,
    ORDERS,
    UNILATERAL,
    Heated,
    cure,
    expanding,
    setting,
)

E = 2200.0  # Young's modulus [MPa]
α_T = 8e-5  # thermal expansion [1/K]
GRADED = ("regions.cement.youngs_modulus=[[0 mm, 1 GPa], [1 mm, 3 GPa]]",)


@pytest.mark.parametrize("overrides", [(), UNILATERAL, GRADED])
@ORDERS
def test_setting_rate_form_equals_total_form_when_cured(
    order: int, overrides: tuple[str, ...]
) -> None:
    """Cement that is cured from the start is loaded in two steps.

    The result is that of elastic cement loaded at once.
    """
    more = (f"mesh.order={order}", "mesh.curved=false", *overrides)
    total = Heated.make(CYLINDERS, expanding(cement=α_T), *more)
    total.solve({"cement": 260.0})
    rate = Heated.make(CYLINDERS, setting(cure("cement", initial=1.0), cement=α_T), *more)
    for time, fall in ((0.5, 15.0), (1.0, 40.0)):
        rate.problem.set_time(time)
        rate.set(1.0, -α_T * fall, "cement")
        rate.step()
    assert rate.problem.stiffness.version == 0
    expected, by_rate = (m.problem.displacements()[-1].x.array for m in (total, rate))
    assert np.abs(by_rate - expected).max() < 1e-10 * np.abs(expected).max()
    for region in ("stem", "cement", "bone"):
        whole, steps = (m.stresses.mean(region) for m in (total, rate))
        assert np.abs(steps - whole).max() < 1e-9 * 12.5, region
    # At other points than those of the history, for risks: linear there, as strain is.
    fine = [Stresses(m.problem, fine={"cement"}).evaluate("cement") for m in (total, rate)]
    off = np.abs(fine[0] - fine[1]).max()
    assert off < (0.2 if overrides is GRADED else 1e-9) * 12.5
    assert rate.balance.energy < 1e-9


# A bar that sets while it cools: degree 0.6 to 1, temperature 350 K to 300 K, ever faster.
GEL = 0.625


def path(n: int) -> tuple[Floats, Floats]:
    """Degrees of cure and free strains since gelation at the ends of n steps."""
    s = np.linspace(0, 1, n + 1)
    return 0.6 + 0.4 * s, -α_T * 50 * np.maximum(s**2 - GEL**2, 0)


def cooled(n: int, order: int, *overrides: str) -> Heated:
    """A bar of one material that sets, cooled in n steps."""
    soft = "regions.two={youngs_modulus: 2200 MPa, poisson_ratio: 0.3}"
    change = setting(cure("one", 0.6), cure("two", 0.6), one=α_T, two=α_T)
    bar = Heated.make(BAR, change, soft, f"mesh.order={order}", *overrides)
    α, e = path(n)
    for k in range(1, n + 1):
        bar.problem.set_time(k / n)
        bar.set(α[k], e[k], "one", "two")
        bar.step()
    return bar


def test_setting_clamped_bar_that_cools() -> None:
    """The stress is -∫ g E α_T dθ from gelation on, of second order in the step."""
    s = np.linspace(GEL, 1.0, 200_001)
    g = 0.01 + 0.99 * (0.4 * s - 0.25) / 0.15
    exact = float(np.trapezoid(g * E * α_T * 100 * s, s))
    errors = []
    for n in (8, 16, 32):
        bar = cooled(n, 1, CLAMPS)
        σ = bar.stress("one")
        assert np.abs(σ - np.diag([0, 0, σ[0, 2, 2]])).max() < 1e-9
        assert bar.balance.energy < 1e-9
        errors.append(abs(σ[0, 2, 2] / exact - 1))
    assert errors[-1] < 2e-3
    assert errors[0] / errors[-1] > 12


@ORDERS
def test_setting_free_bar_has_no_stress(order: int) -> None:
    bar = cooled(5, order)
    assert np.abs(bar.stress("two")).max() < 1e-9 * E * α_T * 50


def test_setting_strain_before_gelation_leaves_no_stress() -> None:
    """The cement is stretched before gelation, then sets.

    Only the floor's part of the stress stays.
    """
    stretch = "supports.ceiling={kind: displacement, boundary: top, z: 0.09 mm}"
    one = "geometry.blocks=[{name: one, size: [4 mm, 3 mm, 9 mm]}]"
    bar = Heated.make(
        BAR,
        setting(cure("one", 0.5)),
        one,
        stretch,
        "regions={one: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}}",
    )
    bar.problem.set_time(1.0)
    bar.set(0.5, 0.0, "one")
    bar.step()
    assert bar.stress("one")[:, 2, 2] == pytest.approx(0.01 * E * 0.01)
    bar.set(1.0, 0.0, "one")
    bar.step()
    assert bar.stress("one")[:, 2, 2] == pytest.approx(0.01 * E * 0.01)
    assert bar.balance.energy < 1e-10


def test_setting_with_contact_and_varying_degree_of_cure() -> None:
    """The outside sets first.

    The error is of second order in the step, and balances close in every step.
    """
    stresses = {}
    for n in (3, 6, 12):
        model = Heated.make(
            CYLINDERS,
            setting(cure("cement", 0.7, shrinkage=0.01), cement=α_T),
            "mesh.order=1",
            "mesh.curved=false",
            "mesh.size=2 mm",
            "mesh.far_size=2 mm",
            *UNILATERAL,
        )
        for k in range(1, n + 1):
            s = k / n
            model.problem.set_time(s)
            model.set(
                lambda x, s=s: 0.85 + 0.15 * s * np.hypot(x[0], x[1]) / 10,
                lambda x, s=s: -2e-3 * s * s * np.hypot(x[0], x[1]) / 10,
                "cement",
            )
            model.step()
            assert max(model.balance.force, model.balance.energy) < 1e-8
        assert model.problem.stiffness.version >= n
        stresses[n] = model.stress("cement").mean(axis=0)
    first, second = (np.abs(stresses[a] - stresses[b]).max() for a, b in ((3, 6), (6, 12)))
    assert first / second == pytest.approx(4, rel=0.2)


def test_setting_refuses_eigenstrains() -> None:
    with pytest.raises(InputError, match="eigenstrains: a region that cures or creeps"):
        Heated.make(
            BAR,
            setting(cure("one")),
            "regions.one.eigenstrains=[{strain: 1e-3}]",
        )
