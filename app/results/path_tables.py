"""Fields along paths: one CSV file for each path, with a row for each point and recorded step.

Rows are written at the steps of the field file, so that curves and fields show the same states. The
value at a point is interpolated by the shape functions of its cell from the nodal values in the
field file. Stress at a node is the mean over cells of one region, so that it jumps between bonded
regions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.case.case import Case
from app.foundation.arrays import Floats, Ints
from app.foundation.collective import on_root
from app.foundation.errors import InputError
from app.results.field_output import (
    FieldGroup,
    OutputNodes,
    named_stress,
    output_nodes,
)
from app.results.interface_numbers import ContactSamples
from app.scene.bodies import cell_tags
from app.scene.path_fields import PathColumn, columns
from app.scene.path_points import path_points
from app.scene.scene import Scene
from app.system.folders import csv_text
from meshes.data import MeshData
from meshes.distribute import TaggedMesh
from meshes.paths import PathPoints

# Fields that are computed from the stress at a point.
FROM_STRESS = ("von_mises", "principal_max", "principal_min")
# Digits of numbers in files.
DIGITS_OF_NUMBERS = 10
# Decimals of positions [mm].
PLACE = 9
# Columns before those of the fields.
ARC = "arc length [mm]"
PLACES = ("x [mm]", "y [mm]", "z [mm]")
REGION = "region"


@dataclass(frozen=True)
class SampledPath:
    """A path on all ranks.

    Attributes:
        points: Its points.
        columns: Its fields.
    """

    points: PathPoints
    columns: Sequence[PathColumn]


@dataclass(frozen=True)
class _Local:
    """Points of a path in cells of this rank.

    Attributes:
        point: Numbers of the points in the path (n,).
        cell: Their cells (n,).
        nodes: Nodes of these cells (n, k).
        shape: Shape functions at the points (n, k).
        corner: Nearest corner of the cell (n,).
    """

    point: Ints
    cell: Ints
    nodes: Ints
    shape: Floats
    corner: Ints


def path_tables(
    case: Case,
    scene: Scene,
    tagged: TaggedMesh,
    groups: Sequence[FieldGroup],
    data: MeshData | None,
) -> PathTables | None:
    """Return the files of the paths of a case; None without paths; collective.

    Args:
        case: The case.
        scene: The scene of the case.
        tagged: The mesh of the case.
        groups: Sources of the fields.
        data: The whole mesh on rank 0; None on other ranks.

    Raises:
        InputError: A path names a field that the run does not have.
    """
    if not case.output.paths:
        return None

    def sampled() -> dict[str, SampledPath]:
        assert data is not None
        return {
            name: SampledPath(path_points(case, scene, data, path), columns(case, scene, name))
            for name, path in case.output.paths.items()
        }

    return PathTables(tagged, groups, on_root(tagged.mesh.comm, sampled) or {})


class PathTables:
    """The files of paths; created on all ranks.

    Attributes:
        rows: Rows of each file as text, by the name of the path; on rank 0.

    Raises:
        InputError: A path names a field on cells that the run does not have.
    """

    saved = ("rows",)

    def __init__(
        self,
        tagged: TaggedMesh,
        groups: Sequence[FieldGroup],
        paths: Mapping[str, SampledPath],
    ) -> None:
        self._comm, self._groups, self._paths = tagged.mesh.comm, tuple(groups), dict(paths)
        self.rows = dict.fromkeys(paths, "")
        self._cells = owned = tagged.mesh.topology.index_map(3).size_local
        original = tagged.mesh.topology.original_cell_index[:owned]
        order = np.argsort(original)
        local_paths: dict[str, tuple[Ints, Ints]] = {}
        for name, path in paths.items():
            path_cells = path.points.cell
            local_rows = np.flatnonzero(np.isin(path_cells, original))
            sorted_row = np.searchsorted(original, path_cells[local_rows], sorter=order)
            local_paths[name] = local_rows, order[sorted_row]
        cells = np.unique(np.concatenate([cell for _, cell in local_paths.values()]))
        tags = cell_tags(tagged)[cells]
        nodes, rows, _ = output_nodes(tagged, groups, cells, tags)
        all_regions = np.unique(np.concatenate([path.points.region for path in paths.values()]))
        self._regions = {tag: name for name, tag in tagged.regions.items()}
        visited_tags = [int(tag) for tag in all_regions if tag]
        region_lists = [[self._regions[tag]] for tag in visited_tags]
        of_nodes = cell_tags(tagged)[nodes[0].cell]
        region_rows = np.searchsorted(visited_tags, of_nodes)
        self._nodes: list[OutputNodes] = [
            replace(n, parts=region_lists, part=region_rows) for n in nodes
        ]
        element = groups[0].space.element.basix_element
        self._local: dict[str, _Local] = {}
        for name, (local_rows, cell) in local_paths.items():
            barycentric = paths[name].points.barycentric[local_rows]
            shape = np.asarray(element.tabulate(0, barycentric[:, 1:]))[0, :, : rows.shape[1], 0]
            row = rows[np.searchsorted(cells, cell)]
            self._local[name] = _Local(local_rows, cell, row, shape, barycentric.argmax(axis=1))
        self._check_cell_fields()

    def _check_cell_fields(self) -> None:
        """Raise an error for fields on cells that the run does not have; collective."""
        field_names: set[str] = set()
        for group in self._groups:
            field_names |= group.of_cells(self._cells).keys()
        for name, path in self._paths.items():
            for k, column in enumerate(path.columns):
                if column.field.by_cell and column.field.name not in field_names:
                    fault = f"{column.field.label} is constant in each region and is not written"
                    raise InputError(
                        f"output.paths.{name}.fields.{k}: {fault}; expected another field"
                    )

    def add(
        self, step: int, time: float, seconds: float | None, samples: ContactSamples | None
    ) -> None:
        """Add the rows of a step; collective."""
        point: dict[str, Floats] = {}
        cell: dict[str, Floats] = {}
        for group, nodes in zip(self._groups, self._nodes, strict=True):
            point |= group.at_nodes(nodes, samples, self._cells)
            cell |= group.of_cells(self._cells)
        step_columns: dict[str, object] = {"step": step, "time [-]": _digits(time)}
        if seconds is not None:
            step_columns["seconds [s]"] = _digits(seconds)
        for name, path in self._paths.items():
            local = self._local[name]
            sampled = [_sampled(column, local, point, cell) for column in path.columns]
            values = np.array(sampled).T
            gathered = self._comm.gather((local.point, values))
            if gathered is None:
                continue
            table = np.full((len(path.points.arc), len(path.columns)), np.nan)
            for rows, rank_values in gathered:
                table[rows] = rank_values
            self._add_rows(name, path, step_columns, table)

    def _add_rows(
        self, name: str, path: SampledPath, step_columns: Mapping[str, object], table: Floats
    ) -> None:
        """Add the rows of a path at a step; on rank 0."""
        points = path.points
        titles = [column.title for column in path.columns]
        rows: list[dict[str, object]] = []
        for k in range(len(points.arc)):
            row = dict(step_columns)
            row[ARC] = _digits(points.arc[k])
            row |= dict(zip(PLACES, map(_digits, np.round(points.x[k], PLACE) + 0.0), strict=True))
            row[REGION] = self._regions.get(int(points.region[k]), "")
            row |= {title: _digits(v) for title, v in zip(titles, table[k], strict=True)}
            rows.append(row)
        header, _, body = csv_text(rows).partition("\n")
        self.rows[name] = (self.rows[name] or f"{header}\n") + body


def _digits(value: float) -> object:
    """Round a number to the digits of the file; an empty text for nan."""
    return float(f"{value:.{DIGITS_OF_NUMBERS}g}") if np.isfinite(value) else ""


def _sampled(
    column: PathColumn, local: _Local, point: Mapping[str, Floats], cell: Mapping[str, Floats]
) -> Floats:
    """Return the values of a column at the points of this rank (n,)."""
    field = column.field
    if field.by_cell:
        return cell[field.file_name][local.cell]
    if field.name in FROM_STRESS and not field.interface:
        σ = np.einsum("nk,nkc->nc", local.shape, point["stress"][local.nodes])
        return named_stress(σ)[field.name]
    if field.file_name not in point:
        # Before the first step of the mechanics there is no contact.
        return np.full(len(local.point), np.nan)
    values = point[field.file_name][local.nodes]
    if field.nearest:
        return np.asarray(values[np.arange(len(values)), local.corner])
    sampled = np.einsum("nk,nk...->n...", local.shape, values)
    if not field.axes:
        return np.asarray(sampled)
    if column.component is None:
        return np.asarray(np.linalg.norm(sampled, axis=1))
    return np.asarray(sampled[:, column.component])
