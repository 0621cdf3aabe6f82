"""Loads in the sections of a femur: by hand, and against its stress and strain."""

from __future__ import annotations

import re

import numpy as np
import pytest

from app.case.section_loads import KNEE, section_loads
from app.results.hip import of_femur
from app.results.stresses import Stresses
from meshes.femur_bone import CANAL, PERIOSTEUM, Tube
from tests import support


def test_section_loads_cortex_strain_is_that_of_a_beam() -> None:
    """The strain at z = -80 and -113 is N / EA + M x / EI.

    The sections are those of cortex and cancellous bone.
    """
    text = (support.CONFIGS / "intact.yaml").read_text()
    solved = support.solve(text, "mesh.size=10 mm", "mesh.around=8")
    numbers = of_femur(solved.problem, solved.case)
    theta = 2 * np.pi * np.arange(720) / 720
    knee = section_loads(solved.case, 1.0)[-1]
    for name, z in (("80", -80.0), ("113", -113.0)):
        level = np.full(720, z)
        outer, inner = PERIOSTEUM.radius(theta, level), Tube(CANAL).radius(theta, level)

        # Integrals of E, E x and E x^2 over the section.
        EA, EX, EI = (
            2 * np.pi * np.mean(np.cos(theta) ** k * (17e3 * outer**n - 16.4e3 * inner**n) / n)
            for k, n in enumerate((2, 3, 4))
        )
        middle = EX / EA
        EI -= EA * middle**2
        moment = knee.moment[1] + middle * knee.force[2]
        for side, x in (("lateral", -outer[360]), ("medial", outer[0])):
            beam = knee.force[2] / EA - moment * (x - middle) / EI
            assert numbers[f"strain_{side}_{name}"] == pytest.approx(beam, rel=0.03)
    assert numbers["head_displacement"][0] == pytest.approx(5.9, abs=0.1)


def test_section_loads_of_two_forces_by_hand() -> None:
    """A hip force acts at (43, 0, 54) and a muscle at (-20, 10, -60).

    Only lower cuts bear the muscle.
    """
    muscle = "{kind: force, boundary: psoas, at: [-20 mm, 10 mm, -60 mm], force: '[0, 50, 300] N'}"
    case = support.case(
        "base: intact\nloads: {library: walking_hip}\n",
        "loads.hip.boundary=head",
        "loads.hip.force=[-400 N, -100 N, -1400 N]",
        "loads.hip.history=[0.5]",
        f"loads.muscle={muscle}",
    )
    by_height = {s.z: s for s in section_loads(case, 1.0)}
    assert len(by_height) == 11 and list(by_height)[-2:] == [-200.0, KNEE]
    # Half the hip force, 54 mm above: r x F = (43, 0, 54) x (-200, -50, -700).
    upper = by_height[0.0]
    assert upper.force == (-200.0, -50.0, -700.0)
    assert upper.moment == (54 * 50.0, -54 * 200.0 + 43 * 700.0, -43 * 50.0)
    assert upper.medial_of_shaft == pytest.approx(19300 / 700)
    # At z = -100 the hip is 154 mm above and the muscle 40.
    lower = by_height[-100.0]
    assert lower.force == (-200.0, 0.0, -400.0)
    hip = (154 * 50.0, -154 * 200.0 + 43 * 700.0, -43 * 50.0)
    muscle_ = (10 * 300.0 - 40 * 50.0, 20 * 300.0, -20 * 50.0)
    assert lower.moment == tuple(a + b for a, b in zip(hip, muscle_, strict=True))
    assert lower.medial_of_head == pytest.approx((-700.0 + 6000.0) / 400 - 43)


