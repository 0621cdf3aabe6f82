"""Names for the tags of a dolfinx mesh."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import mesh

from app.foundation.errors import InputError
from meshes.distribute import TaggedMesh


def box(kind: mesh.CellType = mesh.CellType.tetrahedron) -> mesh.Mesh:
    return mesh.create_box(MPI.COMM_SELF, [[0, 0, 0], [2, 2, 2]], [2, 2, 2], kind)


def test_distribute_names_parts_by_their_place() -> None:
    """Half of 48 cells are below. Each face has 8 triangles."""
    tagged = TaggedMesh.from_markers(
        box(),
        {"lower": lambda x: x[2] <= 1, "upper": lambda x: x[2] >= 1},
        {"bottom": lambda x: np.isclose(x[2], 0)},
    )
    assert [len(tagged.cell_tags.find(k)) for k in tagged.regions.values()] == [24, 24]
    assert len(tagged.facet_tags.find(*tagged.boundaries["bottom"])) == 8


def test_distribute_refuses_a_boundary_inside_the_body() -> None:
    """A boundary has exterior facets alone."""
    with pytest.raises(InputError, match="no exterior facet is marked middle"):
        TaggedMesh.from_markers(
            box(),
            {"all": lambda x: x[2] >= 0},
            {"middle": lambda x: np.isclose(x[2], 1)},
        )


def test_distribute_needs_a_region_for_every_cell() -> None:
    with pytest.raises(InputError, match="cells without a region"):
        TaggedMesh.from_markers(box(), {"lower": lambda x: x[2] <= 1}, {})


def test_distribute_needs_tetrahedra() -> None:
    with pytest.raises(InputError, match="type hexahedron; expected tetrahedron"):
        TaggedMesh.from_markers(box(mesh.CellType.hexahedron), {"all": lambda x: x[2] >= 0}, {})
