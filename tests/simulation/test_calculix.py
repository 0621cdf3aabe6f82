"""A case as an input file of CalculiX: forces, materials, bodies, refused cases."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import mantle
import meshes
from app.case.case import load_case
from app.case.geometries import MeshFile, MeshOptions
from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.results import hip
from app.results.percentiles import SurfaceField
from app.scene import bodies
from app.simulation import calculix
from meshes.data import boundary_areas, region_volumes
from tests import support

CASE = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 6 mm,
  length: 12 mm, sector: half}
mesh: {size: 5 mm, order: 2}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2 GPa, poisson_ratio: 0.3}
  bone:
    kind: transversely_isotropic
    axial_youngs_modulus: 17 GPa
    transverse_youngs_modulus: 11.5 GPa
    axial_poisson_ratio: 0.31
    transverse_poisson_ratio: 0.51
    axial_shear_modulus: 3.3 GPa
    fibre: FIBRE
interfaces: {stem_cement: {kind: contact, friction_coefficient: 0.4}}
supports:
  floor: {kind: fixed, boundary: bone_bottom, stages: [press]}
  wall: {kind: roller, axis: x, boundary: bone_top, stages: [squeeze]}
  plane: {kind: roller, axis: y, boundary: symmetry_y}
  foot: {kind: displacement, boundary: bone_bottom, z: -0.1 mm, history: [0, 1]}
loads:
  push: {kind: force, boundary: stem_top, force: [10 N, 20 N, -300 N], at: [1 mm, 9 mm, 30 mm],
    history: [1, 0.5]}
  squeeze: {kind: pressure, boundary: bone_surface, pressure: 2 MPa, history: [0, 1]}
stages: [{name: press, increments: 4}, {name: squeeze}]
"""


def deck(folder: Path, text: str) -> tuple[str, meshes.MeshData]:
    path = folder / "case.yaml"
    path.write_text(text)
    case = load_case(path)
    data = mantle.mesh(case)
    calculix.write(case, data, folder / "case.inp")
    return (folder / "case.inp").read_text(), data


def blocks(text: str, key: str) -> list[np.ndarray]:
    """Numbers below each of some keywords."""
    tables = [part.partition("\n")[2].split("*")[0] for part in text.split(f"*{key}")[1:]]
    return [
        np.array([line.split(",") for line in f.split("\n") if line], dtype=float) for f in tables
    ]


def test_calculix_forces_have_resultant_and_moment(tmp_path: Path) -> None:
    """The force at its point has F and r x F; the pressure on a half cylinder has 2 R L p."""
    text, data = deck(tmp_path, CASE.replace("FIBRE", "[0, 0, 1]"))
    x = blocks(text, "NODE, ")[0][:, 1:]
    totals = []
    for block in blocks(text, "CLOAD"):
        forces = np.zeros(x.shape)
        forces[block[:, 0].astype(int) - 1, block[:, 1].astype(int) - 1] = block[:, 2]
        totals.append((forces.sum(axis=0), np.cross(x, forces).sum(axis=0)))
    force, at = np.array([10.0, 20.0, -300.0]), np.array([1.0, 9.0, 30.0])
    np.testing.assert_allclose(totals[0][0], force, rtol=1e-10)
    np.testing.assert_allclose(totals[0][1], np.cross(at, force), rtol=1e-10)
    resultant = totals[1][0] - 0.5 * force
    np.testing.assert_allclose(resultant, [0.0, -2.0 * 17.0 * 12.0 * 2.0, 0.0], atol=0.5)
    # The contact interface has its nodes twice, the bonded one once.
    back = meshes.build(
        MeshFile(path=tmp_path / "case.inp", interfaces={n: s for n, s in data.interfaces.items()}),
        MeshOptions(size="1 mm"),
    )
    assert region_volumes(back) == pytest.approx(region_volumes(data))
    assert {n: boundary_areas(back)[n] for n in data.boundaries} == pytest.approx(
        boundary_areas(data)
    )
    doubled = len(np.unique(np.round(x, 9), axis=0))
    assert len(back.points) == doubled < len(x)


