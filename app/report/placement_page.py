"""Page on which a stem is placed in a bone by eye, for ``mantle place``.

One file without a server: the numbers of bone, canal and stems, three.js (`viewer.SCRIPTS`), and
`placement.js`, which moves the stem. The page interpolates the distances of `meshes.room` on the
same grid, so its numbers are those of ``mantle check --mesh``.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.case.case import Case
from app.case.hips import OperatedHip, Search
from app.case.shapes import GradedThickness
from app.case.stems import SUFFIXES, StemFile
from app.foundation.arrays import Floats, Ints
from app.foundation.errors import InputError, MantleError
from app.foundation.implant import Implant
from app.report import page, viewer
from app.report.packed_arrays import PackedArrays, as_text, points_in_range
from app.system.folders import write_text, writing
from meshes import best_position, femur_stem, room
from meshes.femur_bone import tube_triangles
from meshes.placement import LEAST_SHOULDER_DEPTH, Position, position

# Depths of the stem for which the page has the best position [mm].
DEPTHS = np.arange(-4.0, 14.5, 3.0)
# Triangles of the bone above which corners within a box are merged.
MOST_TRIANGLES = 40_000
# Edge of these boxes at the first attempt [mm].
BOX = 1.0
# Length of bone shown below the part with a known canal [mm].
BELOW = 25.0
# Distance of the drawn sections of the canal, in sections.
EVERY = 3
# First bytes of a page, and those among which it names its case.
DOCTYPE = b"<!doctype html"
PAGE_HEAD = 2000
# The name of its case on a page: a digest, since a page that is sent shows no folders.
CASE = '<meta name="case" content="{}">'
# Largest number of stems of a folder that the page offers.
SIZES = 12


@dataclass(frozen=True)
class Size:
    """A stem that can be placed.

    Attributes:
        name: Its name on the page.
        implant: The stem.
        yaml: Lines of its section `stem`; empty for the stem of the case.
    """

    name: str
    implant: Implant
    yaml: str


def write(case: Case, source: Path, path: Path) -> Path:
    """Write the page of a case to a file.

    Raises:
        InputError: The geometry has no stem to place, or no bone; three.js is missing; or the file
            cannot be written, is no page, or is the page of another case.
        GeometryError: The shaft's axis leaves the bone.
    """
    geometry = case.geometry
    if not isinstance(geometry, OperatedHip):
        fault = f"{source}: geometry.kind: {geometry.kind} has no stem to place"
        raise InputError(f"{fault}; expected femur or patient")
    bones = [name for name, tissue in geometry.tissues.items() if tissue == "bone"]
    if all(case.regions[name].tissue not in (None, "bone") for name in bones):
        raise InputError(
            f"{source}: {', '.join(bones)} are of another tissue, as a pot on a test bench is;"
            " expected a stem in bone"
        )
    scripts = [viewer.THREE / name for name in viewer.SCRIPTS]
    if not all(script.exists() for script in scripts):
        raise InputError("mantle place: three.js is missing; install the package libjs-three")
    case_line = CASE.format(hashlib.sha256(os.fsencode(source.resolve())).hexdigest()[:16])
    _refuse_other_file(path, case_line)
    module_folder = Path(__file__).parent
    head, numbers = packed_placement(geometry, case.title or source.stem, source)
    script_texts = [script.read_text("utf-8") for script in scripts]
    html = page.render(
        "placement.html",
        {
            "title": case.title or source.stem,
            "case": case_line,
            "head": json.dumps(head),
            "data": as_text(numbers),
            "licence": (module_folder / "three_licence.txt").read_text("utf-8"),
            "scripts": [*script_texts, (module_folder / "placement.js").read_text("utf-8")],
        },
    )
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, html)
    return path


def _refuse_other_file(path: Path, case_line: str) -> None:
    """Refuse to replace a file that no earlier call for the same case wrote.

    Raises:
        InputError: The file exists and is no page or one of another case, or it cannot be read.
    """
    try:
        if path.is_file():
            with path.open("rb") as file:
                page_head = file.read(PAGE_HEAD)
            if not page_head.lower().startswith(DOCTYPE):
                raise InputError(f"-o {path}: exists and is not a page; choose another name")
            if case_line.encode() not in page_head:
                raise InputError(
                    f"-o {path}: is the page of another case; choose another name with -o"
                )
    except OSError as error:
        raise InputError(f"-o {path}: cannot be replaced: {error.strerror}") from error


def packed_placement(
    geometry: OperatedHip, title: str, source: Path
) -> tuple[dict[str, object], bytes]:
    """The input of `placement.js`: numbers and texts, and the arrays.

    Raises:
        GeometryError: The shaft's axis leaves the bone.
    """
    numbers, femur, insertion = PackedArrays(), geometry.femur, geometry.insertion
    canal, start = room.widest_canal(geometry), position(geometry)
    placement = geometry.placement
    edge = femur_stem.shoulder_plane_height(geometry.implant, placement.slopes[0])
    start = replace(start, depth=float(placement.top) - edge)
    relative = insertion.version.relative_to if insertion else "neck"
    points, triangles = _thinned(*femur.drawn)
    is_shown = points[:, 2] > canal.points[..., 2].min() - BELOW
    triangles = triangles[is_shown[triangles].all(axis=1)]
    rings = canal.points[::EVERY, ::2]
    thickness = geometry.cement_thickness
    tables = thickness.tables if isinstance(thickness, GradedThickness) else None
    limits = best_position.Limits.of((insertion and insertion.best) or Search())
    head: dict[str, object] = {
        "title": title,
        "source": source.name,
        "side": "right" if femur.mirrored else "left",
        "collar": geometry.stem.collar is not None,
        "cut": {
            "normal": canal.cut.normal.tolist(),
            "level": canal.cut.level,
            "way": canal.cut.direction.tolist(),
        },
        "neck": femur.neck,
        "relative": relative,
        "condyles": femur.has_condyles,
        "head": femur.head.tolist(),
        "least": geometry.least_room,
        "stem": {
            "along": room.BODY_SECTIONS,
            "neck_along": room.NECK_SECTIONS,
            "deep": LEAST_SHOULDER_DEPTH,
            "out": femur_stem.SHOULDER_SLOPE,
            "shoulder": femur_stem.SHOULDER_RISE,
            "clear": femur_stem.NECK_CLEARANCE,
            "blend": femur_stem.BLEND_RANGE,
        },
        "thickness": {"uniform": None if tables else thickness, "tables": tables},
        "uncemented": best_position.UNCEMENTED,
        "reserve": best_position.COUNTED_RESERVE,
        "position": _shown(start),
        "grid": numbers.described(canal.distances.astype(np.int16))
        | {"low": canal.low.tolist(), "step": room.GRID_STEP.tolist(), "unit": room.DISTANCE_UNIT},
        "canal": {
            "points": _places(rings.reshape(-1, 3), numbers),
            "triangles": numbers.described(tube_triangles(*rings.shape[:2]).astype(np.uint32)),
        },
        "bone": {
            "points": _places(points, numbers),
            "triangles": numbers.described(triangles.astype(np.uint32)),
        },
        "stems": [
            _packed_stem(size, geometry, canal, start, limits, numbers)
            for size in sizes(geometry, source.parent)
        ],
    }
    return head, numbers.content()


def _places(x: Floats, numbers: PackedArrays) -> dict[str, object]:
    """Append points (n, 3) as fractions of their range [mm]."""
    fractions_of_range, range_ends = points_in_range(x)
    return numbers.described(fractions_of_range) | range_ends


def _shown(start: Position) -> dict[str, float]:
    """Numbers of a position in mm and degrees."""
    return {
        "depth": float(start.depth or 0.0),
        "varus": math.degrees(start.varus),
        "flexion": math.degrees(start.flexion),
        "version": math.degrees(start.version),
        "medial": start.medial,
        "anterior": start.anterior,
    }


def _packed_stem(
    size: Size,
    geometry: OperatedHip,
    canal: room.WidestCanal,
    start: Position,
    limits: best_position.Limits,
    numbers: PackedArrays,
) -> dict[str, object]:
    """Shape of a stem, and its best positions by depth."""
    implant, mirrored = size.implant, geometry.femur.mirrored
    stem = room.StemSurface.of(implant, canal.cut.put(implant, start, mirrored))
    bests = []
    thickness = best_position.wanted_thickness(geometry, geometry.placement)
    for depth in DEPTHS:
        start_position = replace(start, depth=float(depth))
        bests.append(
            _shown(best_position.roomiest_position(canal, stem, start_position, limits, thickness))
        )
    surface: dict[str, object] = {"points": None}
    if stem.points is not None:
        surface = {"points": numbers.described(stem.points.astype(np.float32))}
    return surface | {
        "name": size.name,
        "yaml": size.yaml,
        "start": stem.start.tolist(),
        "way": stem.direction.tolist(),
        "tip": implant.tip_z,
        "shoulder": implant.shoulder,
        "lateral": implant.shoulder - femur_stem.shoulder_plane_height(implant, 1.0),
        "head": [implant.head_offset, 0.0, implant.head_height],
        "neck": {
            "angle": implant.neck_angle,
            "radii": [_half(implant.neck_diameter), _half(implant.trunnion_diameter)],
            "fillet": implant.neck_fillet,
        },
        "best": bests,
    }


def _half(diameter: float | None) -> float:
    """Radius of a part of a neck [mm]; 0 for a stem from a file, which has no such key."""
    return 0.5 * diameter if diameter else 0.0


def sizes(geometry: OperatedHip, folder: Path) -> list[Size]:
    """The stem of a geometry, and others whose files are in the folder of its file.

    Paths are relative to the folder of the case.
    """
    stem = geometry.stem
    if not isinstance(stem, StemFile):
        return [Size(f"{geometry.implant.length:g} mm", geometry.implant, "")]
    files = sorted(p for p in stem.step.parent.iterdir() if p.suffix.lower() in SUFFIXES)
    other_files = [file for file in files if file != stem.step][: SIZES - 1]
    offered_sizes = [Size(stem.step.stem, geometry.implant, "")]
    for file in other_files:
        try:
            other_stem = StemFile(step=file, unit=stem.unit, collar=stem.collar)
        except (MantleError, ValueError):
            continue  # no stem, or of another kind
        implant = other_stem.implant(None, geometry.plug_length, geometry.implant.tip_void)
        relative_path = os.path.relpath(file, folder.resolve())
        offered_sizes.append(Size(file.stem, implant, _stem_section(other_stem, relative_path)))
    return sorted(offered_sizes, key=lambda size: size.implant.length)


def _stem_section(stem: StemFile, name: str) -> str:
    """The YAML of a stem with a file's name, in one line; unit and collar where they are given."""
    keys: dict[str, object] = {"step": name}
    if stem.unit != "mm":
        keys["unit"] = stem.unit
    if stem.collar is not None:
        angle = math.degrees(stem.collar.angle)
        keys["collar"] = {"thickness": f"{stem.collar.thickness:g} mm", "angle": f"{angle:g} deg"}
    return (
        "stem: {"
        + ", ".join(f"{key}: {json.dumps(given_value)}" for key, given_value in keys.items())
        + "}"
    )


def _thinned(points: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Simplify a surface with points (n, 3) [mm] and triangles (m, 3).

    Corners in the same box are merged. The boxes grow until at most `MOST_TRIANGLES` are left.
    """
    box = BOX
    while len(triangles) > MOST_TRIANGLES:
        cells = np.floor(points / box).astype(np.int64)
        _, first_rows, box_of_corner = np.unique(
            cells, axis=0, return_index=True, return_inverse=True
        )
        corners = box_of_corner.ravel()[triangles]
        a, b, c = corners.T
        points, triangles = points[first_rows], corners[(a != b) & (b != c) & (c != a)]
        box *= 1.5
    return points, triangles
