"""The grid of the field file: bodies with separate nodes, and their values."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

from app.heat.implicit_step import ImplicitStep
from app.heat.operators import HeatOperators
from app.results.field_output import FieldGroup, Fields, HeatFields, OutputNodes
from app.results.interface_numbers import ContactSamples
from app.results.reading import Run
from app.results.stresses import extrapolated
from app.results.thermal_record import ThermalRecord
from app.scene.bodies import Bodies, bodies_of
from app.scene.scene import Scene
from app.system.timing import Timing
from meshes.distribute import TaggedMesh
from meshes.shape_functions import VTK_TETRAHEDRON, shape_functions
from tests import support
from tests.cases import laws
from tests.cases.temperatures import SIDES, ZERO, two_blocks

H = 0.3  # N/(mm s K): 300 W/(m2 K)


class Motion:
    """Replaces the mechanics: a second-order space in which nothing parts."""

    def __init__(self, tagged: TaggedMesh) -> None:
        self.bodies: Bodies = bodies_of(tagged, (), ())
        self.space = fem.functionspace(tagged.mesh, ("Lagrange", 2, (3,)))

    def values(
        self, nodes: OutputNodes, samples: ContactSamples | None, cells: int
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        place = self.space.tabulate_dof_coordinates()[nodes.dof]
        return {"place": place}, {"one": np.ones(cells)}


def heat(tagged: TaggedMesh, resists: bool) -> HeatFields:
    """Bone at 40 + 4 z + y degC. Cement is colder by 10 + x if the interface resists heat."""
    contact = laws.interface("bone_cement", ("cement",), ("bone",), (H, 0.0, np.inf))
    conductors = tuple(laws.conductor(r, (1.0,), None, 2.0, ZERO + 37) for r in ("bone", "cement"))
    scene = Scene(
        1, (), (), (), (), (), (), (),
        conductors=conductors,
        thermal_contacts=(contact,) if resists else (),
    )  # fmt: skip
    operators = HeatOperators(scene, tagged, Timing())
    forms = operators.forms
    state = ImplicitStep(operators).vectors()
    x = forms.space.tabulate_dof_coordinates()[: forms.owned]
    # The master side has the continuous field.
    bone = ZERO + 40 + 4 * x[:, 2] + x[:, 1]
    colder = (10 + x[:, 0]) if resists else 0.0
    state[0].array[:] = np.where(x[:, 2] < 1.999, bone, bone - colder)
    if operators.jumps is not None:
        state[1].array[:] = 10 + x[operators.jumps.dof, 0]
    record = ThermalRecord(tagged, forms, operators.bodies.body_of_region, SIDES, ("bone",), {})
    temperatures = operators.temperatures(state)
    record.start(temperatures)
    record.update(60.0, temperatures)
    for r in record.regions.values():
        r.peak.value += 3.0  # it was hotter once
    degree = x[record.regions["cement"].nodes.dof, 0] / 5
    heating: Any = SimpleNamespace(
        operators=operators, vectors=lambda: state, degrees=lambda: {"cement": degree}
    )
    return HeatFields(heating, record, SIDES)


def written(tagged: TaggedMesh, groups: tuple[FieldGroup, ...], path: Path) -> Run:
    """Fields read back from one step, equal on all ranks."""
    fields = Fields(tagged, groups, path)
    fields.open()
    fields.write(1.0, None)
    tagged.mesh.comm.barrier()
    return Run(path.parent)


def of_regions(run: Run) -> list[np.ndarray]:
    """Nodes of bone and of cement (n,)."""
    return [np.isin(np.arange(len(run.points)), run.nodes_of(region)) for region in (1, 2)]


def check_heat_alone(comm: MPI.Comm, path: Path) -> None:
    tagged = two_blocks(comm)
    run = written(tagged, (heat(tagged, True),), path)
    x, (bone, cement) = run.points, of_regions(run)
    assert run.cells.shape[1] == 4 and "displacement" not in run.point_fields
    # Two blocks of 8 x 8 x 4 cubes: every node once, on any number of ranks.
    assert len(x) == 2 * 9 * 9 * 5 and not (bone & cement).any()
    T = 40 + 4 * x[:, 2] + x[:, 1]
    at = np.abs(x[:, 2] - 2) < 1e-9
    # First side bone: second minus first is negative, and heat flows from first to second.
    jump = np.where(at, -10 - x[:, 0], 0)
    minutes = np.where(T >= 43, 2 ** (T - 43), np.where(T >= 39, 4 ** (T - 43.0), 0))
    for name, values in {
        "temperature": np.where(bone, T, T - 10 - x[:, 0]),
        "temperature_peak": 3 + np.where(bone, T, T - 10 - x[:, 0]),
        "bone_cement_temperature_jump": jump,
        "bone_cement_heat_flux": -1e3 * H * jump,
        "degree_of_cure": np.where(cement, x[:, 0] / 5, 0),
        "cem43": np.where(bone, minutes, 0),
        "seconds_over_47": np.where(bone & (T > 46.999), 60, 0),
    }.items():
        assert run.on_points(name) == pytest.approx(values), name
    comm.barrier()


def check_both(comm: MPI.Comm, path: Path) -> None:
    """Bonded mechanics of second order with heat that jumps, and with heat that does not."""
    tagged = two_blocks(comm)
    for resists in (True, False):
        run = written(tagged, (Motion(tagged), heat(tagged, resists)), path)
        x, (bone, cement) = run.points, of_regions(run)
        assert run.cells.shape[1] == 10 and len(x) == 17 * 17 * (18 if resists else 17)
        assert run.on_points("place") == pytest.approx(x)
        assert (bone & cement).any() != resists
        T = 40 + 4 * x[:, 2] + x[:, 1] - np.where(cement & resists, 10 + x[:, 0], 0)
        assert run.temperature() == pytest.approx(T)
        if resists:  # in the middle of edges, too
            jump = np.where(np.abs(x[:, 2] - 2) < 1e-9, -10 - x[:, 0], 0)
            assert run.on_points("bone_cement_temperature_jump") == pytest.approx(jump)
            assert run.on_points("bone_cement_heat_flux") == pytest.approx(-1e3 * H * jump)
        # Middle nodes are where VTK wants them.
        L = np.array([[0.4, 0.2, 0.3, 0.1]])
        N = shape_functions(L, VTK_TETRAHEDRON)
        assert N @ T[run.cells].T == pytest.approx(L @ T[run.cells[:, :4]].T)
        comm.barrier()


@pytest.mark.parametrize("ranks", support.RANKS)
def test_field_output_is_equal_on_ranks(ranks: int, tmp_path: Path) -> None:
    support.on_ranks(ranks, __file__, tmp_path / "fields.vtkhdf")


if __name__ == "__main__":
    for check in (check_heat_alone, check_both):
        check(MPI.COMM_WORLD, Path(sys.argv[1]))


def test_field_output_extrapolates_linear_fields_to_nodes() -> None:
    rng = np.random.default_rng(2)
    inside, nodes, slopes = rng.random((5, 3)), rng.random((10, 3)), rng.random((4, 3, 6))
    at_nodes = extrapolated(1.0 + inside @ slopes, inside, nodes)
    np.testing.assert_allclose(at_nodes, 1.0 + nodes @ slopes, rtol=1e-12)
    one = rng.random((4, 1, 6))
    expected = np.broadcast_to(one, (4, 10, 6))
    np.testing.assert_allclose(extrapolated(one, inside[:1], nodes), expected)


def test_field_output_gap_is_finite_where_supports_hold_both_sides(tmp_path: Path) -> None:
    """Contact has no faces at points whose two sides have prescribed displacements."""
    case = f"""{support.TWO_BLOCKS}
regions:
  lower: {{youngs_modulus: 1 GPa, poisson_ratio: 0.3}}
  upper: {{youngs_modulus: 1 GPa, poisson_ratio: 0.3}}
interfaces: {{lower_upper: {{kind: contact, friction_coefficient: 0.3}}}}
supports:
  lower: {{kind: fixed, boundary: lower_x_min}}
  upper: {{kind: fixed, boundary: upper_x_min}}
loads: {{pull: {{kind: pressure, boundary: top, pressure: -1 MPa}}}}
stages: [{{name: pull}}]
"""
    run = support.run(case, tmp_path)
    gap = run.fields.on_points("lower_upper_gap")
    assert np.isfinite(gap).all() and gap.max() > 0
