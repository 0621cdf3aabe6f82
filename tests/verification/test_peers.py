"""What other programs are given of a case, what is read of them, and that they find the same."""

from __future__ import annotations

import math
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import meshes
from app.campaigns.many import Options
from app.case.case import Case, load
from app.errors import InputError
from app.results.reading import Run
from app.verification import calculix, peer_programs, peers
from app.verification.peer_model import PeerModel, build, contact_numbers
from configs import FOLDER
from meshes.data import cell_volumes, region_volumes

STEM = FOLDER / "bench" / "stem.yaml"
SIZE = 4.0
COARSE = (f"mesh.size={SIZE} mm", f"mesh.far_size={SIZE} mm")
TAPER = math.radians(2.5)
RADIUS, LENGTH = 8.0, 80.0  # of the stem, at mid length [mm]


@cache
def model() -> PeerModel:
    return build(STEM, COARSE)


def nodes_of(body: int) -> np.ndarray:
    return np.unique(model().cells[model().body == body])


def test_forces_sum_to_the_load_and_act_on_top_of_the_stem() -> None:
    m = model()
    assert m.forces.sum(axis=0) == pytest.approx([300.0, 0.0, -1800.0])
    loaded = np.flatnonzero(m.forces.any(axis=1))
    assert np.isin(loaded, nodes_of(0)).all()
    assert m.points[loaded, 2] == pytest.approx(LENGTH)
    # Even: no moment about the middle of the top from the part along z.
    lever = m.points[loaded, 0] @ m.forces[loaded, 2]
    assert abs(lever) < 1e-3 * 1800.0 * RADIUS


def test_bodies_are_those_of_the_mesh_with_copies_at_the_interfaces() -> None:
    m, case = model(), load(STEM, COARSE).config
    data = meshes.build(case.geometry, case.mesh)
    volumes = cell_volumes(m.points, m.cells)
    assert volumes.min() > 0
    for number, name in enumerate(case.regions):
        assert volumes[m.region == number].sum() == pytest.approx(region_volumes(data)[name])
    shared = sum(len(i.nodes()[0]) for i in m.interfaces)
    assert len(m.points) == len(data.points) + shared
    for k, interface in enumerate(m.interfaces):
        first, second = interface.nodes()
        assert np.array_equal(m.points[first], m.points[second])
        assert len(np.unique(second)) == len(second)
        assert np.isin(first, nodes_of(k)).all()
        assert np.isin(second, nodes_of(k + 1)).all()
    assert np.isin(m.fixed, nodes_of(2)).all()
    assert m.points[m.fixed, 2] == pytest.approx(0.0)


def test_normals_are_those_of_the_cone() -> None:
    m = model()
    for interface in m.interfaces:
        x = m.points[interface.nodes()[0]]
        radial = x[:, :2] / np.linalg.norm(x[:, :2], axis=1, keepdims=True)
        exact = np.column_stack([math.cos(TAPER) * radial, np.full(len(x), -math.sin(TAPER))])
        normals = m.normals(interface)
        assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
        # At the rims facets lie on one side alone, by up to half their angle.
        inside = (x[:, 2] > 1) & (x[:, 2] < LENGTH - 1)
        cosine = np.einsum("pi,pi->p", normals, exact)
        assert cosine[inside].min() > math.cos(0.1)
        assert cosine.min() > math.cos(0.25)


def test_slip_of_a_stem_that_turns_in_its_hole() -> None:
    m, angle = model(), 1e-4
    u = np.zeros_like(m.points)
    stem = nodes_of(0)
    u[stem] = angle * np.cross([0.0, 0.0, 1.0], m.points[stem])
    found = contact_numbers(m, u)
    z = np.linspace(0.0, LENGTH, 2001)
    r = RADIUS + (z - LENGTH / 2) * math.tan(TAPER)
    assert found["stem_cement"]["slip_mean"] == pytest.approx(angle * (r @ r) / r.sum(), rel=0.02)
    assert found["stem_cement"]["slip_p99"] == pytest.approx(angle * r.max(), rel=0.02)
    assert found["cement_bone"]["slip_mean"] == 0.0


