"""Geometry to mesh: blocks, cylinders, a femur, or a file of another program.

``build`` runs on one rank and returns plain arrays; ``meshes.distribute.distribute`` makes
the dolfinx mesh of them, ``app.plots.sections`` draws them. gmsh, scipy and dolfinx are
imported when used, so that checking a configuration needs none of them.

``docs/mesh.md`` describes the meshing of femurs. Radii may come from any function of angle and
height, positions from any point on the stem's outline: other bones, stems and mantles need other
functions and no other mesher.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator
from dataclasses import replace
from importlib import import_module
from itertools import combinations, product
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import GeometryError
from app.foundation.verdict import Reason
from meshes import cache as _cache
from meshes import quality as _quality
from meshes.data import (
    MeshData,
    boundary_areas,
    canonical,
    connected_components,
    faces_of,
    facet_areas,
    interface_facets,
    region_volumes,
)
from meshes.geometry import is_file, is_hip
from meshes.imported import build as build_imported
from meshes.imported import write as write_msh
from meshes.pieces import coincident

if TYPE_CHECKING:
    from app.case.geometries import MeshFile
    from app.case.shapes import MeshOptions, Shape

__all__ = ["MeshData", "build", "write_msh"]

# A mantle that fills the canal divides the cancellous bone; each piece is held by the cortex.
DIVISIBLE = frozenset({"cancellous_bone"})
# Factors on the size, and on the thickness of cement, that are tried where cells are poor.
SIZE_FACTORS = (1.05, 0.95, 1.1, 0.9, 1.2, 1.35, 1.6)
MANTLE_RANGE = (1.0, 8.0)  # mm of cement that a femur may have


def build(geometry: Shape, mesh: MeshOptions, cache: Path | None = None) -> MeshData:
    """Mesh a geometry, or take the mesh from the cache; the same input gives the same mesh.

    ``geometry`` is one of the case's geometries, which names its ``mesher``; ``mesh`` has ``size``,
    ``far`` [mm] and ``curved``. Without a ``cache`` folder nothing is read or written.

    Raises:
        GeometryError: The geometry cannot be built, a boundary, interface or region is empty or
            in pieces, bodies meet where no interface is, or the worst elements (named) are not
            good enough.
    """
    if cache is None:
        return _make(geometry, mesh)
    path = Path(cache) / f"mesh-{_cache.mesh_hash(geometry, mesh)}.npz"
    with _cache.lock(path):
        data = _cache.cached_mesh(path)
        if data is None:
            data = _make(geometry, mesh)
            _cache.store(data, path)
    return data


def _make(geometry: Shape, mesh: MeshOptions) -> MeshData:
    # Imported here: a block needs no femur, and no scipy.
    mesher = import_module(geometry.mesher)
    try:
        data, quality = _checked(mesher, geometry, mesh)
    except _quality.PoorCellsError as error:
        raise GeometryError(f"{error}\n{_remedy(mesher, geometry, mesh)}") from None
    if is_file(geometry):
        # The case knows which interfaces of a file are meshed apart.
        _check_parts(data, (), geometry.interface_sides)
    else:
        _check_parts(data, set(data.regions) - DIVISIBLE, geometry.sliding_boundaries)
    _check_interfaces(data, geometry.joined)
    notes = {
        **data.notes,
        "quality": _quality.notes_on_quality(data, quality),
        "volumes_mm3": region_volumes(data),
        "boundary_areas_mm2": boundary_areas(data),
        "interface_areas_mm2": {
            name: float(facet_areas(data.points, interface_facets(data, name)[0]).sum())
            for name in data.interfaces
        },
    }
    for mantle_keys in geometry.mantles:
        from meshes import gruen, mantle

        zones = gruen.Zones(geometry) if is_hip(geometry) else None
        notes["mantle"] = mantle.notes_on_mantle(
            data, mantle_keys.thickness, mantle_keys.tip, zones
        )
        if zones:
            notes["mantle"]["cortex_min"] = mantle.least_cortex(data, mantle_keys.tip)
    if "stem_bone" in data.interfaces and is_hip(geometry):
        from meshes import mantle

        notes["cortex_min"] = mantle.least_cortex(data, geometry.flanks_end)
    return replace(data, notes=notes, given_neighbours=None)  # others may change the cells


def _checked(mesher: ModuleType, geometry: Shape, mesh: MeshOptions) -> tuple[MeshData, Floats]:
    """Return the mesh and the quality of its cells (m,), all of which are good enough."""
    data = canonical(mesher.build(geometry, mesh))
    return data, _quality.check(data.points, data.cells, data.cell_tags, data.regions)


def _remedy(mesher: ModuleType, geometry: Shape, mesh: MeshOptions) -> str:
    """Return the change that gives good cells: a size that meshes, else a thickness of cement."""
    if is_file(geometry):
        return "Try another mesh.size." if geometry.is_script else "Repair the mesh file."

    def lengths_near(length: float, lowest: float, highest: float) -> list[float]:
        candidates = (float(f"{factor * length:.2g}") for factor in SIZE_FACTORS)
        return [candidate for candidate in candidates if lowest <= candidate <= highest]

    sizes = lengths_near(mesh.size, 0.0, min(mesh.far_size_or_default, geometry.coarsest_size))
    changes: list[tuple[str, float, Shape, MeshOptions]] = [
        ("mesh.size", x, geometry, mesh.model_copy(update={"size": x})) for x in sizes
    ]
    thickness = getattr(geometry, "cement_thickness", None)
    if isinstance(thickness, float):
        for x in lengths_near(thickness, *MANTLE_RANGE):
            thinner = geometry.model_copy(update={"cement_thickness": x})
            changes.append(("geometry.cement_thickness", x, thinner, mesh))
    for key, length, other_geometry, keys in changes:
        with contextlib.suppress(GeometryError):
            _checked(mesher, other_geometry, keys)
            return f"Set {key}: {length:g} mm; with it all elements are good."
    tried_sizes = {key: [x for k, x, *_ in changes if k == key] for key, *_ in changes}
    tried_ranges = [f"{key} from {min(x):g} to {max(x):g} mm" for key, x in tried_sizes.items()]
    tried_text = f"elements are also inverted or nearly flat with {' and '.join(tried_ranges)}"
    return f"Change {geometry.shape_keys}: {tried_text}."


def _check_parts(
    data: MeshData, connected: Collection[str], separate_interfaces: Collection[str] = ()
) -> None:
    """Require every region, boundary and interface.

    Args:
        data: The mesh.
        connected: Regions that must be one body.
        separate_interfaces: Interfaces whose sides share no facet.
    """
    missing = [
        *(f"region {n}" for n, tag in data.regions.items() if not (data.cell_tags == tag).any()),
        *(f"boundary {name}" for name, area in boundary_areas(data).items() if area <= 0),
        *(
            f"interface {name} (no facet between {' and '.join('/'.join(s) for s in sides)})"
            for name, sides in data.interfaces.items()
            if name not in separate_interfaces and not len(interface_facets(data, name)[0])
        ),
    ]
    if missing:
        pair_count = len(coincident(data.points))
        hint = ""
        if pair_count:
            hint = f"; {pair_count} pairs of nodes have the same place: merge them"
        message = "the mesh has no " + ", no ".join(missing) + hint
        raise GeometryError(f"{message} [{Reason.MISSING_PART}]")
    component = connected_components(data.neighbours, data.cell_tags)
    piece_counts = {
        n: len(np.unique(component[data.cell_tags == data.regions[n]])) for n in connected
    }
    broken = ", ".join(f"{name} ({n})" for name, n in piece_counts.items() if n > 1)
    if broken:
        raise GeometryError(
            f"regions in several pieces: {broken}; a region must be one body; "
            "change sizes in `geometry`"
        )


def _check_interfaces(data: MeshData, regions_of_bodies: Collection[Collection[str]]) -> None:
    """Require an interface wherever two bodies meet: they would be tied without one.

    Regions in one collection of ``regions_of_bodies`` are one body.
    """
    allowed = {frozenset(p) for sides in data.interfaces.values() for p in product(*sides)}
    allowed |= {frozenset(pair) for body in regions_of_bodies for pair in combinations(body, 2)}
    messages, undeclared_pairs = [], []
    for a, b, facets in _touching_regions(data):
        if {a, b} in allowed:
            continue
        area = facet_areas(data.points, facets).sum()
        centres = data.points[facets[:, :3]].mean(axis=1)
        x, y, z = centres[np.linalg.norm(centres - centres.mean(axis=0), axis=1).argmin()]
        messages.append(
            f"{a} meets {b} where no interface is declared, on {area:.3g} mm2 about "
            f"({x:.1f}, {y:.1f}, {z:.1f}) mm"
        )
        undeclared_pairs.append((a, b))
    if messages:
        sides = ", ".join(f"{a}_{b}: [{a}, {b}]" for a, b in undeclared_pairs)
        laws = ", ".join(f"{a}_{b}: {{kind: bonded}}" for a, b in undeclared_pairs)
        raise GeometryError(
            f"{'; '.join(messages)}: separate the bodies, or declare interfaces between them, "
            "such as\n"
            f"geometry:\n  interfaces: {{{sides}}}\ninterfaces: {{{laws}}}"
        )


def _touching_regions(data: MeshData) -> Iterator[tuple[str, str, Ints]]:
    """Pairs of regions that meet, and the facets (n, 3) or (n, 6) between them."""
    cell, face, behind = data.facets_between_regions
    for (a, first_tag), (b, second_tag) in combinations(data.regions.items(), 2):
        is_between = (data.cell_tags[cell] == first_tag) & (data.cell_tags[behind] == second_tag)
        if is_between.any():
            yield a, b, faces_of(data.cells, cell[is_between], face[is_between])


def meeting(geometry: MeshFile, mesh: MeshOptions) -> tuple[list[tuple[str, str]], list[str]]:
    """Pairs of regions of a gmsh file that meet, and its interior surfaces."""
    data = canonical(build_imported(geometry, mesh))
    return [(a, b) for a, b, _ in _touching_regions(data)], data.notes["interior_surfaces"]
