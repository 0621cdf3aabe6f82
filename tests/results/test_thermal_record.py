"""Numbers of temperatures and cure, against formulas, on any number of ranks."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from scipy.integrate import quad

from app.foundation.errors import InputError
from app.heat.heat_forms import HeatForms
from app.results import closing_lines
from app.results.thermal_record import CureRecord, ThermalRecord
from app.scene.bodies import bodies_of
from app.system.timing import Timing
from meshes.distribute import TaggedMesh
from tests import frozen, support
from tests.cases import coupled
from tests.cases.temperatures import ZERO, Play, constant, two_blocks


@pytest.fixture(scope="module")
def stack() -> TaggedMesh:
    return two_blocks(MPI.COMM_WORLD)


def bone_through(tagged: TaggedMesh, celsius: Callable[[float], float], *times: float) -> Any:
    """Numbers of bone with one temperature at a time."""
    play = Play(tagged, lambda x, t: np.full(len(x), celsius(t)), constant(20.0))
    return play.through(*times)["regions"]["bone"]


def falling(x: np.ndarray, t: float) -> np.ndarray:
    """The temperature of the bone is 52.5 degC at the interface.

    The level 47 degC is between the nodes at 1.0 and 1.5 mm.
    """
    return 43.0 + 4.75 * x[:, 2]


def test_thermal_record_necrosis_of_a_known_field(stack: TaggedMesh) -> None:
    play = Play(stack, falling, constant(80.0))
    early = play.through(59.0)["regions"]["bone"]
    assert early["necrosis_47C_1min_volume"] == 0 and early["necrosis_47C_1min_depth"] == 0
    late = play.through(61.0)
    bone, cement = late["regions"]["bone"], late["regions"]["cement"]
    # 61 s at nodes from 1.0 mm (47.75 degC) up, none at 0.5 mm: a minute is reached in between.
    depth = 1.0 + 0.5 / 61
    assert bone["necrosis_47C_1min_depth"] == pytest.approx(depth)
    assert bone["necrosis_47C_1min_volume"] == pytest.approx(16 * depth)
    assert bone["volume_over_47"] == pytest.approx(16 * (2 - 4 / 4.75))
    assert bone["volume_over_50"] == pytest.approx(16 * (2 - 7 / 4.75))
    assert bone["volume_over_56"] == 0
    assert (bone["seconds_over_47"], bone["seconds_over_56"]) == (61.0, 0.0)
    assert bone["cem43_max"] == pytest.approx(2**9.5 * 61 / 60)
    for minutes in (16, 60, 240):
        height = np.log2(minutes * 60 / 61) / 4.75
        assert bone[f"necrosis_cem43_{minutes}_depth"] == pytest.approx(2 - height)
        assert bone[f"necrosis_cem43_{minutes}_volume"] == pytest.approx(16 * (2 - height))
    rate = 3.1e98 * np.exp(-6.28e5 / (8.314462618 * 325.65))
    assert bone["henriques_moritz_max"] == pytest.approx(61 * rate)
    assert bone["necrosis_henriques_moritz_volume"] == 0
    assert bone["temperature_mean"] == pytest.approx(47.75)
    assert bone["temperature_min"] == pytest.approx(43.0)
    assert not [key for key in cement if "necrosis" in key]
    assert cement["volume_over_56"] == pytest.approx(32)


def test_thermal_record_separates_sides_of_an_interface(stack: TaggedMesh) -> None:
    play = Play(stack, falling, lambda x, t: 80.0 - t + x[:, 0])
    summary, row = play.through(5.0), play.record.row
    q = summary["interfaces"]["bone_cement"]
    assert q["temperature_max_first"] == pytest.approx(52.5)
    assert q["temperature_max_second"] == pytest.approx(84.0)
    assert q["temperature_max_second_time"] == 0
    assert q["temperature_max_second_at"] == pytest.approx([4, 0, 2])  # the first of equal places
    assert q["temperature_jump_max"] == pytest.approx(84 - 52.5)
    assert row["bone_cement temperature_max_second [degC]"] == pytest.approx(79.0)
    assert row["cement temperature_max [degC]"] == pytest.approx(79.0)
    assert summary["regions"]["cement"]["temperature_end_max"] == pytest.approx(79.0)


def test_thermal_record_finds_peaks_between_steps(stack: TaggedMesh) -> None:
    def parabola(x: np.ndarray, t: float) -> np.ndarray:
        return 60.0 - (t - 3.2) ** 2 - x[:, 2]

    for times in ((1.0, 2.5, 4.5, 6.0), (1.0, 2.5, 3.6, 6.0, 7.0), (1.0, 3.0, 6.0, 6.5)):
        bone = Play(stack, parabola, constant(20.0)).through(*times)["regions"]["bone"]
        assert bone["temperature_max"] == pytest.approx(60.0)
        assert bone["temperature_max_time"] == pytest.approx(3.2)
        assert bone["temperature_max_at"][2] == pytest.approx(0)  # all of the base is as hot


def test_thermal_record_invents_no_peak(stack: TaggedMesh) -> None:
    """Steps are very unequal, and the curve turns sharply."""
    bone = bone_through(stack, lambda t: 37.0 if t == 0 else 60.0 - 1e-3 * t, 1e-3, 100.0)
    assert 60.0 - 1e-6 <= bone["temperature_max"] < 60.02
    tent = ([0.0, 20.0, 60.0], [37.0, 57.0, 41.0])
    bone = bone_through(stack, lambda t: float(np.interp(t, *tent)), *np.arange(5.0, 61.0, 5.0))
    assert bone["temperature_max"] == pytest.approx(57.0)


@pytest.mark.parametrize(("step", "error"), [(6.0, 0.008), (12.0, 0.035)])
def test_thermal_record_doses_follow_the_curve(
    stack: TaggedMesh, step: float, error: float
) -> None:
    """The bone warms and cools within two minutes.

    Chords lose 2.5 and 9.6 % of the damage integral.
    """

    def celsius(t: float) -> float:
        return 37.0 + 25.0 * np.exp(-((t / 60 - 3) ** 2))

    def rate(t: float) -> float:
        return float(np.exp(np.log(3.1e98) - 6.28e5 / (8.314462618 * (ZERO + celsius(t)))))

    times = np.arange(0.17 * step, 400.0, step)
    bone = bone_through(stack, celsius, *times)
    exact = quad(rate, 0, times[-1], epsrel=1e-9, limit=400, points=[150.0, 180.0, 210.0])[0]
    assert bone["henriques_moritz_max"] == pytest.approx(exact, rel=error)


def test_thermal_record_keeps_kinks(stack: TaggedMesh) -> None:
    """Heating is switched off, so a rise ends at the kink."""
    bone = bone_through(stack, lambda t: min(37.0 + t, 57.0), *np.arange(5.0, 61.0, 5.0))
    assert bone["temperature_max"] == pytest.approx(57.0)
    minutes = (quad(lambda t: 2 ** (t - 6), 6, 20)[0] + 40 * 2**14) / 60
    assert bone["cem43_max"] == pytest.approx(minutes, rel=1e-3)
    assert bone["seconds_over_50"] == pytest.approx(47.0)


HELD = """
geometry: {kind: blocks, blocks: [{name: bone, size: [2 mm, 2 mm, 2 mm]},
                                  {name: hot, size: [2 mm, 2 mm, 2 mm]}]}
