"""Nodes that follow a surface: a tied cut, uniform pressure, rotating heads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import meshes
from app.case.geometries import Block, Blocks, MeshOptions
from app.foundation.errors import InputError
from app.mechanics.contact import TrialState
from app.stepping.load_steps import LoadStep
from meshes.data import MeshData
from tests import support
from tests.cases.turning_head import (
    COCR,
    CUP,
    DRIVEN,
    FORCE,
    FRICTION,
    QUARTER,
    R,
    solve,
    stages,
)

SOFT = "regions.head={youngs_modulus: 1 GPa, poisson_ratio: 0.4}"
SIDE = 12  # of each block [mm]
HEIGHT = 6  # of each block [mm]
STACK = """
geometry: {kind: file, path: stack.msh, interfaces: {joint: [lower, upper]}}
mesh: {order: 1, size: 1 m}
regions:
  lower: {youngs_modulus: 1000 MPa, poisson_ratio: 0, tissue: other}
  upper: {youngs_modulus: 3000 MPa, poisson_ratio: 0, tissue: other}
interfaces:
  joint: {kind: bonded}
supports:
  floor: {kind: fixed, boundary: lower_bottom}
  guide: {kind: displacement, boundary: upper_top, x: 0 mm, y: 0 mm}
loads:
  weight: {kind: pressure, boundary: upper_top, pressure: 1 MPa}
