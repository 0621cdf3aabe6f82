"""Inputs without influence: augmentation, size of the load, orientation of the model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import meshes
from app.case.case import load_case
from app.case.mesh_names import ALLOWED
from app.foundation.arrays import Field, Floats
from app.laws.loads import Force, Load
from app.laws.materials import Elastic
from app.scene.scene import Interface, Scene, build_scene
from app.verification.changed_meshes import ROTATION
from forms.contact import OPEN, SLIP, STICK
from meshes.data import MeshData
from meshes.distribute import distribute
from tests import support
from tests.cases.stems import PEG, PEG_MESH
from tests.support import Solved

# A tapered stem pushed in and sideways and partly back, with fixed steps.
STEM = f"""{support.stem("24 mm", "size: 3.5 mm, far_size: 5 mm")}{support.CONTACT}
loads:
  push: {{kind: force, boundary: stem_top, force: [0 N, 0 N, -900 N], history: [1, 0.7]}}
  lateral: {{kind: force, boundary: stem_top, force: [900 N, 600 N, 0 N], history: [1, -0.3]}}
stages:
  - {{name: load, increments: 2, adaptive: false}}
  - {{name: back, increments: 2, adaptive: false}}
solver: {{tolerance: 1.0e-12, max_iterations: 80}}
"""


@pytest.fixture(scope="module")
def reference() -> Solved:
    return support.solve(STEM, balances=True)


def assert_same(one: Solved, other: Solved, factor: float = 1.0) -> None:
    """All values of every point and step are proportional, to a fraction of the maximum."""
    assert len(one.samples) == len(other.samples)
    for a, b in zip(one.samples, other.samples, strict=True):
        np.testing.assert_array_equal(a.status, b.status)
        for i in np.unique(a.interface):
            on = a.interface == i
            # Shear and gap may be zero to rounding.
            sizes = {"shear": a.pressure[on], "gap": a.motion[on]}
            for name in ("gap", "slip", "path", "motion", "pressure", "shear", "force"):
                x, y = getattr(a, name)[on], getattr(b, name)[on] / factor
                scale = float(np.abs(sizes.get(name, x)).max())
                assert np.abs(x - y).max() < 1e-6 * scale, (i, name)


@pytest.mark.parametrize("factor", [1e-2, 100.0])
def test_invariances_augmentation_changes_no_result(reference: Solved, factor: float) -> None:
    """The r goes from 1e-2 to 100 times its default.

    The solver lowers a value that is too large.
    """
    r = reference.case.solver.augmentation_factor * factor
    other = support.solve(
        STEM, f"solver.augmentation_factor={r!r}", tagged=reference.tagged, balances=True
    )
    assert_same(reference, other)
    assert other.balances.max() < 1e-8
    # The value used is reported.
    before, after = reference.problem.contact.augmentation(), other.problem.contact.augmentation()
    for name, value in after.items():
        level = other.steps[-1].outcome.augmentation / reference.steps[-1].outcome.augmentation
        assert value == pytest.approx(before[name] * factor * level)


def test_invariances_given_augmentation_is_used() -> None:
    case = support.case(STEM, "interfaces.stem_cement.augmentation=37 MPa/mm")
    problem, _ = support.assemble(case)
    assert problem.contact.augmentation()["stem_cement"] == pytest.approx(37)


def test_invariances_balances_close(reference: Solved) -> None:
    """Force, moment and energy close after every step, with friction in both directions."""
    assert reference.balances.shape == (4, 3)
    assert reference.balances.max() < 1e-8
    for q in reference.interfaces.values():
        assert q["penetration_max"] < 1e-12
        assert q["dissipation"] > 0
    # Points of all kinds, or the comparisons here would be of little worth.
    share = [
        np.mean([s.weight[s.status == k].sum() / s.weight.sum() for s in reference.samples])
        for k in (OPEN, STICK, SLIP)
    ]
    assert min(share) > 0.03, share


@pytest.mark.parametrize("factor", [1e-3, 50.0])
def test_invariances_results_scale_with_the_load(reference: Solved, factor: float) -> None:
    """Bodies are linear, without an initial gap, and friction is Coulomb's.

    Results are proportional to the load.
    """
    overrides = [
        f"loads.push.force=[0 N, 0 N, {-900 * factor!r} N]",
        f"loads.lateral.force=[{900 * factor!r} N, {600 * factor!r} N, 0 N]",
    ]
    other = support.solve(STEM, *overrides, tagged=reference.tagged)
    assert_same(reference, other, factor)


# Two stages on two blocks with supports, springs, eigenstrain and pressure: every kind of work.
WORK = """
geometry: {kind: blocks, blocks: [{name: lower, size: [8 mm, 6 mm, 4 mm]},
                                  {name: upper, size: [8 mm, 6 mm, 4 mm]}]}
