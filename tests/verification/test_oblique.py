"""Rollers in any direction: a rotated model has the numbers of the straight one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import meshes
from app.case.case import Case
from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.laws.supports import Roller
from app.results.balance import Balance
from app.soundness.well_posedness import check_on_mesh, mesh_parts
from app.verification.changed_meshes import CHANGES, ROTATION
from meshes.distribute import TaggedMesh, distribute
from tests import support
from tests.cases.stems import QUARTER
from tests.support import vector

BLOCK = """
geometry: {kind: blocks, blocks: [{name: block, size: [4 mm, 6 mm, 5 mm]}]}
mesh: {size: 3 mm, far_size: 3 mm}
regions: {block: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}}
supports:
  x: {kind: roller, boundary: x_min, axis: x}
  y: {kind: roller, boundary: y_min, axis: y}
  z: {kind: roller, boundary: bottom, axis: z}
loads: {push: {kind: force, boundary: top, force: [0 N, 0 N, -120 N]}}
"""
PLATE = (
    "geometry.blocks=[{name: block, size: [4 mm, 6 mm, 5 mm]}, "
    "{name: plate, size: [4 mm, 6 mm, 3 mm]}]",
)


def turn(text: str, *overrides: str, face: bool = False) -> tuple[Case, TaggedMesh]:
    """A case and its mesh, both rotated: rollers along axes become oblique ones."""
    straight = support.case(text, *overrides)
    data = CHANGES["turned"](meshes.build(straight.geometry, straight.mesh, None))
    changes = [*overrides]
    for name, s in straight.supports.items():
        if isinstance(s, Roller) and s.axis:
            normal = "face" if face else vector(3 * ROTATION[:, "xyz".index(s.axis)])
            stages = f", stages: [{', '.join(s.stages)}]" if s.stages else ""
            support_ = f"kind: roller, boundary: {s.boundary}, normal: {normal}{stages}"
            changes.append(f"supports.{name}={{{support_}}}")
    for name, load in straight.loads.items():
        if load.resultant:
            changes.append(f"loads.{name}.force={vector(ROTATION @ load.resultant, ' N')}")
    return support.case(text, *changes), distribute(data, support.MPI.COMM_WORLD)


def reactions(solved: support.Solved) -> Floats:
    """Forces through the supports at the nodes [N]."""
    u, q = solved.solver.u_and_q()
    trial = solved.problem.trial(u, q) if q is not None else None
    return np.array(Balance(solved.problem, np.zeros(3))._measure(u, trial).reaction.reshape(-1, 3))


def same(text: str, *overrides: str, face: bool = False, tolerance: float = 1e-9) -> None:
    """Solve a case straight and rotated.

    Displacements and reactions rotate, and numbers are equal.
    """
    one = support.solve(text, *overrides, balances=True)
    this, tagged = turn(text, *overrides, face=face)
    other = support.solve(this, tagged=tagged, balances=True)
    for region in this.regions:
        (x, u), (y, v) = one.displacement(region), other.displacement(region)
        np.testing.assert_allclose(y, x @ ROTATION.T, atol=1e-12)
        assert support.difference(v, u @ ROTATION.T) < tolerance
    force = reactions(one) @ ROTATION.T
    assert np.abs(reactions(other) - force).max() < tolerance * max(1.0, np.abs(force).max())
    for name, numbers in one.interfaces.items():
        for key, value in numbers.items():
            if isinstance(value, float) and not key.startswith("penetration"):
                number = other.interfaces[name][key]
                assert number == pytest.approx(value, rel=1e-8, abs=1e-10), (name, key)
    assert other.balances.max() < 1e-8


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("face", [False, True])
def test_oblique_rollers_rotated_quarter_equals_quarter(order: int, face: bool) -> None:
    """Planes of symmetry cut both sides of both interfaces of a press fit with friction."""
    same(QUARTER, f"mesh.order={order}", face=face)


def test_oblique_rollers_rotated_quarter_around_a_rigid_stem() -> None:
    """The planes leave the stem one motion."""
    under = "supports.under_cement={kind: roller, boundary: bone_bottom, axis: z}"
    same(QUARTER, "regions.stem={rigid: true}", under)


@pytest.mark.parametrize("rigid", [False, True])
def test_oblique_rollers_released_and_held_again(rigid: bool) -> None:
    """An oblique support of a block, or of a plate on it, is released and acts again."""
    supports = (
        "supports.side={kind: roller, boundary: x_max, axis: x, stages: [a, c]}",
        "stages=[{name: a}, {name: b}, {name: c}]",
        "loads.pull={kind: force, boundary: y_max, force: [30 N, 20 N, -10 N], history: [1, 2, 1]}",
    )
    plate = (*PLATE, "regions.plate={rigid: true}")
    same(BLOCK, *supports, *(plate if rigid else ()))


def test_oblique_rollers_of_two_planes_at_45_degrees() -> None:
    """Two rollers at 45 degrees hold the edge that they share. A fixed corner is held."""
    wedge = (
        "supports.y={kind: roller, boundary: y_min, normal: [1, 1, 0]}",
        "supports.z={kind: fixed, boundary: bottom}",
    )
    solved = support.solve(BLOCK, *wedge)
    x, u = solved.displacement("block")
    edge = (x[:, 0] < 1e-9) & (x[:, 1] < 1e-9)
    assert np.abs(u[edge, :2]).max() < 1e-15 and np.abs(u[edge & (x[:, 2] > 1), 2]).min() > 1e-4
    side = x[:, 1] < 1e-9
    assert np.abs(u[side] @ [1, 1, 0]).max() < 1e-15 and np.abs(u[side, 0]).max() > 1e-5


RINGS = """
geometry: {kind: cylinders, stem_radius: 4 mm, cement_thickness: 3 mm, bone_thickness: 3 mm,
           length: 3 mm, taper: 0 deg, sector: quarter}