def test_a_stem_that_sinks_penetrates_and_one_that_rises_is_open() -> None:
    m, step = model(), 0.01
    u = np.zeros_like(m.points)
    u[nodes_of(0), 2] = -step
    found = contact_numbers(m, u)["stem_cement"]
    assert found["slip_mean"] == pytest.approx(step * math.cos(TAPER), rel=0.01)
    assert found["penetration"] >= step * math.sin(TAPER)
    u[nodes_of(0), 2] = 1.0
    found = contact_numbers(m, u)["stem_cement"]
    assert found["open"] >= math.sin(TAPER)
    # A few nodes of the rim have other normals.
    assert found["slip_mean"] < 0.05


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("mesh.order=2", "mesh.order"),
        ("interfaces.stem_cement.gap=0.01 mm", "interfaces.stem_cement"),
        (
            "interfaces.cement_bone={kind: penalty, penalty: 1 MPa/mm, friction_coefficient: 1}",
            "interfaces.cement_bone",
        ),
        ("supports.more={kind: roller, boundary: bone_bottom, axis: z}", "supports.more"),
        ("loads.top.at=[0 mm, 0 mm, 90 mm]", "loads.top"),
        ("stages=[{name: a}, {name: b}]", "stages"),
    ],
)
def test_what_other_programs_are_not_given_is_refused(override: str, key: str) -> None:
    with pytest.raises(InputError, match=key):
        build(STEM, (*COARSE, override))


def test_regions_that_are_bonded_are_one_body() -> None:
    m = build(STEM, (*COARSE, "interfaces.cement_bone={kind: bonded}"))
    assert [i.name for i in m.interfaces] == ["stem_cement"]
    assert set(m.body[m.region == 1]) == set(m.body[m.region == 2]) != set(m.body[m.region == 0])
    assert len(m.points) == len(model().points) - len(model().interfaces[1].nodes()[0])


def sections(text: str) -> list[tuple[str, list[str]]]:
    found: list[tuple[str, list[str]]] = []
    for line in text.splitlines():
        if line.startswith("*"):
            found.append((line, []))
        else:
            found[-1][1].append(line)
    return found


def test_input_of_calculix_names_the_facets_of_the_interfaces() -> None:
    m = model()
    found = dict(sections(calculix.input_text(m, 1e5, 1e4)))
    # Nodes of the faces of a C3D4, from its manual.
    faces = {"S1": (1, 2, 3), "S2": (1, 4, 2), "S3": (2, 4, 3), "S4": (3, 4, 1)}
    for k, interface in enumerate(m.interfaces):
        for side, nodes in (("A", interface.first), ("B", interface.second)):
            lines = found[f"*SURFACE, NAME={side}{k}, TYPE=ELEMENT"]
            named = [(int(a) - 1, faces[b.strip()]) for a, b in (line.split(",") for line in lines)]
            given = [{int(m.cells[c][i - 1]) for i in face} for c, face in named]
            assert given == [set(map(int, row)) for row in nodes]
    assert len(found["*NODE, NSET=ALL"]) == len(m.points)
    loads = [float(line.split(",")[2]) for line in found["*CLOAD"]]
    assert sum(loads) == pytest.approx(300.0 - 1800.0)
    # The program reads 20 characters of a number.
    words = [w.strip() for _, lines in found.items() for line in lines for w in line.split(",")]
    assert max(map(len, words)) <= 20


FRD = """\
    1C
    2C                             2                                     1
 -1         1 0.00000E+00 0.00000E+00 0.00000E+00
 -1         2 1.00000E+00 0.00000E+00 0.00000E+00
 -3
    1PSTEP                         1           1           1
  100CL  101 {time}           2                     0    1           1
 -4  DISP        4    1
 -5  D1          1    2    1    0
 -1         1 1.00000E-03-2.50000E-02 0.00000E+00
 -1         2 0.00000E+00 4.00000E-05-1.00000E+00
 -3
 -4  STRESS      6    1
 -1         1 9.00000E+00 9.00000E+00 9.00000E+00
 -3
 9999
"""


def test_displacement_is_read_from_a_frd_file(tmp_path: Path) -> None:
    path = tmp_path / "peer.frd"
    path.write_text(FRD.format(time="1.000000000"))
    found = calculix.displacement(path, 2)
    assert found.tolist() == [[1e-3, -2.5e-2, 0.0], [0.0, 4e-5, -1.0]]
    with pytest.raises(InputError, match="all nodes"):
        calculix.displacement(path, 3)


def test_a_step_that_has_not_ended_is_no_result(tmp_path: Path) -> None:
    path = tmp_path / "peer.frd"
    path.write_text(FRD.format(time="0.250000000"))
    with pytest.raises(InputError, match="end of the step"):
        calculix.displacement(path, 2)