mesh: {size: 2 mm, far_size: 2 mm, order: ORDER}
regions:
  lower: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
  upper: {kind: transversely_isotropic, axial_youngs_modulus: 700 MPa,
    transverse_youngs_modulus: 400 MPa, axial_poisson_ratio: 0.3, transverse_poisson_ratio: 0.4,
    axial_shear_modulus: 200 MPa, fibre: [1, 0, 2],
    eigenstrains: [{strain: 0.001, history: [1, 0.5]}]}
interfaces:
  lower_upper:
    {kind: KIND, friction_coefficient: 0.3, gap: -0.002 * (1 + x / 8), gap_history: [1, 1]}
supports:
  floor: {kind: foundation, boundary: bottom, stiffness: [200 MPa/mm, 300 MPa/mm, 500 MPa/mm]}
  lid: {kind: displacement, boundary: top, x: 0.01 mm, z: -0.01 mm, history: [0.3, 1]}
  side: {kind: roller, boundary: y_min, axis: y}
loads:
  press: {kind: pressure, boundary: upper_x_max, pressure: 3 MPa, history: [0.5, 1]}
  weight: {kind: body_force, density: [0 N/mm^3, 0.02 N/mm^3, -0.05 N/mm^3]}
  pull: {kind: force, boundary: lower_x_min, force: [10 N, 5 N, 2 N], at: [0 mm, 3 mm, 5 mm],
    history: [0, 1]}
stages:
  - {name: one, increments: 2}
  - {name: two, increments: 2}
solver: {tolerance: 1.0e-12}
"""


@pytest.mark.parametrize(
    ("kind", "order"),
    [("contact", 1), ("contact", 2), ("penalty, penalty: 3000 MPa/mm", 1)],
    ids=["contact P1", "contact P2", "penalty P1"],
)
def test_invariances_balances_with_every_kind_of_load(kind: str, order: int) -> None:
    text = WORK.replace("kind: KIND", f"kind: {kind}").replace("ORDER", str(order))
    result = support.solve(text, balances=True)
    assert result.balances.max() < 1e-8, result.balances


def changed(data: MeshData, R: Floats) -> MeshData:
    """A mesh rotated or mirrored by an orthogonal matrix, with the same numbers of nodes."""
    cells = data.cells
    if np.linalg.det(R) < 0:
        # Corners 0 and 1 change places, and with them the middles of the edges at them.
        straight, curved = [1, 0, 2, 3], [1, 0, 2, 3, 4, 6, 5, 9, 8, 7]
        cells = cells[:, straight if cells.shape[1] == 4 else curved]
    return replace(data, points=data.points @ R.T, cells=cells, given_neighbours=None)


@pytest.mark.parametrize(
    "R",
    [
        pytest.param(ROTATION, id="turned"),
        pytest.param(np.diag([1.0, -1.0, 1.0]), id="mirrored"),
        pytest.param(ROTATION @ np.diag([-1.0, 1.0, 1.0]), id="both", marks=pytest.mark.slow),
    ],
)
def test_invariances_numbers_are_independent_of_axes(
    R: Floats, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A peg in a socket, with edges and corners, is under loads.

    Every number of its interface is equal.
    """
    monkeypatch.setenv(ALLOWED, "1")
    (tmp_path / "peg.geo").write_text(PEG_MESH)
    sides = "interfaces: {peg_socket: [socket, peg]}"
    geometry = f"geometry={{kind: file, path: {tmp_path / 'peg.geo'}, {sides}}}"
    case = support.case(PEG, geometry, "solver.tolerance=1e-12")
    data = meshes.build(case.geometry, case.mesh, None)
    one, other = (
        support.solve(
            PEG,
            geometry,
            "solver.tolerance=1e-12",
            *(
                f"loads.{name}.force=[{', '.join(f'{c!r} N' for c in (Q @ force).tolist())}]"
                for name, force in (("push", [0, 0, -30]), ("x", [12, 0, 0]), ("y", [0, 12, 0]))
            ),
            tagged=distribute(changed(data, Q), MPI.COMM_WORLD),
        )
        for Q in (np.eye(3), R)
    )
    a, b = one.interfaces["peg_socket"], other.interfaces["peg_socket"]
    numbers = [key for key, value in a.items() if isinstance(value, float)]
    assert {"pressure_mean", "shear_mean", "pressure_p99", "slip_max"} <= {*numbers}
    scales = {"pressure": a["pressure_max"], "slip": a["slip_max"], "gap": a["gap_max"]}
    for key in numbers:
        scale = max(abs(a[key]), scales.get(key.split("_")[0], 1e-3))
        assert abs(a[key] - b[key]) < 1e-7 * scale, key
    np.testing.assert_allclose(b["force"], R @ a["force"], atol=1e-6)


