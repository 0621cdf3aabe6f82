"""Fields of a run on the dolfinx mesh of a script, on one rank and two."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests import support

STIFFNESS = 1000.0  # MPa, of both blocks; no Poisson's effect
PRESSURE = 3.0  # MPa
GAP = 0.1  # mm, closed by the pressure

# A bar of two blocks that part at z = 2 mm, and its displacement on the script's mesh.
SCRIPT = f"""
import sys

import numpy as np
from dolfinx.mesh import create_box
from mpi4py import MPI

import mantle
from meshes.distribute import TaggedMesh

box = create_box(MPI.COMM_WORLD, [[0, 0, 0], [2, 2, 4]], [2, 2, 4])
sides = {{"x": 0, "y": 1}}
mesh = TaggedMesh.from_markers(
    box,
    regions={{"lower": lambda x: x[2] <= 2, "upper": lambda x: x[2] >= 2}},
    boundaries={{
        "bottom": lambda x: np.isclose(x[2], 0),
        "top": lambda x: np.isclose(x[2], 4),
        **{{axis: lambda x, k=k: np.isclose(x[k], 0) for axis, k in sides.items()}},
    }},
)
elastic = {{"tissue": "other", "youngs_modulus": "{STIFFNESS} MPa", "poisson_ratio": 0}}
case = {{
    "geometry": {{"interfaces": {{"joint": ["lower", "upper"]}}}},
    "mesh": {{"order": int(sys.argv[2])}},
    "regions": {{"lower": elastic, "upper": elastic}},
    "interfaces": {{"joint": {{"kind": "contact", "friction_coefficient": 0, "gap": "{GAP} mm"}}}},
    "supports": {{
        "base": {{"kind": "roller", "boundary": "bottom", "axis": "z"}},
        **{{axis: {{"kind": "roller", "boundary": axis, "axis": axis}} for axis in sides}},
    }},
    "loads": {{"press": {{"kind": "pressure", "boundary": "top", "pressure": "{PRESSURE} MPa"}}}},
    "output": {{"report": False}},
}}
fields = mantle.run(case, sys.argv[1], mesh=mesh).fields
u = fields.function_on(box, "displacement")
assert u.function_space.mesh is box
dofs = u.function_space.dofmap.list
z = u.function_space.tabulate_dof_coordinates()[dofs][:, :, 2]
above = z.mean(axis=1) > 2
exact = -{PRESSURE / STIFFNESS!r} * z - np.where(above, {GAP}, 0.0)[:, None]
found = u.x.array.reshape(-1, 3)[dofs]
error = max(np.abs(found[:, :, 2] - exact).max(), np.abs(found[:, :, :2]).max())
stress = fields.on_cells("stress")[fields.cells_of(box)]
apart = np.abs(stress[:, 2] + {PRESSURE}).max()
# By body, on the continuous dofs of the mesh.
from dolfinx import fem

V = fem.functionspace(box, ("Lagrange", fields.degree, (3,)))
upper = fem.Function(V)
cells = np.flatnonzero(above).astype(np.int32)
upper.interpolate(u, cells0=cells)
rows = np.unique(V.dofmap.list[cells])
there = V.tabulate_dof_coordinates()[rows][:, 2]
body = upper.x.array.reshape(-1, 3)[rows][:, 2]
error = max(error, np.abs(body + {PRESSURE / STIFFNESS!r} * there + {GAP}).max())
worst = [box.comm.allreduce(part, MPI.MAX) for part in (error, apart)]
if box.comm.rank == 0:  # lines of two ranks may meet in one
    print("FOUND", box.comm.size, *worst)
"""


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.parallel)])
def test_reading_fields_on_a_given_mesh(ranks: int, order: int, tmp_path: Path) -> None:
    script = tmp_path / "bar.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        support.mpirun(ranks, script, tmp_path / "out", order),
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | {"PYTHONPATH": str(support.CONFIGS.parent)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if line.startswith("FOUND")]
    assert lines, done.stdout
    _, size, error, stress = lines[0].split()
    assert int(size) == ranks
    assert float(error) < 1e-9
    assert float(stress) < 1e-6