def test_a_process_is_measured_and_ended_in_time(tmp_path: Path) -> None:
    burn = "x = bytearray(200_000_000)\nwhile True: pass"
    cost = peer_programs.measured([sys.executable, "-c", burn], tmp_path, 1)
    assert cost.exit_code < 0
    assert 0.8 < cost.cpu < 3.0
    assert 190 < cost.memory < 260
    small = peer_programs.measured([sys.executable, "-c", "print('here')"], tmp_path, 10)
    assert small.exit_code == 0
    assert small.memory < 60
    assert (tmp_path / "log").read_text() == "here\n"


def test_a_program_that_is_not_there_has_a_row_that_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MANTLE_CCX", str(tmp_path / "none"))
    reference = peers.SlipReference("stem_cement", 1.0, 0.05, 0.06)
    program, case = peer_programs.CalculiX(1e4, 1e3), load(STEM, COARSE).config
    row = peers.measure(program, model(), case, SIZE, tmp_path, reference, None)
    assert row.note.startswith("not installed")
    assert row.cpu is None
    assert "not installed" in peers.table([row])
    peers.draw([row], tmp_path / "peers.png")
    assert "not installed" in peers.dry_run(Options(tmp_path, 1, "calculix", "quick", None))


# Two flat blocks of which the upper is pushed: a part of its base slips.
BLOCKS = """\
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: [10 mm, 10 mm, 5 mm]}
    - {name: upper, size: [10 mm, 10 mm, 5 mm]}
mesh: {size: 1.25 mm, order: 1}
regions:
  lower: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 2.2 GPa, poisson_ratio: 0.3}
interfaces:
  lower_upper: {kind: contact, friction_coefficient: 0.3}
supports:
  floor: {kind: fixed, boundary: bottom}
loads:
  push: {kind: force, boundary: top, force: [250 N, 0 N, -1000 N]}
"""
PRESSURE = 1000.0 / (10.0 * 10.0)
MANTLE, GETFEM = peer_programs.MantleItself(), peer_programs.GetFem()


def solved(program: peer_programs.Program, of: PeerModel, case: Case, folder: Path) -> np.ndarray:
    if why := program.missing():
        pytest.skip(f"{program.name}: {why}")
    folder.mkdir(exist_ok=True)
    cost = peer_programs.measured(program.command(of, case, folder), folder, 600)
    assert cost.exit_code == 0, (folder / "log").read_text()
    return program.displacement(of, folder)


@pytest.mark.slow
def test_numbers_of_mantle_are_those_of_its_summary(tmp_path: Path) -> None:
    u = solved(MANTLE, model(), load(STEM, COARSE).config, tmp_path)
    found = contact_numbers(model(), u, open_from=1e-6)
    for name, numbers in Run(tmp_path / "run").summary["interfaces"].items():
        assert found[name]["slip_mean"] == pytest.approx(numbers["slip_mean"], rel=1e-6)
        assert found[name]["slip_p99"] == pytest.approx(numbers["slip_p99"], rel=1e-6)
        assert found[name]["open"] == pytest.approx(numbers["gap_max"], rel=1e-6)


@pytest.mark.slow
def test_getfem_finds_the_same_displacement(tmp_path: Path) -> None:
    """One multiplier for each pair of nodes, as here: the same equations, another program."""
    case = load(STEM, COARSE).config
    theirs = solved(GETFEM, model(), case, tmp_path / "theirs")
    ours = solved(MANTLE, model(), case, tmp_path / "ours")
    assert np.abs(ours - theirs).max() < 1e-7 * np.abs(ours).max()


@pytest.mark.slow
def test_calculix_comes_near_as_its_penalty_grows(tmp_path: Path) -> None:
    """On flat facets, where those of the sides stay upon each other as they slip."""
    path = tmp_path / "blocks.yaml"
    path.write_text(BLOCKS)
    of, case = build(path), load(path).config
    ours = contact_numbers(of, solved(MANTLE, of, case, tmp_path / "ours"))["lower_upper"]
    assert ours["slip_mean"] < 0.5 * ours["slip_p99"]  # a part sticks
    errors = []
    for penalty in (1e5, 1e6):
        program = peer_programs.CalculiX(penalty, penalty / 10)
        u = solved(program, of, case, tmp_path / program.key)
        theirs = contact_numbers(of, u)["lower_upper"]
        assert PRESSURE / penalty < theirs["penetration"] < 10 * PRESSURE / penalty
        errors.append(theirs["slip_mean"] / ours["slip_mean"] - 1)
    assert abs(errors[0]) > 2 * abs(errors[1])
    assert abs(errors[1]) < 0.07
    assert theirs["slip_p99"] == pytest.approx(ours["slip_p99"], rel=0.02)