MIRROR = np.diag([1.0, -1.0, 1.0])
# What forces on a fixed body load may be turned. What stands on rollers, or has a modulus that
# depends on z, is mirrored.
SHIPPED = {
    **dict.fromkeys(
        ("stance", "stance_cocr", "fatigue", "debonding", "interface_strength"),
        ROTATION @ MIRROR,
    ),
    **dict.fromkeys(("thin_femur", "blocks", "cylinders", "variations", "creep_taper"), MIRROR),
}
COARSE = {"blocks": "3 mm", "cylinders": "3 mm", "variations": "4 mm", "creep_taper": "4 mm"}


def moved(scene: Scene, Q: Floats) -> Scene:
    """A scene rotated or mirrored by an orthogonal matrix (3, 3), except for its supports."""

    def vector(v: Any) -> Any:
        return v and tuple((Q @ v).tolist())

    def acting(one: Load) -> Load:
        if not isinstance(one, Force):
            return one
        return one.model_copy(update={"force": vector(one.force), "at": vector(one.at)})

    def elastic(one: Elastic) -> Elastic:
        if one.fibre is None:
            return one
        fibre = one.fibre.model_copy(update={"axis": vector(one.fibre.axis)})
        return one.model_copy(update={"fibre": fibre})

    def field(one: Field) -> Field:
        return lambda x: one(x @ Q)

    def interface(one: Interface) -> Interface:
        constants = {name: field(value) for name, value in one.constants.items()}
        return replace(one, gap=field(one.gap), constants=constants)

    return replace(
        scene,
        loads=[acting(one) for one in scene.loads],
        elastic=[elastic(one) for one in scene.elastic],
        parting_interfaces=[interface(one) for one in scene.parting_interfaces],
    )


@pytest.mark.parametrize(
    "name",
    [
        name if name in ("stance", "cylinders") else pytest.param(name, marks=pytest.mark.slow)
        for name in SHIPPED
    ],
)
def test_invariances_shipped_cases_are_independent_of_axes(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hip rotated by an odd angle and mirrored has equal numbers of its interfaces."""
    size = f"mesh.size={COARSE.get(name, '10 mm')}"
    case = load_case(
        support.ROOT / "configs" / f"{name}.yaml", [size, "solver.tolerance=1e-12"]
    ).config
    data, scene = meshes.build(case.geometry, case.mesh, None), build_scene(case)
    one, other = [], []
    for results, Q in ((one, np.eye(3)), (other, SHIPPED[name])):
        monkeypatch.setattr(support, "build_scene", lambda _, Q=Q: moved(scene, Q))
        solved = support.solve(case, tagged=distribute(changed(data, Q), MPI.COMM_WORLD))
        results.extend(solved.interfaces.items())
    assert one
    for (interface, a), (_, b) in zip(one, other, strict=True):
        scales = {"pressure": a["pressure_max"], "contact": a["pressure_max"] * a["area"]}
        for key, value in a.items():
            if isinstance(value, float):
                scale = max(abs(value), scales.get(key.split("_")[0], 1e-3))
                assert abs(b[key] - value) <= 1e-9 * scale, (interface, key)
        force = SHIPPED[name] @ a["force"]
        np.testing.assert_allclose(b["force"], force, atol=1e-9 * np.linalg.norm(force) + 1e-9)