def test_calculix_supports_by_stage(tmp_path: Path) -> None:
    """The floor is released in the second stage, in which the foot moves.

    Both have the same nodes.
    """
    text, _ = deck(tmp_path, CASE.replace("FIBRE", "[0, 0, 1]"))
    x, (first, second) = blocks(text, "NODE, ")[0][:, 1:], blocks(text, "BOUNDARY")
    held = x[first[first[:, 1] == 1, 0].astype(int) - 1]
    assert (abs(held[:, 2]) < 1e-9).all() and np.linalg.norm(held[:, :2], axis=1).min() > 10.99
    assert (first[:, 3] == 0.0).all() and (
        x[second[second[:, 1] == 1, 0].astype(int) - 1, 2] == 12.0
    ).all()
    moved = second[second[:, 1] == 3]
    assert len(moved) == len(held) and (moved[:, 3] == -0.1).all()
    assert "*STATIC\n2.5" in text and text.count("*END STEP") == 2


@pytest.mark.parametrize(
    ("fibre", "constants", "orientation"),
    [
        (
            "[0, 0, 2]",
            [17e3, 11.5e3, 11.5e3, 0.31, 0.31, 0.51, 3.3e3, 3.3e3, 11.5e3 / 3.02],
            "RECT",
        ),
        (
            "{kind: circumferential, axis: [0, 0, 1]}",
            [11.5e3, 17e3, 11.5e3, 0.31 * 11.5 / 17, 0.51, 0.31, 3.3e3, 11.5e3 / 3.02, 3.3e3],
            "CYL",
        ),
    ],
)
def test_calculix_materials(
    fibre: str, constants: list[float], orientation: str, tmp_path: Path
) -> None:
    """The order is E1 E2 E3 nu12 nu13 nu23 G12 G13 G23, with nu12 / E1 = nu21 / E2.

    Axis 2 is the hoop's.
    """
    text, _ = deck(tmp_path, CASE.replace("FIBRE", fibre))
    lines = text.partition("*ELASTIC, TYPE=ENGINEERING CONSTANTS\n")[2].splitlines()
    written = [float(word) for word in f"{lines[0]}{lines[1]}".split(",")]
    np.testing.assert_allclose(written, constants, rtol=1e-12)
    assert f"SYSTEM={orientation}" in text
    assert "*ELASTIC\n1.1" in text and "*FRICTION\n4.000000000000e-01, 1.0" in text


@pytest.mark.parametrize(
    ("law", "normal", "tangential", "notes"),
    [
        ("kind: contact", 1e4, 1e3, ["a penalty of 10000 MPa/mm and a stick slope of 1000 MPa/mm"]),
        (
            "kind: contact, elastic_layer: {tangential: 20 MPa/mm}",
            1e4,
            20.0,
            ["a penalty of 10000 MPa/mm in"],
        ),
        (
            "kind: contact, elastic_layer: {normal: 150 MPa/mm, tangential: 130 MPa/mm}",
            150,
            130,
            [],
        ),
        ("kind: penalty, penalty: 500 MPa/mm", 500, 500, []),
    ],
)
def test_calculix_stiffness_of_interfaces(
    law: str, normal: float, tangential: float, notes: list[str], tmp_path: Path
) -> None:
    """Stiffnesses are those of the law; what exact contact lacks is in a note."""
    path = tmp_path / "case.yaml"
    path.write_text(CASE.replace("FIBRE", "[0, 0, 1]").replace("kind: contact", law))
    case = load_case(path)
    written_notes = calculix.write(case, mantle.mesh(case), tmp_path / "case.inp")
    text = (tmp_path / "case.inp").read_text()
    assert blocks(text, "SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR")[0].item() == normal
    np.testing.assert_allclose(blocks(text, "FRICTION")[0], [[0.4, tangential]])
    found = [note for note in written_notes if note.startswith("interfaces.stem_cement: ")]
    assert len(found) == len(notes) and all(map(str.__contains__, found, notes))


def test_calculix_varying_modulus(tmp_path: Path) -> None:
    """Each cell has, to 1 %, the modulus at its middle, which is linear in z."""
    text = CASE.replace("FIBRE", "[0, 0, 1]").replace("order: 2", "order: 2, curved: false")
    text = text.replace("youngs_modulus: 2 GPa", "youngs_modulus: [[0 mm, 1 GPa], [12 mm, 10 GPa]]")
    text, data = deck(tmp_path, text)
    x, E = blocks(text, "NODE, ")[0][:, 1:], np.zeros(len(data.cells))
    for part in text.split("*ELSET, ELSET=cement_")[1:]:
        rows, _, rest = part.partition("*MATERIAL")
        at = np.array(rows.replace(",", "").split()[1:], dtype=int) - 1
        E[at] = float(rest.partition("*ELASTIC\n")[2].split(",")[0])
    z = x[blocks(text, "ELEMENT")[1][:, 1:5].astype(int) - 1, 2].mean(axis=1)
    assert E[E > 0] == pytest.approx(1000 + 750 * z, rel=math.exp(0.01) - 1)


