"""The demos of the manual: each runs on import, and a formula gives one of its numbers."""

from __future__ import annotations

import math
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import support

DEMOS = support.ROOT / "docs" / "demos"
LINES = 80


def numbers(name: str) -> dict[str, Any]:
    """Names and values of a demo after it has run."""
    return runpy.run_path(str(DEMOS / f"{name}.py"))


@pytest.mark.parametrize("path", sorted(DEMOS.glob("*.py")), ids=lambda path: path.stem)
def test_demos_are_short_and_tested(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LINES
    assert f"test_demos_{path.stem}" in globals()


def test_demos_patch_test() -> None:
    """Pressure is uniform, and two columns shorten by 3 MPa (2 mm/1 GPa + 2 mm/2 GPa)."""
    result = numbers("patch_test")
    assert result["pressure"] == pytest.approx(3.0, rel=1e-9)
    assert result["shortening"] == pytest.approx(0.009, rel=1e-9)


def test_demos_hertz() -> None:
    """The formula is p_0 = sqrt(F E* / (pi R)).

    Cells have 0.1 to 0.3 of the half-width of contact.
    """
    result = numbers("hertz")
    exact = math.sqrt(result["F"] * 1000 / (2 * 0.91) / (math.pi * 50))
    assert result["peak"] == pytest.approx(exact, rel=0.02)


def test_demos_incline() -> None:
    """At rest T / N = tan 12 deg. A block on 20 deg slides, because this is beyond arctan 0.3."""
    result = numbers("incline")
    assert result["at_rest"] == pytest.approx(math.tan(math.radians(12)), rel=1e-8)
    assert "nothing holds body 'block'" in result["sliding"]


def test_demos_press_fit() -> None:
    """Lame's pressure holds for tubes with the radii 3, 5 and 7 mm; facets are flat."""
    exact = 0.01 / 5 / ((74 / 24 + 0.3) / 17e3 + (34 / 16 - 0.3) / 110e3)
    assert numbers("press_fit")["pressure"] == pytest.approx(exact, rel=2e-3)


def test_demos_friction_heat() -> None:
    """The rise is mu p v L / k with 0.3, 2 MPa, 0.02 mm/s, 2 mm and 0.2 mW/(mm K)."""
    exact = 0.3 * 2 * 0.02 * 2 / 0.2
    assert numbers("friction_heat")["rise"] == pytest.approx(exact, rel=5e-3)


def test_demos_setting_cement() -> None:
    """The degree comes from quadrature, the temperature is T_0 + (Q / C) (a - a_0)."""
    result = numbers("setting_cement")
    assert result["degree"] == pytest.approx(0.9, abs=1e-4)
    assert result["temperature"] == pytest.approx(296 + 155 / 1.752 * 0.89, abs=0.01)


def test_demos_double_cantilever() -> None:
    """J is the fracture energy 0.25 N/mm, except for growth by facets of 1 mm."""
    assert numbers("double_cantilever")["J"] == pytest.approx(0.25, rel=0.03)


def test_demos_ball_in_cup() -> None:
    """The torque is mu sum p s dA, because every point slides.

    Positions are those of the unloaded cup.
    """
    result = numbers("ball_in_cup")
    samples = result["samples"]
    arms = np.hypot(samples.x[:, 0], samples.x[:, 1])
    exact = 0.06 * float(samples.weight @ (samples.pressure * arms))
    assert result["torque"] == pytest.approx(exact, rel=4e-3)
    # The pressure bears the load: 1000 N along z, shared by friction about z.
    assert abs(samples.weight @ samples.force[:, 2]) == pytest.approx(1000, rel=1e-8)


def test_demos_stem_in_cylinder() -> None:
    """The force after sticking is mu p 2 pi b L with Lame's p; facets are flat."""
    p = 0.01 / 5 / (125 / 75 / 17e3 + 26 / 24 / 110e3)
    forces = numbers("stem_in_cylinder")["forces"]
    assert forces[-1] == pytest.approx(0.3 * p * 2 * math.pi * 5 * 10, rel=0.01)
    assert forces[-1] == pytest.approx(forces[-2], rel=1e-3)
    assert forces[1] < 0.5 * forces[-1]


def test_demos_own_law() -> None:
    """Springs act in series. A separate process is used, because the law stays registered."""
    printed = support.python(DEMOS / "own_law.py", PYTHONPATH=str(support.ROOT)).stdout
    exact = 3 * (2 / 2000 + 1 / 50 + 2 / 1000)
    assert float(printed.split()[1]) == pytest.approx(exact, rel=1e-8)


def test_demos_own_load() -> None:
    """The resultant gamma b H^2 / 2 has 1e-3 N/mm^3, 10 mm and 20 mm."""
    exact = 1e-3 * 10 * 20**2 / 2
    assert numbers("own_load")["friction"] == pytest.approx(exact, rel=1e-9)