mesh: {size: 3 mm, order: 2}
regions:
  stem: {youngs_modulus: 2000 MPa, poisson_ratio: 0.3, eigenstrains: [{strain: 0.01}]}
  cement: {youngs_modulus: 1000 MPa, poisson_ratio: 0.2}
  bone: {youngs_modulus: 1000 MPa, poisson_ratio: 0.2}
supports:
  symmetry_x: {kind: roller, boundary: symmetry_x, axis: x}
  symmetry_y: {kind: roller, boundary: symmetry_y, axis: y}
  bottom: {kind: roller, boundary: bottom, axis: z}
  top: {kind: roller, boundary: top, axis: z}
  shell: {kind: roller, boundary: bone_surface, normal: face}
"""


def test_oblique_rollers_ring_in_a_rigid_shell() -> None:
    """A core swells in a ring whose outside slides in a shell: Lame's solution, by hand."""
    solved = support.solve(RINGS)
    b, c, e = 4.0, 10.0, 0.01
    (λ1, G1), (λ2, G2) = (
        (E * ν / (1 + ν) / (1 - 2 * ν), E / 2 / (1 + ν)) for E, ν in ((2000.0, 0.3), (1000.0, 0.2))
    )
    # u = A r inside, u = B (r - c^2 / r) outside; equal displacement and radial stress at b.
    core, ring = 2 * λ1 + 2 * G1, 2 * λ2 + 2 * G2 * (1 + c**2 / b**2)
    A = (3 * λ1 + 2 * G1) * e / (core - ring / (1 - c**2 / b**2))
    x, u = solved.displacement("stem")
    assert np.sqrt(np.mean((u - A * x * [1, 1, 0]) ** 2)) < 1e-3 * A * b


