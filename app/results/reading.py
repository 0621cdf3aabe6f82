"""Reading of a run directory: summary, step record, fields at every written step.

The module uses neither MPI nor meshes of dolfinx, so that tools for many runs load no solver.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable
from functools import cached_property
from math import ceil
from pathlib import Path
from typing import Any, cast

from mpi4py import MPI  # before h5py, which may be built for MPI

import basix
import h5py
import numpy as np
from numpy.typing import NDArray

from app.case.summary import Summary
from app.foundation.arrays import Floats, Ints
from app.foundation.errors import InputError
from app.results.vtkhdf import QUADRATIC_NODES
from app.schema import yaml_file
from app.schema.section import did_you_mean
from app.system.folders import path_files
from meshes.data import exterior_facets, facet_areas
from meshes.shape_functions import (
    STRAIGHT,
    VTK_TETRAHEDRON,
    shape_functions,
    slopes_of_shape_functions,
)

# Columns of the file of a path by their titles: numbers, or names of regions.
PathTable = dict[str, NDArray[Any]]
# Distance over the least size of a cell within which middles of cells are one [-].
SAME_PLACE = 1e-5
FACES = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))


class Results:
    """The results of a run directory, or of its variations."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __repr__(self) -> str:
        """Return folder, title, interfaces with slip and gap, and the names of other results."""
        variations = self.variations
        if variations:
            return f"results in {self.folder}: variations {', '.join(variations)}"
        numbers = self.summary.get("interfaces", {}).items()
        lines = [
            f"  {name}: slip {1e3 * q['slip_p99']:.4g} um, gap {1e3 * q['gap_p99']:.4g} um (p99)"
            for name, q in numbers
            if "slip_p99" in q
        ]
        first_line = f"results in {self.folder}: {self.case.get('title') or 'without title'}"
        return "\n".join(
            [first_line, *lines[:3], "  .summary, .step_record, .fields, .case, .variations"]
        )

    @cached_property
    def case(self) -> dict[str, Any]:
        """The case as it was solved: mappings, lists and scalars, in internal units."""
        return yaml_file.read(self.folder / "case.yaml").data

    @cached_property
    def summary(self) -> Summary:
        """The content of summary.json, with its units under ``units``."""
        content = (self.folder / "summary.json").read_text(encoding="utf-8")
        return cast(Summary, json.loads(content))

    @cached_property
    def step_record(self) -> dict[str, Floats]:
        """Columns of history.csv, by their titles with units; nan where there is no value."""
        return _columns(self.folder / "history.csv")

    @cached_property
    def fields(self) -> Run:
        """The fields at every written step.

        Raises:
            OSError: The run has no fields (``output.fields: false``), or they cannot be read.
        """
        return Run(self.folder)

    @cached_property
    def variations(self) -> dict[str, Results]:
        """The results of the variations by their names; empty without variations."""
        path = self.folder / "variations.json"
        rows = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
        return {row["name"]: Results(self.folder / row["name"]) for row in rows}

    @cached_property
    def paths(self) -> dict[str, PathTable]:
        """Fields along the paths by their names: columns by their titles; nan outside bodies."""
        return {name: _columns(file) for name, file in path_files(self.folder).items()}

    @property
    def log(self) -> str:
        """Log of the run; empty if there is no log next to the directory."""
        path = self.folder.with_name(f"{self.folder.name}.log")
        return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""


def _columns(file: Path) -> dict[str, NDArray[Any]]:
    """Columns of a CSV file by their titles: names of regions, else numbers; nan where empty."""
    with file.open(encoding="utf-8", newline="") as opened_file:
        rows = list(csv.DictReader(opened_file))
    columns: dict[str, NDArray[Any]] = {}
    for key in rows[0] if rows else ():
        if key == "region":
            columns[key] = np.array([row[key] for row in rows])
        else:
            columns[key] = np.array([float(row[key] or "nan") for row in rows])
    return columns