def test_calculix_refuses_unsupported_parts(tmp_path: Path) -> None:
    text = CASE.replace("FIBRE", "[0, 0, 1]").replace("increments: 4", "cycles: 3")
    text = text.replace("friction_coefficient: 0.4", "friction_coefficient: 0.4, gap: 0.1 mm")
    text = text.replace("axis: y,", "normal: face,").replace(
        "{youngs_modulus: 110 GPa, poisson_ratio: 0.3}", "{rigid: true}"
    )
    with pytest.raises(InputError) as caught:
        deck(tmp_path, text)
    refusals = "\n".join(caught.value.messages)
    for words in (
        "stem: an .inp",
        "rigid",
        "gap or an interference",
        "plane: an",
        "stages[0].cycles: an",
    ):
        assert words in refusals, refusals


def solved_by_calculix(folder: Path, changes: str) -> tuple[support.Solved, Floats, Floats]:
    """The stance at 10 mm; displacement of all nodes of each body by mantle and by CalculiX."""
    deck(
        folder,
        "base: stance\nmesh: {size: 10 mm, around: 8, order: 1}\n"
        f"output: {{error: false}}\n{changes}",
    )
    subprocess.run(["ccx", "case"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    table = re.split(r"^ -4  DISP.*\n", (folder / "case.frd").read_text(), flags=re.M)[-1]
    lines = [line for line in table.partition("\n -3")[0].splitlines() if line[:3] == " -1"]
    solved = support.solve(load_case(folder / "case.yaml").config)
    p = solved.problem
    u = hip.nodal_displacements(p)
    of_cell = p.bodies.body_of_tag[bodies.cell_tags(p.tagged)][:, None]
    keys = np.unique(p.space.dofmap.list.astype(np.int64) * len(u) + of_cell)
    node, body = np.divmod(keys, len(u))
    theirs: Floats = np.zeros(u.shape)
    theirs[body, node] = [[float(line[k : k + 12]) for k in (13, 25, 37)] for line in lines]
    ours: Floats = np.zeros(u.shape)
    ours[body, node] = u[body, node]
    return solved, ours, theirs


def numbers(solved: support.Solved, u: Floats, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Subsidence, and p99 of gap and slip at the nodes of the stem [mm]."""
    p = solved.problem
    monkeypatch.setattr(hip, "nodal_displacements", lambda _: u)
    stem = p.scene.parting_interfaces[0]
    f = bodies.facets_between(p.tagged, stem.slave, stem.master)
    dofs = bodies.facet_nodes(p.tagged, p.space, f)[1]
    x, inside = bodies.facet_coordinates(p.tagged, f)
    n = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    area = np.linalg.norm(n, axis=1) / 2
    n *= (np.sign(np.einsum("fi,fi->f", x.mean(axis=1) - inside, n)) / (2 * area))[:, None]
    slave, master = (p.bodies.body_of_region[side[0]] for side in (stem.slave, stem.master))
    jump = u[master, dofs] - u[slave, dofs]
    gap = np.einsum("fci,fi->fc", jump, n)
    slip = np.linalg.norm(jump - gap[..., None] * n[:, None], axis=2)
    both = (SurfaceField(values, area, x).percentile() for values in (gap, slip))
    return [hip.StemMotion(p, solved.case)(solved.case.side)["subsidence"], *both]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")
@pytest.mark.parametrize(
    ("law", "same"),
    [
        ("kind: bonded", []),
        (
            "kind: contact, friction_coefficient: μ,"
            " elastic_layer: {normal: 1e4 MPa/mm, tangential: 1e3 MPa/mm}",
            [0.02, 0.05, 0.05],
        ),
    ],
)
def test_calculix_hip_has_equal_displacements(
    law: str, same: list[float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bonded displacements agree to the printed digits, contact to the error of its facets."""
    stem, bone = law.replace("μ", "0.4"), law.replace("μ", "1.0")
    changes = f"interfaces: {{stem_cement: {{{stem}}}, cement_bone: {{{bone}}}}}"
    solved, ours, theirs = solved_by_calculix(tmp_path, changes)
    assert np.abs(theirs - ours).max() < (5e-3 if same else 5e-6) * np.abs(ours).max()
    if same:
        ours_numbers, other = (numbers(solved, u, monkeypatch) for u in (ours, theirs))
        np.testing.assert_array_less(np.abs(np.array(other) / ours_numbers - 1), same)