def test_oblique_rollers_shaft_rotates_in_its_bearing() -> None:
    """The core is twisted and the side held radially.

    The whole shaft rotates, because the side is free around the axis.
    """
    turns = []
    for side in ("", ", side: {kind: roller, boundary: bone_surface, normal: face}"):
        twist = (
            "geometry.sector=full",
            "supports={bottom: {kind: fixed, boundary: bottom}, "
            "core: {kind: displacement, boundary: stem_top, x: -0.01 * y, y: 0.01 * x, z: 0 mm}"
            f"{side}}}",
        )
        x, u = support.solve(RINGS, *twist).displacement("bone")
        outside = np.hypot(x[:, 0], x[:, 1]) > 9.99
        turns.append((x[:, 0] * u[:, 1] - x[:, 1] * u[:, 0])[outside])
    assert turns[1].mean() == pytest.approx(turns[0].mean(), rel=2e-3)
    assert np.abs(np.einsum("ni,ni->n", x[:, :2], u[:, :2])[outside]).max() < 2e-3 * turns[0].max()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("x={kind: roller, boundary: x_min}", r"supports.x: has no direction; expected axis: x, y"),
        (
            "x={kind: roller, boundary: x_min, axis: x, normal: face}",
            "supports.x.normal: cannot be combined with axis; expected axis: x, y or",
        ),
        ("x={kind: roller, boundary: x_min, normal: fcae}", r"expected a direction .* or face"),
        (
            "z={kind: roller, boundary: bottom, normal: [1, 1, 0]}",
            "no support holds the model along z",
        ),
    ],
)
def test_oblique_rollers_refuse_wrong_directions(change: str, expected: str) -> None:
    """A roller has exactly one direction. The message has the place and the allowed keys."""
    with pytest.raises(InputError, match=expected):
        support.case(BLOCK, f"supports.{change}")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            (
                "supports.x={kind: displacement, boundary: x_min, x: 0.1 mm}",
                "supports.y={kind: roller, boundary: y_min, normal: [1, 1, 0]}",
            ),
            r"supports.x, y.*: contradict each other at \(0, 0, .*prescribe equal displacements",
        ),
        (
            (
                *PLATE,
                "regions.plate={youngs_modulus: 1 GPa, poisson_ratio: 0.3}",
                "interfaces.block_plate={kind: contact, friction_coefficient: 0.3}",
                "supports.x={kind: roller, boundary: block_x_min, axis: x}",
                "supports.a={kind: roller, boundary: plate_x_min, normal: [1, 0.2, 0]}",
            ),
            "neither the same nor at right angles; use",
        ),
    ],
)
def test_oblique_rollers_refuse_contradictory_supports(
    changes: tuple[str, ...], expected: str
) -> None:
    """Displacements are at an angle to the direction of a roller, or sides of an interface are."""
    with pytest.raises(InputError, match=expected):
        support.solve(BLOCK, *changes)


def test_oblique_rollers_refuse_a_face_with_an_edge() -> None:
    this = support.case(BLOCK)
    data = meshes.build(this.geometry, this.mesh, None)
    walls = {"walls": data.boundaries["x_max"] + data.boundaries["y_min"]}
    data = replace(data, boundaries={**data.boundaries, **walls})
    supports = {**this.supports, "y": Roller(boundary="walls", normal="face")}
    this = this.model_copy(update={"supports": supports})
    edge = "boundary 'walls' has an edge at .* a separate support for each face"
    with pytest.raises(InputError, match=edge):
        support.solve(this, tagged=distribute(data, support.MPI.COMM_WORLD))


@pytest.mark.parametrize(
    ("y", "expected"), [("[1, -1, 0]", ""), ("[2, 2, 0]", r"nothing holds .* along"), ("face", "")]
)
def test_oblique_rollers_free_motions_of_normals(y: str, expected: str) -> None:
    """The check on the mesh accepts two planes and the floor, and refuses one direction twice."""
    this = support.case(
        BLOCK,
        "supports.x={kind: roller, boundary: x_min, normal: [1, 1, 0]}",
        f"supports.y={{kind: roller, boundary: y_min, normal: {y}}}",
    )
    parts = mesh_parts(this, meshes.build(this.geometry, this.mesh, None))
    if expected:
        with pytest.raises(InputError, match=expected):
            check_on_mesh(this, parts)
    else:
        assert not check_on_mesh(this, parts)