@pytest.mark.parametrize("name", ["walking_hip", "standing_up_hip", "stairs_up_hip"])
def test_section_loads_torsion_by_tilt_and_anteversion(name: str) -> None:
    """The head is at 43 mm (cos a, sin a), and the force is turned about x by the tilt."""
    text = (support.ROOT / "docs/howto/loads.md").read_text()
    (row,) = re.findall(rf"^\| `{name}` \| (.*) \|$", text, re.MULTILINE)
    for cell, degrees in zip(row.split(" | "), [(0, 0), (8.4, 0), (0, 15), (8.4, 15)], strict=True):
        tilt, turn = np.deg2rad(degrees)
        changes = f"loads.sagittal_tilt={tilt} rad", f"geometry.anteversion={turn} rad"
        case = support.case(f"base: stance\nloads: {{library: {name}}}\n", *changes)
        torsion = section_loads(case, 1.0)[-1].moment[2] / 1e3
        x, y, z = support.case(f"base: stance\nloads: {{library: {name}}}\n").loads["hip"].resultant
        y = y * np.cos(tilt) + z * np.sin(tilt)
        assert torsion == pytest.approx(0.043 * (np.cos(turn) * y - np.sin(turn) * x))
        assert f"{-100 * torsion / 600:.2f}" == cell


SETS = ["one_leg_stance", "gait", "standing_up", "sitting_down", "stairs_up"]


@pytest.mark.parametrize("name", SETS)
def test_section_loads_of_sets_with_muscles_are_plausible(name: str) -> None:
    """The line of action passes between shaft and head at the knee.

    The knee bears 0.9 body weights when standing and 1.04 when walking.
    """
    case = support.case(f"base: stance\nloads: {{library: {name}}}\n")
    knee = section_loads(case, 1.0)[-1]
    assert knee.medial_of_shaft is not None and 0.0 < knee.medial_of_shaft < 43.0
    leg = {"one_leg_stance": 0.9, "gait": 1.04}.get(name)
    if leg:
        assert knee.medial_of_shaft == pytest.approx(35.0, abs=0.5)
        forces = [np.array(load.resultant) for load in case.loads.values()]
        # Without what the tensor pulls from below the trochanter.
        assert np.linalg.norm(sum(forces[:-1])) == pytest.approx(leg * 600.0, abs=1.0)
        assert np.linalg.norm(forces[-1]) == pytest.approx(np.linalg.norm(forces[-2]), abs=0.1)


def test_section_loads_of_the_bench_test() -> None:
    """A force of 2300 N acts at 10 and 9 degrees, 80 mm below a head at 43 mm."""
    case = support.case("base: iso_7206_4\n", "geometry.distal_cut_z=-204.5 mm")
    (at,) = (s for s in section_loads(case, 1.0) if s.z == -26.0)
    assert at.force[2] == pytest.approx(-2237.0, abs=0.5)
    assert np.array(at.moment) / 1e3 == pytest.approx([28.4, 64.3, -15.2], abs=0.1)


def test_section_loads_equal_integrated_stress() -> None:
    """Cuts above the tip go through stem, cement and bone. Means are over 40 mm about the cut."""
    solved = support.solve(
        (support.CONFIGS / "stance.yaml").read_text(), "mesh.size=10 mm", "mesh.around=8"
    )
    level = -75.0
    wanted = next(s for s in section_loads(solved.case, 1.0) if s.z == level)
    stresses, force, moment = Stresses(solved.problem), np.zeros(3), np.zeros(3)
    for region in solved.case.regions:
        x, volume = stresses.points_and_volumes(region)
        weight = np.maximum(0.0, 1 - np.abs(x[:, 2] - level) / 20) / 20 * volume.ravel()
        # What is above acts on what is below, whose outward normal is z.
        t = stresses.evaluate(region).reshape(-1, 3, 3)[:, :, 2] * weight[:, None]
        force += t.sum(axis=0)
        moment += np.cross(x * [1.0, 1.0, 0.0], t).sum(axis=0)
    assert np.linalg.norm(force - wanted.force) < 0.02 * np.linalg.norm(wanted.force)
    assert np.linalg.norm(moment - wanted.moment) < 0.02 * np.linalg.norm(wanted.moment)