class Run(Results):
    """A run directory with fields.

    A step is given by its number among the written steps, from 0 or negative from the end, or by
    the name of a stage for its last written step.

    Attributes:
        points: Positions of the nodes (n, 3) [mm]; an interface has one node per body.
        cells: Nodes of the cells (m, 4 or 10), in VTK's order.
        region: Number of the region of each cell (m,), from 1.
        regions: Number of each region by its name.
        times: Times of the written steps; stage k runs from k to k + 1.
        contacts: Names of the interfaces that have contact points.
        point_fields: Names of the fields on points.
        cell_fields: Names of the fields on cells.

    Raises:
        OSError: The run has no fields, or they cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        with self._file() as file:
            root = file["VTKHDF"]
            self.points: Floats = root["Points"][:]
            width = len(root["Connectivity"]) // len(root["Types"])
            self.cells: Ints = root["Connectivity"][:].reshape(-1, width)
            self.region: Ints = root["CellData/region"][:].astype(np.int64)
            region_names = root["FieldData/region_names"].asstr()[:]
            self.regions = {name: number for number, name in enumerate(region_names, 1)}
            self.times: Floats = root["Steps/Values"][:]
            self.point_fields = tuple(root["PointData"])
            self.cell_fields = tuple(root["CellData"])
        status_fields = [n for n in self.point_fields if n.endswith("_status")]
        self.contacts = tuple(n.removesuffix("_status") for n in status_fields)

    @cached_property
    def written_stages(self) -> list[str]:
        """Names of the stages with a written step, in order."""
        stage_names = [stage["name"] for stage in self.case["stages"]]
        stages_with_step = {ceil(time - 1e-9) - 1 for time in self.times}
        return [name for k, name in enumerate(stage_names) if k in stages_with_step]

    def on_points(self, name: str, step: int | str = -1) -> Floats:
        """Return a field on the nodes at a written step (n,) or (n, k), by its name in the file."""
        return self._field(f"PointData/{name}", len(self.points), step)

    def on_cells(self, name: str, step: int | str = -1) -> Floats:
        """Return a field on the cells at a written step (m,) or (m, k), by its name in the file."""
        return self._field(f"CellData/{name}", len(self.cells), step)

    @cached_property
    def mesh(self) -> Any:
        """The dolfinx mesh of the fields, on this process, with separate nodes for each body."""
        from basix.ufl import element
        from dolfinx.mesh import create_mesh

        cells = np.empty_like(self.cells)
        cells[:, QUADRATIC_NODES[: cells.shape[1]]] = self.cells
        shape = element("Lagrange", "tetrahedron", self.degree, shape=(3,))
        return create_mesh(MPI.COMM_SELF, cells, x=self.points, e=shape)

    def function(self, name: str, step: int | str = -1) -> Any:
        """Return a field on the nodes at a written step as a dolfinx `Function` on `mesh`."""
        from dolfinx import fem

        values = self.on_points(name, step)
        geometry = self.mesh.geometry
        element = ("Lagrange", geometry.cmap.degree, values.shape[1:])
        function = fem.Function(fem.functionspace(self.mesh, element), name=name)
        nodes = geometry.input_global_indices[geometry.dofmap]
        function.x.array.reshape(values.shape)[function.function_space.dofmap.list] = values[nodes]
        return function

    @property
    def degree(self) -> int:
        """Degree of the fields on the nodes: 1 or 2."""
        return 1 if self.cells.shape[1] == 4 else 2

    def cells_of(self, mesh: Any) -> Ints:
        """Return the number in `cells` of each cell of a dolfinx mesh on this rank (k,).

        Ghosts are included.

        Args:
            mesh: The mesh that `mantle.run` was called with, on any number of ranks.

        Raises:
            InputError: The mesh has a cell that the results do not have.
        """
        from dolfinx.mesh import compute_midpoints
        from scipy.spatial import cKDTree

        index_map = mesh.topology.index_map(3)
        local = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
        corners = self.points[self.cells[:, :4]]
        distance, cells = cKDTree(corners.mean(axis=1)).query(compute_midpoints(mesh, 3, local))
        size = np.ptp(corners, axis=1).min(initial=np.inf)
        missing_cells = int((distance > SAME_PLACE * size).sum())
        if missing_cells:
            raise InputError(f"{missing_cells} cells of the mesh are not those of {self.folder}")
        return np.asarray(cells)

    def function_on(self, mesh: Any, name: str, step: int | str = -1) -> Any:
        """Return a field on the nodes as a dolfinx `Function` on the mesh of `mantle.run`.

        The function space is discontinuous, because fields jump at interfaces. Each cell, ghosts
        included, has the values of its body. Every rank reads the file.

        Args:
            mesh: The dolfinx mesh, on any number of ranks.
            name: Name of the field in the file.
            step: Written step.

        Raises:
            InputError: As in `cells_of`, or there is no such field.
        """
        from dolfinx import fem

        values = self.on_points(name, step)
        space = fem.functionspace(mesh, ("Discontinuous Lagrange", self.degree, values.shape[1:]))
        function = fem.Function(space, name=name)
        dofs = space.dofmap.list
        nodes = self.cells[self.cells_of(mesh)]
        # The dofs of a cell are at its nodes, but in another order.
        x = space.tabulate_dof_coordinates()[dofs]
        squared_distance = ((x[:, :, None] - self.points[nodes][:, None]) ** 2).sum(axis=3)
        nearest = np.take_along_axis(nodes, squared_distance.argmin(axis=2), axis=1)
        function.x.array.reshape(-1, *values.shape[1:])[dofs] = values[nearest]
        return function

    def displacement(self, step: int | str = -1) -> Floats:
        """Return the displacement of the nodes at a written step (n, 3) [mm]."""
        return self.on_points("displacement", step)

    def temperature(self, step: int | str = -1) -> Floats:
        """Return the temperature of the nodes at a written step (n,) [degC]."""
        return self.on_points("temperature", step)

    def nodes_of(self, region: str | int) -> Ints:
        """Nodes of a region, by its name or number; other regions may share some of them.

        Raises:
            InputError: There is no such region.
        """
        number = self.regions.get(region) if isinstance(region, str) else region
        if number not in self.regions.values():
            raise self._unknown("region", region, self.regions)
        return np.unique(self.cells[self.region == number])

    def volumes(self) -> Floats:
        """Return the volume of each cell (m,) with straight edges [mm3]."""
        x = self.points[self.cells[:, :4]]
        return np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / 6

    def stress(self, step: int | str = -1) -> Floats:
        """Return the mean stress of each cell at a written step (m, 3, 3) [MPa]."""
        # VTK's order: XX, YY, ZZ, XY, YZ, XZ.
        return self.on_cells("stress", step)[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)

    def at_interface(self, name: str, quantity: str, step: int | str = -1) -> Floats:
        """Return an interface quantity at all nodes: (n,), or (n, 3) for vectors; 0 outside of it.

        Quantities are gap, slip, slip_path, motion [mm], pressure, shear [MPa] and status. Slip and
        motion are vectors.

        Raises:
            InputError: There is no such interface, or it has no such quantity.
        """
        summary = self.summary
        interfaces = [*summary.get("interfaces", {}), *summary.get("bonds", {})]
        if name not in interfaces:
            raise self._unknown("interface", name, interfaces)
        prefix = f"{name}_"
        quantities = [n.removeprefix(prefix) for n in self.point_fields if n.startswith(prefix)]
        if quantity not in quantities:
            raise self._unknown("quantity", quantity, quantities, f" at interface '{name}'")
        return self.on_points(f"{name}_{quantity}", step)

    def on_interface(self, name: str) -> NDArray[np.bool_]:
        """Return the mask of the contact points of an interface, on both sides (n,)."""
        corners = np.zeros(len(self.points), dtype=bool)
        corners[self.cells[:, :4]] = True
        return corners & (self.at_interface(name, "status", 0) >= 0)

    def areas(self, name: str) -> Floats:
        """Return the area of an interface by node (n,), half of it on each side [mm2].

        A corner has a third of each facet whose corners are contact points of both bodies.
        """
        corners, _ = exterior_facets(self.cells[:, :4])
        corners = corners[self.on_interface(name)[corners].all(axis=1)]
        # An interface has two facets at the same place, one for each body.
        centre = np.round(self.points[corners].mean(axis=1), 9)
        _, pair, count = np.unique(centre, axis=0, return_inverse=True, return_counts=True)
        return self.area_by_node(corners[count[pair.ravel()] == 2]) / 2

    def area_by_node(self, corners: Ints) -> Floats:
        """Return the area of facets (f, 3) by node (n,), a third at each corner [mm2]."""
        thirds = np.repeat(facet_areas(self.points, corners) / 3, 3)
        return np.bincount(corners.ravel(), thirds, len(self.points)).astype(float)

    def norms(
        self, exact: Callable[[Floats, Ints], Floats], values: Floats | None = None, degree: int = 6
    ) -> tuple[float, float, float]:
        """Return L2 norms of the error of a field, of the field and of the exact field.

        Args:
            exact: The exact values (q, k) at points (q, 3), and their regions (q,).
            values: Nodal values (n, k); the displacement at the end by default.
            degree: Degree of the quadrature.

        Returns:
            Norms of the error, of the field and of the exact field.
        """
        rule = basix.make_quadrature(basix.CellType.tetrahedron, degree)
        points, weights = (np.asarray(a) for a in rule)
        barycentric = np.column_stack([1 - points.sum(axis=1), points])
        edges = VTK_TETRAHEDRON if self.cells.shape[1] == 10 else STRAIGHT
        N = shape_functions(barycentric, edges)
        dN = slopes_of_shape_functions(barycentric, edges)
        nodal = self.displacement() if values is None else values
        x, u = self.points[self.cells], nodal[self.cells]
        measure = np.abs(np.linalg.det(np.einsum("cni,qnj->cqij", x, dN))) * weights
        positions = np.einsum("qn,cni->cqi", N, x).reshape(-1, 3)
        exact_values = exact(positions, np.repeat(self.region, len(weights))).reshape(
            *measure.shape, -1
        )
        field_values = np.einsum("qn,cni->cqi", N, u)

        def norm(values: Floats) -> float:
            return float(np.sqrt((measure * (values**2).sum(axis=2)).sum()))

        return norm(field_values - exact_values), norm(field_values), norm(exact_values)

    def _file(self) -> h5py.File:
        """Open the fields without a lock: a viewer may have one, and a folder may be read-only.

        Raises:
            OSError: They cannot be read; the message has the file and the cause.
        """
        path = self.folder / "fields.vtkhdf"
        try:
            return h5py.File(path, "r", locking=False)
        except FileNotFoundError:
            raise
        except OSError as error:
            raise OSError(f"{path}: the fields cannot be read: {error}") from error

    def _field(self, name: str, rows: int, step: int | str) -> Floats:
        group, _, field_name = name.partition("/")
        fields = self.point_fields if group == "PointData" else self.cell_fields
        if field_name not in fields:
            location = "points" if group == "PointData" else "cells"
            raise self._unknown("field", field_name, fields, f" on {location}")
        k = self.number_of(step)
        with self._file() as file:
            field = file["VTKHDF"][name]
            k = 0 if len(field) == rows else k  # constant fields are stored once
            return np.asarray(field[k * rows : (k + 1) * rows])

    def number_of(self, step: int | str) -> int:
        """Return the number of a written step, counted from 0.

        Raises:
            InputError: There is no such step.
        """
        return self._last_of(step) if isinstance(step, str) else self._written(step)

    def _written(self, step: int) -> int:
        """Return the number of a written step counted from 0; InputError if there is none."""
        count = len(self.times)
        if not -count <= step < count:
            fault = f"no written step {step}; there are {count}, 0 to {count - 1}"
            raise InputError(f"{self.folder}: {fault}")
        return step % count

    def _last_of(self, stage: str) -> int:
        """Return the last written step of a stage; InputError if there is none."""
        if stage not in self.written_stages:
            raise self._unknown("stage", stage, self.written_stages, " with a written step")
        time_of_stage_end = {s["name"]: k for k, s in enumerate(self.case["stages"], 1)}
        steps = [
            k for k, time in enumerate(self.times) if ceil(time - 1e-9) == time_of_stage_end[stage]
        ]
        return steps[-1]

    def _unknown(
        self, kind: str, name: str | int, available: Iterable[str], location: str = ""
    ) -> InputError:
        """Return the error for an unknown name, which lists the available ones."""
        available_names = [*available]
        hint = did_you_mean(str(name), available_names)
        plural = f"{kind.removesuffix('y')}ies" if kind.endswith("y") else f"{kind}s"
        name_list = ", ".join(available_names) or "none"
        return InputError(
            f"{self.folder}: no {kind} '{name}'{location}; {plural}: {name_list}{hint}"
        )
