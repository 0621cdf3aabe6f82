"""A case on a dolfinx mesh of a script."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx.mesh import create_box

import mantle
from app.foundation.errors import InputError
from meshes import data as mesh_data
from meshes.distribute import TaggedMesh, distribute, gather
from tests import support
from tests.support import CONFIGS

ELASTIC = {"youngs_modulus": "1 GPa", "poisson_ratio": 0.3, "tissue": "other"}
CASE: dict[str, Any] = {
    "title": "Two blocks",
    "geometry": {"interfaces": {"joint": ["lower", "upper"]}},
    "regions": {"lower": ELASTIC, "upper": ELASTIC | {"youngs_modulus": "2 GPa"}},
    "interfaces": {"joint": {"kind": "contact", "friction_coefficient": 0.0}},
    "supports": {
        "floor": {"kind": "roller", "boundary": "bottom", "axis": "z"},
        "left": {"kind": "roller", "boundary": "left", "axis": "x"},
        "front": {"kind": "roller", "boundary": "front", "axis": "y"},
    },
    "loads": {"press": {"kind": "pressure", "boundary": "top", "pressure": "3 MPa"}},
}


def blocks(comm: MPI.Comm = MPI.COMM_SELF) -> TaggedMesh:
    box = create_box(comm, [[0, 0, 0], [4, 4, 4]], [2, 2, 2])
    return TaggedMesh.from_markers(
        box,
        regions={"lower": lambda x: x[2] <= 2, "upper": lambda x: x[2] >= 2},
        boundaries={
            "bottom": lambda x: np.isclose(x[2], 0),
            "top": lambda x: np.isclose(x[2], 4),
            "left": lambda x: np.isclose(x[0], 0),
            "front": lambda x: np.isclose(x[1], 0),
        },
    )


def test_given_mesh_is_solved_and_gives_functions(tmp_path: Path) -> None:
    """Frictionless blocks of 2 mm are under 3 MPa.

    Each shortens by p h / E, and the joint carries p.
    """
    results = mantle.run(CASE, tmp_path / "box", mesh=blocks())
    assert results.summary["interfaces"]["joint"]["pressure_mean"] == pytest.approx(3.0)
    u = results.fields.function("displacement")
    x, z = u.function_space.tabulate_dof_coordinates(), u.x.array.reshape(-1, 3)[:, 2]
    assert z[np.isclose(x[:, 2], 4)] == pytest.approx(-(3 * 2 / 1e3 + 3 * 2 / 2e3))
    # Its bodies are apart: both have nodes in the plane of the joint.
    assert np.isclose(x[:, 2], 2).sum() == 2 * np.isclose(x[:, 2], 0).sum()
    again = mantle.load(tmp_path / "box.yaml")
    assert again.config.title == "Two blocks" and (tmp_path / "box.msh").is_file()


@pytest.mark.parallel
def test_given_mesh_on_two_ranks_is_that_of_one(tmp_path: Path) -> None:
    program = "from tests.simulation.test_given_mesh import *\n"
    program += f"mantle.run(CASE, {str(tmp_path / 'box')!r}, mesh=blocks(MPI.COMM_WORLD))\n"
    (tmp_path / "program.py").write_text(program)
    support.on_ranks(2, tmp_path / "program.py")
    results = mantle.read(tmp_path / "box")
    assert results.summary["solver"]["ranks"] == 2
    assert results.summary["interfaces"]["joint"]["pressure_mean"] == pytest.approx(3.0)
    assert results.fields.volumes().sum() == pytest.approx(64.0)


def test_given_mesh_is_gathered_as_it_was_distributed() -> None:
    """Straight and curved cells keep volumes of regions, areas of boundaries, and names."""
    for curved in (False, True):
        data = mantle.mesh(mantle.load(CONFIGS / "cylinders.yaml", **{"mesh.curved": curved}))
        gathered = gather(distribute(data, MPI.COMM_SELF))
        assert gathered is not None
        assert gathered.curved == data.curved
        assert curved == data.curved
        assert gathered.boundaries == data.boundaries and gathered.interfaces == data.interfaces
        for measure in (mesh_data.region_volumes, mesh_data.boundary_areas):
            assert measure(gathered) == pytest.approx(measure(data), rel=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"geometry": {"kind": "file", "path": "a.msh"}},
            "the mesh is an argument of run; expected only",
        ),
        ({"geometry": {"interfaces": {"joint": ["lower", "top"]}}}, "box.yaml:.*'top' is not"),
        ({"loads": {}, "suports": {}}, "box.yaml:.* suports: unknown key"),
        (
            {"geometry": {}},
            "has no interface 'joint'; it has none; declare it: geometry: {interfaces: {joint: ",
        ),
    ],
)
def test_given_mesh_refuses(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words):
        mantle.run(CASE | change, tmp_path / "box", mesh=blocks())


def test_given_mesh_without_names_is_refused_with_the_way_to_give_them(tmp_path: Path) -> None:
    box = create_box(MPI.COMM_SELF, [[0, 0, 0], [4, 4, 4]], [2, 2, 2])
    other: Any = box
    with pytest.raises(InputError, match=r"expected a TaggedMesh.* TaggedMesh\.from_markers\("):
        mantle.run(CASE, tmp_path / "box", mesh=other)


def test_given_mesh_names_that_mark_nothing_are_refused() -> None:
    """The message says what exists: the place of the mesh, or its tags."""
    box = create_box(MPI.COMM_SELF, [[0, 0, 0], [4, 4, 4]], [2, 2, 2])
    whole = {"all": lambda x: x[2] > -1}
    sides = {"top": lambda x: np.isclose(x[2], 4), "side": lambda x: np.isclose(x[0], 5)}
    fault = "boundaries: no exterior facet is marked side; the mesh has x 0 to 4, y 0 to 4, z 0"
    with pytest.raises(InputError, match=fault):
        TaggedMesh.from_markers(box, whole, sides)
    with pytest.raises(InputError, match="regions: no cell is marked none; the mesh has x 0 to 4"):
        TaggedMesh.from_markers(box, whole | {"none": lambda x: x[2] > 9}, {})
    named = TaggedMesh.from_markers(box, whole, {"top": sides["top"]})
    parts = named.mesh, named.cell_tags, named.facet_tags
    with pytest.raises(InputError, match="boundaries: no exterior facet is marked b; the tags are"):
        TaggedMesh.from_tags(*parts, {"all": 1}, {"a": 1, "b": 7})
    with pytest.raises(InputError, match="regions: no cell is marked c; the tags are 1"):
        TaggedMesh.from_tags(*parts, {"all": 1, "c": 2}, {})


@pytest.mark.parametrize(
    ("zone", "covers"),
    [({"above": "3 mm"}, False), ({"below": "1 mm"}, False), ({"above": "1 mm"}, True)],
)
def test_given_mesh_zones_that_cover_nothing_are_refused(
    zone: dict[str, str], covers: bool, tmp_path: Path
) -> None:
    """The joint is at z = 2 mm."""
    joint = {"kind": "contact", "friction_coefficient": 0.3}
    joint |= {"zones": {"a": zone | {"friction_coefficient": 0.1}}}
    case = CASE | {"interfaces": {"joint": joint}}
    if covers:
        results = mantle.run(case, tmp_path / "box", mesh=blocks())
        assert "a" in results.summary["interfaces"]["joint"]["zones"]
        return
    fault = r"interfaces\.joint\.zones\.a: covers nothing of the interface, .* height 2 mm"
    with pytest.raises(InputError, match=fault):
        mantle.run(case, tmp_path / "box", mesh=blocks())


def test_given_mesh_goes_with_a_case_of_mappings_alone(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="needs an output and a mesh"):
        mantle.run(CASE, tmp_path / "box")
    loaded = mantle.load(CONFIGS / "blocks.yaml")
    with pytest.raises(InputError, match="a loaded case already has a mesh"):
        mantle.run(loaded, tmp_path / "box", mesh=blocks())