solver: {tolerance: 1e-12}
"""


def block(size: float) -> MeshData:
    it = Blocks(blocks=(Block(name="it", size=[f"{SIDE} mm", f"{SIDE} mm", f"{HEIGHT} mm"]),))
    return meshes.build(it, MeshOptions(size=f"{size} mm", far_size=f"{size} mm"))


def stack(path: Path, lower: MeshData, upper: MeshData, apart: bool = True) -> str:
    """Override by which a block and its mirror image are written.

    Nodes at one place are one node unless the blocks are meshed apart.
    """
    start, regions = len(lower.points), np.repeat([1, 2], [len(lower.cells), len(upper.cells)])
    x = np.concatenate([lower.points, upper.points * [1, 1, -1] + [0, 0, 2 * HEIGHT]])
    cells = np.concatenate([lower.cells, upper.cells[:, [1, 0, 2, 3]] + start])
    facets, tags = [], []
    for name, data, face, offset in (
        ("lower_bottom", lower, "bottom", 0),
        ("lower_top", lower, "top", 0),
        ("upper_bottom", upper, "top", start),
        ("upper_top", upper, "bottom", start),
    ):
        if apart or name in ("lower_bottom", "upper_top"):
            here = data.facets[np.isin(data.facet_tags, data.boundaries[face])]
            facets.append(here + offset)
            tags.append(name)
    number = np.arange(len(x))
    if not apart:
        x, number = np.unique(x.round(9), axis=0, return_inverse=True)
    data = MeshData(
        points=x,
        cells=number[cells],
        cell_tags=regions.astype(np.int32),
        facets=number[np.concatenate(facets)],
        facet_tags=np.repeat(range(len(tags)), [len(f) for f in facets]).astype(np.int32),
        regions={"lower": 1, "upper": 2},
        boundaries={name: (k,) for k, name in enumerate(tags)},
        interfaces={"joint": (("lower",), ("upper",))},
    )
    meshes.write_msh(data, path)
    return f"geometry.path={path}"


def sliding(μ: float, **more: object) -> str:
    keys = "".join(f", {key}: {value}" for key, value in more.items())
    faces = "between: [lower_top, upper_bottom]"
    law = f"{{kind: contact, friction_coefficient: {μ}, sliding: finite, {faces}{keys}}}"
    return f"interfaces.joint={law}"


def test_followers_across_a_matching_cut_equal_the_uncut_body(tmp_path: Path) -> None:
    """The meshes match, and everything sticks."""
    data, shear = block(3), "supports.guide.x=0.0001 * y"
    one = support.solve(STACK, stack(tmp_path / "one.msh", data, data, False), shear)
    two = support.solve(STACK, stack(tmp_path / "two.msh", data, data), sliding(1e3), shear)
    displacements = []
    for solved in (one, two):
        problem = solved.problem
        x, tags = problem.space.tabulate_dof_coordinates(), problem.tagged.cell_tags
        for region in ("lower", "upper"):
            cells = tags.find(problem.tagged.regions[region])
            nodes = np.unique(problem.space.dofmap.list[cells])
            u = problem.displacements()[problem.bodies.body_of_region[region]].x.array.reshape(
                -1, 3
            )
            displacements.append(u[nodes[np.lexsort(x[nodes].round(6).T)]])
    for before, after in zip(displacements[:2], displacements[2:], strict=True):
        assert support.difference(after, before) < 1e-10


@pytest.mark.parametrize(("points", "error"), [(12, 0.01), (192, 0.0005)])
@pytest.mark.parametrize("sizes", [(2.9, 4.1), (4.1, 2.9)])
@pytest.mark.parametrize("order", [1, 2])
def test_followers_transmit_uniform_pressure_between_unlike_meshes(
    sizes: tuple[float, float], points: int, error: float, order: int, tmp_path: Path
) -> None:
    """The meshes of the bodies differ slightly. Either one is the finer."""
    path, alike = stack(tmp_path / "stack.msh", *map(block, sizes)), "regions.upper.youngs_modulus"
    alike += "=1001 MPa"
    solved = support.solve(STACK, path, alike, sliding(0, quadrature=points), f"mesh.order={order}")
    pressure = solved.last.pressure
    assert len(pressure) >= 20
    assert support.difference(pressure, np.ones(len(pressure))) < error


@pytest.mark.parametrize(("head", "error"), [(COCR, 0.005), (SOFT, 0.1)])
def test_followers_rotation_without_friction_changes_little(head: str, error: float) -> None:
    """Mean pressure within 20 degrees and force hardly change.

    There is no torque and no dissipation. Equal bodies scatter most, by a tenth at first order on
    this mesh.
    """
    before, *turned = solve(f"{FRICTION}=0", DRIVEN, stages(5), head)
    size = np.linalg.norm(FORCE)
    near = before.normal @ FORCE > np.cos(np.radians(20)) * size
    assert len(turned) == 5 and before.iterations <= 12
    for step in turned:
        assert step.load[near].sum() == pytest.approx(before.load[near].sum(), rel=error)
        np.testing.assert_allclose(step.force, FORCE, rtol=1e-9)
        assert np.linalg.norm(step.torque) < 1e-12 * R * size
        assert step.dissipated == 0


@pytest.mark.parametrize("head", [(COCR,), (SOFT,), (SOFT, "mesh.order=2")])
def test_followers_friction_is_in_balance_on_a_deformable_head(
    head: tuple[str, ...], tmp_path: Path
) -> None:
    """Force, moment and energy are in balance."""
    text = CUP.replace("regions:", "stages: []\nregions:")
    balance = support.run(text, tmp_path, *head, DRIVEN, stages(3)).summary["balance"]
    assert max(balance.values()) < 1e-8


def pile(path: Path, *blocks: MeshData) -> str:
    """Override by which blocks are written on each other, meshed apart."""
    x, cells, facets = [], [], []
    start = 0
    for k, data in enumerate(blocks):
        x.append(data.points + np.array([0, 0, k * HEIGHT]))
        cells.append(data.cells + start)
        for face in ("bottom", "top"):
            facets.append(data.facets[np.isin(data.facet_tags, data.boundaries[face])] + start)
        start += len(data.points)
    regions = {f"block_{k}": k + 1 for k in range(len(blocks))}
    boundaries = [f"{name}_{face}" for name in regions for face in ("bottom", "top")]
    pairs = zip(regions, list(regions)[1:], strict=False)
    data = MeshData(
        points=np.concatenate(x),
        cells=np.concatenate(cells),
        cell_tags=np.repeat([*regions.values()], [len(c) for c in cells]).astype(np.int32),
        facets=np.concatenate(facets),
        facet_tags=np.repeat(range(len(facets)), [len(f) for f in facets]).astype(np.int32),
        regions=regions,
        boundaries={name: (k,) for k, name in enumerate(boundaries)},
        interfaces={f"joint_{k}": ((a,), (b,)) for k, (a, b) in enumerate(pairs)},
    )
    meshes.write_msh(data, path)
    return f"geometry.path={path}"


PILE = """
geometry: {kind: file, path: pile.msh,
  interfaces: {joint_0: [block_0, block_1], joint_1: [block_1, block_2]}}
