"""Heat at interfaces: signs, derivatives, second law; the forms as compiled, at points."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.foundation.arrays import Floats
from app.numerics.pointwise import Pointwise
from forms import interface_heat

N = 60
NAMES = ("p", "τ", "open", "per_pressure", "cap")


@pytest.fixture(scope="module")
def law() -> Pointwise:
    """Flux, its derivatives and the conductance at N points."""
    return Pointwise(
        MPI.COMM_SELF,
        N,
        dict.fromkeys(NAMES, 1),
        lambda x: [
            *interface_heat.flux_and_derivatives(*(x[n] for n in NAMES)),
            interface_heat.conductance(*(x[n] for n in ("p", "open", "per_pressure", "cap"))),
        ],
    )


def random(seed: int) -> dict[str, Floats]:
    """Pressures of both signs, jumps of both signs, caps that do and do not bind."""
    rng = np.random.default_rng(seed)
    return {
        "p": rng.uniform(-3.0, 6.0, N),
        "τ": rng.uniform(-60.0, 60.0, N),
        "open": 10 ** rng.uniform(-4.0, 1.0, N),
        "per_pressure": rng.choice([0.0, 0.1, 2.0], N),
        "cap": rng.choice([np.inf, 0.5, 2.0], N),
    }


def test_interface_heat_conductance_grows_with_pressure_up_to_its_cap(law: Pointwise) -> None:
    """E9: h = h_o + h_p |p| in compression, at least that of an open interface, at most the cap."""
    x = random(0)
    h = law(**x)[3]
    closed = x["open"] + x["per_pressure"] * np.where(x["p"] > 0, x["p"], 0.0)
    assert h == pytest.approx(np.minimum(closed, x["cap"]), rel=1e-14)
    assert (closed > x["cap"]).any() and (x["p"] < 0).any()


def test_interface_heat_flows_from_hot_to_cold(law: Pointwise) -> None:
    """E4: the heat into the slave is h (θ - θ') = -h τ; its derivatives are by hand."""
    x = random(1)
    q, by_jump, by_pressure, h = law(**x)
    assert q == pytest.approx(-h * x["τ"], rel=1e-14)
    assert (q * x["τ"] <= 0).all()
    assert by_jump == pytest.approx(-h, rel=1e-14)
    sloped = (x["p"] > 0) & (x["open"] + x["per_pressure"] * x["p"] < x["cap"])
    assert by_pressure == pytest.approx(np.where(sloped, -x["per_pressure"] * x["τ"], 0.0))
    assert sloped.any() and (~sloped).any()


def test_interface_heat_of_friction_goes_to_both_sides() -> None:
    """E10: each side gets a part of D. The printed equation gives +D and -D, whose sum is zero."""
    master, slave = interface_heat.friction_heat(3.0, 0.34)
    assert (master, slave) == pytest.approx((3.0 * 0.66, 3.0 * 0.34))
    assert master + slave == pytest.approx(3.0)


temperatures = st.floats(200.0, 500.0)


@given(
    temperatures,
    temperatures,
    st.floats(0.0, 1e6),
    st.floats(0.0, 100.0),
    st.floats(0.0, 1.0),
)
def test_interface_heat_entropy_production_is_not_negative(
    θ: float, θ_slave: float, h: float, D: float, β: float
) -> None:
    q = h * (θ - θ_slave)
    made = interface_heat.entropy_production(q, D, β, θ, θ_slave)
    assert made >= 0.0
    # Heat that leaves at one temperature and arrives at another, and friction heat.
    gained = (q + β * D) / θ_slave - (q - (1 - β) * D) / θ
    # Next to nothing rounds to nothing: only normal numbers can be compared.
    assert made == pytest.approx(gained, rel=1e-6, abs=max(1e-9 * (abs(q) + D), 1e-300))
    # With the sign of the paper's first conduction law it would be lost.
    assert interface_heat.entropy_production(-q, 0.0, β, θ, θ_slave) <= 0.0
