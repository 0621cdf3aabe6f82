"""A proximal femur before the operation: cortical bone around cancellous bone, with head and neck.

Shaft, trochanters, canal and muscle patches are those of the femur with a stem (``femur_bone``),
up to the levels where those end. What the operation would take away is a sphere about the head's
centre, and a cone along the axis of the neck that joins it to the shaft; both are shells of
cortical bone. Assumed, for want of a published set that goes with this shaft: a neck of 0.70 of the
head's diameter in its middle (means are 48 and 33 mm in men, not verified), round and without
anteversion, as the implant; a cortex of 2 mm under the head, of 3.5 mm at the root of the neck,
alike all around (it is thicker below and thinner above); no cartilage; and no fovea.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from . import femur_bone
from .data import Floats, Ints, MeshData, exterior_facets
from .femur_bone import PATCH_RADIUS
from .quality import best_of
from .session import drop_orphans, extract, generate, session
from .tags import assemble, number

REGIONS = ("cortical_bone", "cancellous_bone")
# Radius of the neck at the axis of the shaft and at the head's centre, over that of the head.
NECK = (0.76, 0.65)
# Cortex at the same places [mm]; the second is that of the head too.
CORTEX = (3.5, 2.0)
# Tried in turn when elements come out flat: factor of the sizes, and the mesher.
ATTEMPTS = ((1.0, 10), (0.96, 10), (1.04, 1), (0.9, 10), (0.8, 10))


def build(geometry: Any, mesh: Any) -> MeshData:
    """Mesh the bone.

    Args:
        geometry: The parameters of the configuration's intact femur.
        mesh: ``size`` at the endosteal surface, ``far_size`` [mm], ``curved``.

    Returns:
        Two regions, and the boundaries distal_cut, bone_surface, head and five muscle patches, the
        last two parts of bone_surface. Notes: head centre, attempts, factor of the sizes.

    Raises:
        GeometryError: No attempt gave a mesh.
    """
    data = best_of("femur", ((how[0], partial(_attempt, geometry, mesh, *how)) for how in ATTEMPTS))
    head = [geometry.head_offset, 0.0, geometry.head_height]
    return MeshData(**{**vars(data), "notes": {"head_centre": head, **data.notes}})


def _attempt(geometry: Any, mesh: Any, factor: float, algorithm: int) -> MeshData:
    """Mesh once."""
    far_size = mesh.far_size or 4 * mesh.size
    with session("femur") as gmsh:
        gmsh.option.setNumber("Mesh.Algorithm3D", algorithm)
        pieces = _model(gmsh, geometry)
        inside = pieces["cancellous_bone"]
        femur_bone.grade(gmsh, geometry, inside, mesh.size * factor, far_size * factor)
        generate(gmsh, mesh.curved)
        points, cells, entity = extract(gmsh)
    regions = number(REGIONS)
    tags = np.zeros(len(cells), dtype=np.int32)
    for name, volumes in pieces.items():
        tags[np.isin(entity, volumes)] = regions[name]
    exterior = exterior_facets(cells)
    boundaries = _boundaries(points, exterior[0], geometry)
    return assemble(points, cells, tags, regions, {}, boundaries, exterior)


def _model(gmsh: Any, geometry: Any) -> dict[str, list[int]]:
    """The solids, cut into conforming volumes; returns those of each region."""
    occ = gmsh.model.occ
    bottom, radius = geometry.distal_cut_z, geometry.head_radius
    outer = femur_bone.outer(bottom)
    shaft = [(3, femur_bone.solid(gmsh, outer))]
    patches = femur_bone.patches(gmsh, outer, shaft)
    neck = [radius * part for part in NECK]
    bone, _ = occ.fuse(shaft, _head(gmsh, geometry, neck, radius))
    inner = [r - cortex for r, cortex in zip(neck, CORTEX, strict=True)]
    canal = [(3, femur_bone.solid(gmsh, femur_bone.canal(bottom, 0.0)))]
    marrow, _ = occ.fuse(canal, _head(gmsh, geometry, inner, radius - CORTEX[1]))
    inputs = [*bone, *marrow, *patches]
    _, children = occ.fragment(inputs, [])
    occ.synchronize()
    inside = {tag for pieces in children[len(bone) : -len(patches)] for _, tag in pieces}
    whole = {tag for pieces in children[: len(bone)] for _, tag in pieces}
    drop_orphans(gmsh)
    return {"cortical_bone": sorted(whole - inside), "cancellous_bone": sorted(inside)}


def _head(gmsh: Any, geometry: Any, neck: list[float], radius: float) -> list[tuple[int, int]]:
    """A sphere about the head's centre and a cone from it to the axis of the shaft."""
    occ = gmsh.model.occ
    centre, root = _axis(geometry)
    cone = occ.addCone(*root, *(centre - root), neck[0], neck[1])
    return [(3, occ.addSphere(*centre, radius)), (3, cone)]


def _axis(geometry: Any) -> tuple[Floats, Floats]:
    """The ends of the neck's axis: the head's centre, and where it meets that of the shaft."""
    height = geometry.head_height + geometry.head_offset / math.tan(geometry.neck_angle)
    centre = np.array([geometry.head_offset, 0.0, geometry.head_height])
    return centre, np.array([0.0, 0.0, height])


def _boundaries(points: Floats, facets: Ints, geometry: Any) -> dict[str, Any]:
    """Masks over the exterior facets, by name."""
    corners = points[facets[:, :3]]
    centre = corners.mean(axis=1)
    near = 1e-4
    distal = np.all(np.abs(corners[..., 2] - geometry.distal_cut_z) < near, axis=1)
    middle, _ = _axis(geometry)
    distance = np.linalg.norm(corners - middle, axis=2)
    masks = {"distal_cut": distal, "bone_surface": ~distal}
    masks["head"] = np.all(np.abs(distance - geometry.head_radius) < 1e-3, axis=1)
    for name, at in femur_bone.insertions(femur_bone.outer(geometry.distal_cut_z)).items():
        near_it = np.linalg.norm(centre - at, axis=1) < PATCH_RADIUS
        masks[name] = ~distal & near_it & ~masks["head"]
    return masks
