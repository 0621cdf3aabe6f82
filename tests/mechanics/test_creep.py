"""Creep: its equation at a point, units of time, dissipation."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from app.foundation.errors import StoppedError
from app.mechanics.creep import CreepState, deviator, von_mises
from app.numerics.newton import Solver
from app.results.verdicts import notes_of
from tests import support
from tests.cases import restarted
from tests.cases.stems import CREEPING
from tests.support import TWO_BLOCKS

LAW = {"A": 7.985e-7, "p": 1.9063, "m0": 0.4113, "m1": -0.1160}
# A block on another of the same material, between rollers and a load.
BAR = (
    TWO_BLOCKS
    + """
regions:
  lower: &bar
    youngs_modulus: 2200 MPa
    poisson_ratio: 0.3
    creep: {A: 1.0e-6, p: 2, m0: 0.4, per: 1 s}
  upper: *bar
supports:
  left: {kind: roller, boundary: x_min, axis: x}
  front: {kind: roller, boundary: y_min, axis: y}
  floor: {kind: roller, boundary: bottom, axis: z}
loads:
  push: {kind: pressure, boundary: top, pressure: 10 MPa}
stages: [{name: hold, creep_time: 1 day}]
output: {fields: false}
"""
)


def at_points(strain: float, n: int) -> CreepState:
    """Points with one earlier strain, in a separate state."""
    state = object.__new__(CreepState)
    state._law_values = {key: np.full(n, value) for key, value in LAW.items()} | {
        "unit": np.ones(n)
    }
    state._final_three_G, state.points_of_region, state.strain = (
        np.full(n, 2538.0),
        {},
        np.full(n, strain),
    )
    return state


@pytest.mark.parametrize("strain", [0.0, 1e-9, 1e-4, 1e-2])
@pytest.mark.parametrize("cycles", [1.0, 1e3, 1e7])
def test_creep_equation_at_a_point(strain: float, cycles: float) -> None:
    """A separate bisection in s covers all stresses of cement. Flow is along the deviator."""
    sizes = np.array([0.01, 0.3, 5.0, 50.0])
    σ = sizes[:, None] * np.array([[1.0, -0.2, 0.4, 0.3, 0.0, -0.5]])
    taken = at_points(strain, len(sizes)).stress_relaxation(σ, cycles)
    A, p, m0, m1 = LAW.values()

    def left(s: float, trial: float) -> float:
        m = m0 + m1 * math.log10(s)
        a = A * s**p
        crept = a * ((strain / a) ** (1 / m) + cycles) ** m - strain
        return trial - 3 * 846.0 * crept - s

    for row, trial, stress in zip(taken, von_mises(σ), σ, strict=True):
        s = brentq(left, 1e-3 * trial, trial, args=(trial,), xtol=1e-14, rtol=1e-14)
        assert von_mises(row[None])[0] == pytest.approx(trial - s, rel=1e-6, abs=1e-13)
        assert row / np.linalg.norm(row) == pytest.approx(
            (deviator(stress[None]) / np.linalg.norm(deviator(stress[None])))[0]
        )


def test_creep_of_cement_only_in_its_stages(tmp_path: Path) -> None:
    """The stem is in creeping cement.

    Balances close, energy is dissipated, and the stem subsides.
    """
    run = support.run(CREEPING, tmp_path)
    s, named = run.summary, run.step_record
    assert max(s["balance"].values()) < 1e-9 and s["solver"]["rejected_steps"] is not None
    lost = np.diff(named["creep dissipation [N mm]"])
    assert lost.min() >= -1e-10 * lost.max() and s["creep"]["dissipation"] > 0
    assert s["creep"]["cycles"] == 2e5 and named["creep cycles [-]"][-1] == 2e5
    subsided = named["stem subsidence [mm]"]
    # The first stage has two rows of one state.
    further = np.diff(subsided[named["time [-]"] < 2])
    assert further[0] == pytest.approx(0, abs=1e-12) and further[1:].min() > 1e-3
    assert any("Verdonschot" in note and "from memory: check" in note for note in notes_of(s))
    assert any("measured from 3 to 11 MPa" in note for note in notes_of(s))


@pytest.mark.parametrize("iteration", [12, 19, 26])
def test_creep_step_is_stopped_by_a_signal(
    iteration: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A signal ends Newton's method within a step of the second stage."""
    count, monitor = 0, Solver._monitor

    def stopping(self: Solver, snes: Any, number: int, norm: float) -> None:
        nonlocal count
        count += 1
        if count == iteration:
            raise StoppedError("stopped by a test")
        monitor(self, snes, number, norm)

    monkeypatch.setattr(Solver, "_monitor", stopping)
    with pytest.raises(StoppedError, match="stopped by a test"):
        support.run(CREEPING, tmp_path)


def test_creep_time_in_any_unit(tmp_path: Path) -> None:
    """A law per second or per hour gives A t^m after a day, at order 2 as well."""
    seconds = 86400.0
    expected = 1e-6 * 10**2 * seconds**0.4
    per_hour = f"{{A: {1e-6 * 3600**0.4!r}, p: 2, m0: 0.4, per: 1 hour}}"
    for k, changes in enumerate(
        (
            (),
            tuple(f"regions.{r}.creep={per_hour}" for r in ("lower", "upper")),
            ("mesh.order=2",),
        )
    ):
        folder = tmp_path / str(k)
        folder.mkdir()
        s = support.run(BAR, folder, *changes).summary
        for region in ("lower", "upper"):
            numbers = s["regions"][region]
            assert numbers["creep_strain_max"] == pytest.approx(expected, rel=1e-3)
            assert numbers["creep_strain_mean"] == pytest.approx(expected, rel=1e-3)
        assert s["creep"] == {
            "time": seconds,
            "dissipation": pytest.approx(10 * expected * 6 * 4 * 4, rel=1e-3),
        }
        assert not any("measured" in note for note in notes_of(s))
        assert any("linear cells are then too stiff" in note for note in notes_of(s)) == (k < 2)


def test_creep_law_alone_costs_nothing() -> None:
    """A law alone adds neither points nor forms, because stages switch creep on."""
    problem, _ = support.assemble(support.case(BAR, "stages=[{name: hold}]"))
    assert (
        problem.scene.creeps == ()
        and problem.stress_history is None
        and not problem.body_forms.path_dependent_regions
    )


def test_creep_near_zero_equals_elasticity(
    tmp_path: Path,
) -> None:
    """The stress depends on the history of strains and temperatures, as the law says."""
    summaries = []
    cool = ("regions.upper.thermal.cure=null", "interfaces.lower_upper.friction_coefficient=0")
    stage = "stages[1]={name: load, increments: 2, creep_cycles: 1, adaptive: false}"
    creeps = ("regions.upper.creep={A: 1e-20, p: 1, m0: 1}", stage, "stages[1].creep_tolerance=1")
    for k, changes in enumerate((cool, (*cool, *creeps))):
        folder = tmp_path / str(k)
        folder.mkdir()
        s = support.run(restarted.SETTING, folder, *changes).summary
        assert max(v for name, v in s["balance"].items() if name != "heat_quadrature") < 1e-8
        summaries.append(s)
    for key in ("von_mises_max", "principal_min"):
        one, other = (s["regions"]["upper"][key] for s in summaries)
        assert one == pytest.approx(other, rel=1e-6) and abs(one) > 0.1
    assert summaries[1]["regions"]["upper"]["creep_strain_max"] < 1e-18