mesh: {order: 1, size: 1 mm}
regions:
  bone: &bone {kind: conductor, thermal: {conductivity: 0.5 W/(m K), density: 1800 kg/m^3,
    specific_heat: 1300 J/(kg K), initial_temperature: 37 degC}}
  hot: *bone
heat:
  bath: {kind: temperature, regions: [bone, hot], time_course: [[0 s, 37 degC], [20 s, 47 degC],
    [30 s, 52 degC], [60 s, 52 degC], [75 s, 49 degC], [100 s, 37 degC]]}
stages:
  - {name: bath, duration: 110 s}
"""
BATH = ([0, 20, 30, 60, 75, 100, 110], [37, 47, 52, 52, 49, 37, 37])


@pytest.mark.parametrize("equal", [False, True])
def test_thermal_record_doses_of_piecewise_linear_temperatures(
    monkeypatch: pytest.MonkeyPatch, equal: bool
) -> None:
    """Temperatures are linear in time between kinks."""
    steps = "stages.0={name: bath, duration: 110 s, increments: 11, adaptive: false}"
    run = coupled.solve(monkeypatch, *([steps] if equal else []), text=HELD)
    doses = run.model.thermal.record.regions["bone"].doses.totals

    def dose(rate: Callable[[float], float]) -> float:
        parts = pairwise(BATH[0])
        return sum(quad(lambda t: rate(np.interp(t, *BATH)), *p, epsrel=1e-9)[0] for p in parts)

    def minutes(T: float) -> float:
        return (0.25 if T < 43 else 0.5) ** (43 - T) / 60 if T >= 39 else 0.0

    assert doses["cem43"] == pytest.approx(dose(minutes), rel=1e-6)
    damage = dose(lambda T: float(np.exp(np.log(3.1e98) - 6.28e5 / (8.314462618 * (ZERO + T)))))
    assert doses["henriques_moritz"] == pytest.approx(damage, rel=1e-6)
    assert doses["seconds_over_47"] == pytest.approx(75 + 25 / 6 - 20)


@pytest.mark.parametrize(
    ("celsius", "known"), [((30.0, 60.0), False), ((60.0, 30.0), False), ((20.0, 38.9), True)]
)
def test_thermal_record_doses_after_a_warm_steady_state(
    stack: TaggedMesh, celsius: tuple[float, float], known: bool
) -> None:
    """The duration and later temperatures do not matter. CEM43 counts from 39 degC on."""
    play = Play(stack, constant(celsius[0]), constant(celsius[0]))
    play.states = (constant(celsius[1]), constant(celsius[1]))
    hot = play.through(0.0)
    assert hot["regions"]["bone"]["temperature_max"] == pytest.approx(max(celsius))
    assert hot["regions"]["bone"]["volume_over_56"] == pytest.approx(32.0 * (max(celsius) > 56))
    play.states = (constant(50.0), constant(20.0))
    later = play.through(10.0, 20.0)
    doses = ("seconds_over", "cem43", "henriques_moritz", "necrosis")
    for summary in (hot, later):
        assert any(k.startswith(doses) for r in summary["regions"].values() for k in r) == known
        assert ("note" in summary) == (not known)
        lines = list(closing_lines.closing_tables({"thermal": summary}))
        assert any(line.startswith("dead bone") for line in lines) == known
        assert any("steady" in line for line in lines) == (not known)
    if known:
        # From 38.9 to 50 degC in a straight line, then 50.
        over = 10 * (50.0 - 47.0) / (50.0 - 38.9) + 10
        assert later["regions"]["bone"]["seconds_over_47"] == pytest.approx(over, rel=1e-6)


def test_thermal_record_flux_of_interfaces(stack: TaggedMesh) -> None:
    play = Play(stack, constant(30.0), constant(40.0))
    for flux, entropy in ((-2e-3, 3e-9), (1e-3, -1e-25)):
        one = np.array([flux]), np.array([entropy])
        play.record.update(1.0 + entropy, play.at(1.0), {"bone_cement": one})
    q = play.record.summary()["interfaces"]["bone_cement"]
    assert q["heat_flux_max"] == pytest.approx(2.0)  # W/m2
    assert q["entropy_production_min"] == pytest.approx(-1e-22)
    assert q["entropy_production_max"] == pytest.approx(3e-6)
    assert "heat_flux_max" not in Play(stack, falling, falling).through(1.0)["interfaces"]


def test_thermal_record_probes_use_their_region(stack: TaggedMesh) -> None:
    play = Play(
        stack,
        falling,
        lambda x, t: 60.0 + x[:, 0] - 2 * x[:, 1] + t,
        tip=((1.3, 2.2, 2.0), "bone"),
        above=((1.3, 2.2, 2.0), "cement"),
        anywhere=((0.2, 0.3, 3.3), None),
    )
    play.through(1.0)
    row = play.record.row
    assert row["tip [degC]"] == pytest.approx(52.5)
    assert row["above [degC]"] == pytest.approx(61 + 1.3 - 4.4)
    assert row["anywhere [degC]"] == pytest.approx(61 + 0.2 - 0.6)


def test_thermal_record_probes_in_curved_cells() -> None:
    tagged = support.mesh(support.case(support.STEM, "mesh.order=2", "geometry.taper=0 deg"))
    assert tagged.mesh.geometry.dofmap.shape[1] == 10
    bodies = bodies_of(tagged, (), ())
    forms = HeatForms(tagged, bodies, Timing())
    probes = {
        f"p{a}": ((10.999 * np.cos(a), 10.999 * np.sin(a), 3.1), "cement")
        for a in (0.0, 0.5, 1.0, 1.5, 2.0)
    }
    record = ThermalRecord(
        tagged, forms, bodies.body_of_region, tagged.interfaces, ("bone",), probes
    )
    T = fem.Function(forms.space)
    x = forms.space.tabulate_dof_coordinates()
    T.x.array[:] = ZERO + np.hypot(x[:, 0], x[:, 1])
    record.start([T])
    row = record.row
    # The cell bulges to the true radius, where linear functions take the value of its corners.
    assert [row[f"{name} [degC]"] for name in probes] == pytest.approx(5 * [11.0], abs=0.02)
    assert row["cement_bone temperature_max_first [degC]"] == pytest.approx(11.0)


def test_thermal_record_refuses_a_probe_outside(stack: TaggedMesh) -> None:
    with pytest.raises(InputError, match=r"probes\.far: .* region 'bone'"):
        Play(stack, falling, falling, far=((1.0, 1.0, 3.0), "bone"))


def logistic(t: np.ndarray | float, k: float = 6.82396e-3, seed: float = 1e-3) -> Any:
    return 1 / (1 + (1 / seed - 1) * np.exp(-k * np.asarray(t)))


def test_thermal_record_cure_of_a_logistic_curve() -> None:
    """Isothermal autocatalysis with m = n = 1 has t50 = 1012.133 s.

    A second node is half a minute late.
    """
    k = 6.82396e-3
    late = np.array([0.0, 30.0])
    record = CureRecord(MPI.COMM_SELF, {"cement": logistic(-late)}, {})
    for time in np.arange(40.0, 1800.0, 40.0):
        a = logistic(time - late)
        record.update(time, {"cement": a}, {"cement": k * a * (1 - a)})
    assert record.summary()["cement"] == {
        "time_50": pytest.approx(1042.133, rel=2e-6),
        "time_90": pytest.approx(1042.133 + np.log(9) / k, rel=2e-6),
        "rate_max": pytest.approx(k / 4, rel=5e-3),
        "degree_max": pytest.approx(float(logistic(1760.0))),
        "degree_min": pytest.approx(float(logistic(1730.0))),
    }


def test_thermal_record_unreached_degree_has_no_time() -> None:
    record = CureRecord(MPI.COMM_SELF, {"cement": np.array([0.0, 0.0])}, {})
    record.update(1.0, {"cement": np.array([0.6, 0.4])}, {"cement": np.array([0.0, 0.1])})
    assert record.summary()["cement"]["time_50"] is None
    record.update(2.0, {"cement": np.array([0.6, 0.6])}, {"cement": np.zeros(2)})
    assert 1.0 < record.summary()["cement"]["time_50"] < 2.0


def wandering(x: np.ndarray, t: float) -> np.ndarray:
    return 45.0 + 5 * np.sin(x[:, 0] + 0.03 * t) + x[:, 1] + 2.1 * x[:, 2] - 0.01 * t


@pytest.mark.parallel
@pytest.mark.parametrize("ranks", [2, 3])
def test_thermal_record_is_equal_on_ranks(ranks: int, tmp_path: Path) -> None:
    summaries = []
    for n in (1, ranks):
        out = tmp_path / f"{n}.json"
        support.on_ranks(n, __file__, out)
        summaries.append(dict(frozen.leaves(json.loads(out.read_text()), "")))
    assert summaries[1] == pytest.approx(summaries[0], rel=1e-9, abs=1e-12)


def main(path: str) -> None:
    comm = MPI.COMM_WORLD
    tip, anywhere = ((1.3, 2.2, 2.0), "bone"), ((0.2, 0.3, 3.3), None)
    play = Play(two_blocks(comm), wandering, wandering, tip=tip, any=anywhere)
    summary = play.through(*np.arange(10.0, 120.0, 10.0))
    summary["row"] = play.record.row
    summary["moved"] = play.record.moved_heat({"bone": 2.0, "cement": 3.0})
    if comm.rank == 0:
        Path(path).write_text(json.dumps(summary))


if __name__ == "__main__":
    main(sys.argv[1])
