"""A proximal femur with a cemented stem.

The mantle has the prescribed thickness where the canal has room for it and ends at the endosteal
surface elsewhere. Cutting the offset surface of the stem by the endosteal surface exactly leaves
cancellous wedges of no thickness, which no mesher survives. So the cement is first cut a film's
width inside the canal, the model is meshed, and the film is then given to the cement wherever
less than a film's width of cancellous bone would remain (``femur_mantle``).
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from app.errors import GeometryError

from . import femur_bone, femur_mantle, femur_stem
from .data import Floats, Ints, MeshData, exterior_facets
from .femur_bone import PATCH_RADIUS
from .quality import best_of
from .session import drop_orphans, extract, generate, session
from .tags import assemble, number

REGIONS = ("stem", "cement", "cortical_bone", "cancellous_bone")
INTERFACES = {
    "stem_cement": (("stem",), ("cement",)),
    "cement_bone": (("cement",), ("cortical_bone", "cancellous_bone")),
}
LEAST_MANTLE = 0.4  # mm of cement that the canal must leave room for before the film is added
# Tried in turn when elements come out flat: factors of the film and of the sizes, and the mesher.
# Facets much larger than the film cut through each other: the last ones are as coarse as can be.
ATTEMPTS = (
    *((1.0, 1.0, 10), (1.0, 0.96, 10), (1.15, 1.0, 10), (1.0, 1.04, 1), (0.85, 0.93, 10)),
    *((1.0, 0.8, 10), (1.0, 0.65, 10), (1.0, 0.5, 10)),
)
BIG = 400.0


def build(geometry: Any, mesh: Any) -> MeshData:
    """Mesh the femur.

    Args:
        geometry: The parameters of the configuration's femur.
        mesh: ``size``, ``far_size`` [mm], ``curved``.

    Returns:
        Four regions, two interfaces, and the boundaries distal_cut, bone_surface, stem_trunnion,
        resection and five muscle patches. Notes: head centre, film, attempts.

    Raises:
        GeometryError: The stem does not fit the canal (with the place), or no attempt gave
            elements good enough.
    """
    _refuse_the_impossible(geometry)
    return best_of(
        "femur",
        (
            (size, partial(_attempt, geometry, mesh, film * femur_mantle.FILM, size, algorithm))
            for film, size, algorithm in ATTEMPTS
        ),
    )


def _refuse_the_impossible(geometry: Any) -> None:
    """Raise GeometryError where the stem, or the room for its cement, leaves the canal."""
    z = np.linspace(geometry.stem_tip_z, geometry.resection_height, 200)
    theta, z = np.meshgrid(np.linspace(-np.pi, np.pi, 181), z)
    canal = femur_bone.canal(geometry.distal_cut_z, geometry.canal_widening)
    room = canal.radius(theta, z) - femur_stem.body(geometry).radius(theta, z)
    if room.min() < femur_mantle.FILM + LEAST_MANTLE:
        at = np.unravel_index(room.argmin(), room.shape)
        side = "medially" if np.cos(theta[at]) > 0.7 else "laterally"
        side = side if abs(np.cos(theta[at])) > 0.7 else "antero-posteriorly"
        raise GeometryError(
            f"geometry: the canal leaves {room.min():.2f} mm beside the stem at z = {z[at]:.0f} mm,"
            f" {side}; the mantle needs {femur_mantle.FILM + LEAST_MANTLE:.1f} mm: widen the canal"
            " (canal_widening), narrow the stem or move it proximally (stem_tip_z)"
        )


def _rim(geometry: Any) -> float:
    """Level at which the mantle ends laterally, where the neck cut is higher than the shoulder.

    One to three millimetres below the shoulder, chosen so that the line in which this level meets
    the neck cut stays clear of the edges of the stem and of its offset: next to one it would
    leave faces a hundredth of a millimetre wide.
    """
    shape = femur_stem.body(geometry)
    shoulder = geometry.stem_tip_z + geometry.stem_length
    normal, level = femur_bone.resection(geometry)
    choices = shoulder - np.linspace(1.0, 3.0, 9)
    a, _, r = shape.section(choices)
    t = geometry.cement_thickness
    meets = (level - normal[2] * choices) / max(normal[0], 1e-9)
    edges = np.stack([a - r, a, a + t, r - a, -a, -a - t])
    clear = np.abs(meets - edges).min(axis=0)
    return float(choices[clear.argmax()])


def _attempt(geometry: Any, mesh: Any, film: float, factor: float, algorithm: int) -> MeshData:
    """Mesh once and put the film where it belongs."""
    far_size = mesh.far_size or 4 * mesh.size
    with session("femur") as gmsh:
        gmsh.option.setNumber("Mesh.Algorithm3D", algorithm)
        pieces = _model(gmsh, geometry, film)
        femur_bone.grade(gmsh, geometry, pieces["cement"], mesh.size * factor, far_size * factor)
        _adapt_faces(gmsh, [*pieces["stem"], *pieces["cement"]])
        generate(gmsh, mesh.curved)
        points, cells, entity = extract(gmsh)
    regions = number(REGIONS)
    tags = np.zeros(len(cells), dtype=np.int32)
    for name, volumes in pieces.items():
        tags[np.isin(entity, volumes)] = regions[name]
    shape = femur_stem.body(geometry)
    canal = femur_bone.canal(geometry.distal_cut_z, geometry.canal_widening)
    tags, notes = femur_mantle.fill_film(
        points,
        cells,
        tags,
        regions,
        canal,
        shape.offset(geometry.cement_thickness),
        film,
        geometry.stem_tip_z - geometry.plug_length,
    )
    exterior = exterior_facets(cells)
    data = assemble(
        points,
        cells,
        tags,
        regions,
        INTERFACES,
        _boundaries(points, exterior, tags, regions, geometry),
        exterior,
    )
    notes |= {"head_centre": [geometry.head_offset, 0.0, geometry.head_height], "film_mm": film}
    return MeshData(**{**vars(data), "notes": notes})


def _model(gmsh: Any, geometry: Any, film: float) -> dict[str, list[int]]:
    """The solids, cut into conforming volumes; returns those of each region."""
    occ = gmsh.model.occ
    shape = femur_stem.body(geometry)
    cavity = shape.offset(geometry.cement_thickness)
    bottom, plug = geometry.distal_cut_z, geometry.stem_tip_z - geometry.plug_length
    shoulder = geometry.stem_tip_z + geometry.stem_length
    rim = _rim(geometry)
    outer = femur_bone.outer(bottom)
    canal = femur_bone.canal(bottom, geometry.canal_widening)
    inset = femur_bone.canal(bottom, geometry.canal_widening - film)

    def removed() -> list[tuple[int, int]]:
        """What the operation takes away: above the neck cut, and above the mantle."""
        normal, level = femur_bone.resection(geometry)
        box = (3, occ.addBox(-BIG, -BIG, 0, 2 * BIG, 2 * BIG, BIG))
        occ.rotate([box], 0, 0, 0, 0, 1, 0, geometry.resection_angle)
        occ.translate([box], *(level * normal))
        return [box, (3, femur_stem.loft(gmsh, cavity, rim, rim + 60.0))]

    bone = [(3, femur_bone.solid(gmsh, outer))]
    patches = femur_bone.patches(gmsh, outer, bone)
    bone, _ = occ.cut(bone, removed())
    marrow, _ = occ.cut([(3, femur_bone.solid(gmsh, canal))], removed())
    cement, _ = occ.intersect(
        [(3, femur_stem.loft(gmsh, cavity, plug, rim))],
        [(3, femur_bone.solid(gmsh, inset))],
    )
    cement, _ = occ.cut(cement, removed())
    stem, _ = occ.fuse(
        [(3, femur_stem.loft(gmsh, shape, geometry.stem_tip_z, shoulder))],
        [(3, femur_stem.neck(gmsh, geometry, shape))],
    )
    # A disc across the canal at the end of the plug gives the filled film a clean lower rim.
    disc = [(2, occ.addDisk(0, 0, plug, 60, 60))]
    disc, _ = occ.intersect(disc, marrow, removeTool=False)
    inputs = [*bone, *marrow, *cement, *stem, *disc, *patches]
    owner = {
        **dict.fromkeys(bone, "cortical_bone"),
        **dict.fromkeys(marrow, "cancellous_bone"),
        **dict.fromkeys(cement, "cement"),
        **dict.fromkeys(stem, "stem"),
    }
    _, children = occ.fragment(inputs, [])
    occ.synchronize()
    region: dict[int, str] = {}
    for parent, pieces in zip(inputs, children, strict=True):
        for dim, tag in pieces:
            if dim == 3:
                region[tag] = owner[parent]  # the last one wins: the solids are nested
    drop_orphans(gmsh)
    return {name: [v for v, own in region.items() if own == name] for name in REGIONS}


def _adapt_faces(gmsh: Any, volumes: list[int]) -> None:
    """Mesh the faces of some volumes by MeshAdapt.

    Those of stem and mantle are a few millimetres wide and 150 mm long: the frontal method, which
    works in their parameters, leaves edges of 30 mm there and flat elements behind them.
    """
    solids = [(3, volume) for volume in volumes]
    for _, face in gmsh.model.getBoundary(solids, combined=False, oriented=False):
        gmsh.model.mesh.setAlgorithm(2, face, 1)


def _boundaries(
    points: Floats,
    exterior: tuple[Ints, Ints],
    tags: Any,
    regions: dict[str, int],
    geometry: Any,
) -> dict[str, Any]:
    """Masks over the exterior facets, by name."""
    corners = points[exterior[0][:, :3]]
    centre = corners.mean(axis=1)
    own = tags[exterior[1]]
    bone = np.isin(own, [regions["cortical_bone"], regions["cancellous_bone"]])
    normal, level = femur_bone.resection(geometry)
    near = 1e-4
    head = np.array([geometry.head_offset, 0.0, geometry.head_height])
    neck = np.array([math.sin(geometry.neck_angle), 0.0, -math.cos(geometry.neck_angle)])
    distal = bone & np.all(np.abs(corners[..., 2] - geometry.distal_cut_z) < near, axis=1)
    cut = bone & np.all(np.abs(corners @ normal - level) < near, axis=1)
    trunnion = (own == regions["stem"]) & np.all(np.abs((corners - head) @ neck) < near, axis=1)
    # What is left of the bone's exterior: its outer surface, and the walls above the shoulder.
    outer = femur_bone.outer(geometry.distal_cut_z)
    canal = femur_bone.canal(geometry.distal_cut_z, geometry.canal_widening)
    theta = np.arctan2(centre[:, 1], centre[:, 0])
    middle = 0.5 * (outer.radius(theta, centre[:, 2]) + canal.radius(theta, centre[:, 2]))
    outside = np.hypot(centre[:, 0], centre[:, 1]) > middle
    outside |= np.all(np.abs(corners[..., 2] - outer.top) < near, axis=1)
    surface = bone & ~distal & ~cut & outside
    masks = {"distal_cut": distal, "bone_surface": surface, "stem_trunnion": trunnion}
    masks["resection"] = cut
    for name, at in femur_bone.insertions(outer).items():
        masks[name] = surface & (np.linalg.norm(centre - at, axis=1) < PATCH_RADIUS)
    return masks