mesh: {order: 1, size: 1 m}
regions:
  block_0: {rigid: true, tissue: other}
  block_1: {youngs_modulus: 1000 MPa, poisson_ratio: 0, tissue: other}
  block_2: {youngs_modulus: 3000 MPa, poisson_ratio: 0, tissue: other}
interfaces:
  joint_0: {kind: contact, friction_coefficient: 0.3, sliding: finite,
    between: [block_0_top, block_1_bottom]}
  joint_1: {kind: contact, friction_coefficient: 0.3, sliding: finite,
    between: [block_1_top, block_2_bottom]}
supports:
  floor: {kind: fixed, boundary: block_0_bottom}
  guide: {kind: displacement, boundary: block_2_top, x: 0.5 mm, y: 0 mm, history: [0, 1]}
loads:
  weight: {kind: pressure, boundary: block_2_top, pressure: 1 MPa, history: [1, 1]}
stages: [{name: press}, {name: slide, increments: 3}]
output: {report: false, fields: false}
"""


def test_followers_of_rigid_and_deformable_masters_in_one_model(tmp_path: Path) -> None:
    """Both joints share the path of 0.5 mm. Friction of 0.3 of the weight dissipates the work.

    A twentieth of the path is elastic.
    """
    path = pile(tmp_path / "pile.msh", *(block(size) for size in (4.0, 2.9, 3.5)))
    summary = support.run(PILE, tmp_path, path).summary
    assert max(summary["balance"].values()) < 1e-8
    joints = summary["interfaces"].values()
    spent, work = sum(joint["dissipation"] for joint in joints), 0.3 * SIDE**2 * 0.5
    assert 0.93 * work < spent < work
    for joint in joints:
        assert joint["force"][2] == pytest.approx(SIDE**2, rel=1e-9)


def test_followers_energy_balances_with_ordinary_contact_in_the_model(tmp_path: Path) -> None:
    """A deformable head rotates in a liner that can slip in its shell."""
    case = CUP.replace("regions:", "stages: []\nregions:")
    shell = (
        "geometry.shell_thickness=3 mm",
        "regions.shell={youngs_modulus: 110 GPa, poisson_ratio: 0.3}",
        "interfaces.liner_shell={kind: contact, friction_coefficient: 0.3}",
        "supports.outer={kind: fixed, boundary: shell_outer}",
    )
    summary = support.run(case, tmp_path, COCR, DRIVEN, stages(3), *shell).summary
    assert summary["interfaces"]["liner_shell"]["dissipation"] > 1
    assert summary["balance"]["energy"] < 1e-10


def test_followers_of_a_rigid_master_are_paired_without_assembly() -> None:
    """The matrices stay the same from the first step to the last. The surfaces are paired anew."""
    analysis = support.analysis(support.case(CUP, QUARTER, stages(5)))
    problem = analysis.problem
    assert problem is not None
    version, paired = problem.stiffness.version, []

    def keep(step: LoadStep, trial: TrialState | None) -> None:
        assert trial is not None
        assert trial.contact.finite_sliding is not None
        paired.append(trial.contact.finite_sliding.jump_at_committed_pairing)

    analysis.run(keep, on_trouble=print)
    assert not np.array_equal(paired[0], paired[-1])
    assert problem.stiffness.version == version


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        (
            ["loads.hip.boundary=head_surface"],
            r"^loads\.hip: acts on head, which rotates; expected forces on 'head_bore' alone",
        ),
        (
            ["loads.weight={kind: body_force, density: [0 N/mm^3, 0 N/mm^3, -1e-4 N/mm^3]}"],
            r"^loads\.weight: acts on head, which rotates",
        ),
        (
            ["motions.ball.region=liner", "motions.ball.boundary=liner_outer"],
            r"^motions\.ball\.region: liner is elastic, and no softer body slides on it",
        ),
    ],
)
def test_followers_refuse_bodies_that_cannot_rotate(changes: list[str], complaint: str) -> None:
    """The case has a slave, forces next to the driven boundary, or weight.

    Each message names place and remedy.
    """
    with pytest.raises(InputError, match=complaint):
        support.assemble(support.case(CUP, COCR, DRIVEN, *changes))
