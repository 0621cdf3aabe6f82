"""Regions of different temperature in perfect contact, from the first instant."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from app.campaigns.work_precision import fitted_order
from app.verification.closed_forms_heat import HalfSpaces
from tests import support
from tests.cases import coupled

TEXT = (support.CONFIGS / "verification" / "half_spaces.yaml").read_text()
SPACES = HalfSpaces((0.2, 1.2e-6 * 1.45e6), (0.58, 1.85e-6 * 1.26e6), (100.0, 37.0))
SECONDS = 10.0
SIZES = (1.0, 0.5, 0.25)


@cache
def half_spaces(size: float, *overrides: str) -> coupled.Coupled:
    """Cement of 100 degC on bone of 37 degC, on cells of one size [mm]."""
    blocks = [f"geometry.blocks.{k}.size=[{size} mm, {size} mm, 8 mm]" for k in (0, 1)]
    mesh = [f"mesh.{key}={size} mm" for key in ("size", "far_size")]
    bone = "regions.bone.tissue=bone"
    with pytest.MonkeyPatch.context() as patch:
        return coupled.solve(patch, *blocks, *mesh, bone, *overrides, text=TEXT)


def interface(run: coupled.Coupled) -> np.ndarray:
    """Hottest temperatures of the bone [degC], at its interface."""
    return np.array([row["bone temperature_max [degC]"] for row in run.rows])


@pytest.mark.parametrize("h", SIZES)
def test_first_contact_has_half_space_temperature(h: float) -> None:
    """The error at every step falls with the mesh.

    Before, the temperature began at 63.9 degC instead of 58.2. The time above 56 degC is the whole
    time, and CEM43 is R^(43 - T) of it.
    """
    T = interface(half_spaces(h))
    assert np.abs(T - SPACES.contact).max() < 0.1
    assert h < 1.0 or T[0] == pytest.approx(SPACES.contact, abs=1e-9)
    summary = half_spaces(h).model.thermal.record.summary()["regions"]["bone"]
    assert summary["temperature_max"] == pytest.approx(SPACES.contact, abs=0.1)
    assert summary["seconds_over_56"] == pytest.approx(SECONDS, rel=1e-9)
    minutes = 2.0 ** (SPACES.contact - 43.0) * SECONDS / 60.0
    assert summary["cem43_max"] == pytest.approx(minutes, rel=0.02)


def test_first_contact_converges_in_time() -> None:
    """The error is that of the largest temperature of the bone, over tolerances of a step."""
    for tolerance in (1.0, 0.1, 0.01):
        T = interface(half_spaces(0.5, f"time.tolerance={tolerance} K"))
        assert T.max() == pytest.approx(SPACES.contact, abs=0.1), tolerance


def test_first_contact_equal_steps_converge_at_first_order() -> None:
    """Backward Euler is used. The mean temperature of the bone is the transferred heat."""
    e = np.sqrt(0.2 * 1.2e-6 * 1.45e6)
    came = e * (100.0 - SPACES.contact) * 2 * np.sqrt(SECONDS / np.pi)
    exact = 37.0 + came / (1.85e-6 * 1.26e6 * 8.0)
    steps = (4.0, 16.0, 64.0)
    errors = []
    for n in steps:
        run = half_spaces(
            0.25,
            "time.method=backward_euler",
            f"stages.0.increments={n:g}",
            "stages.0.adaptive=false",
        )
        summary = run.model.thermal.record.summary()["regions"]["bone"]
        errors.append(abs(summary["temperature_mean"] - exact))
    assert fitted_order([1 / n for n in steps], errors) > 0.9, errors


def test_first_contact_does_not_change_a_steady_state() -> None:
    """The temperature is linear between given temperatures, for cells with any time constant."""
    ends = "heat={hot: {kind: temperature, boundary: bottom, temperature: 100 degC}, cold: "
    ends += "{kind: temperature, boundary: top, temperature: 37 degC}}"
    run = half_spaces(1.0, ends, "stages=[{name: rest, steady: true}]")
    bone = run.model.thermal.record.row["bone temperature_max [degC]"]
    assert bone == pytest.approx((100.0 * 0.2 + 37.0 * 0.58) / 0.78, abs=1e-6)
