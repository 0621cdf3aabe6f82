"""A first case of a patient's hip by a segmentation, for ``mantle init NAME --labels FILE``.

Stems of the parametric kind are tried from large to small. The first one for which there is room
in the reamed canal is proposed, in the position with the most room. With ``--cementless`` they are
stems that fill the canal.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from app.case import new_case
from app.case.shapes import MeshOptions
from app.case.stems import Stem
from app.foundation.errors import InputError
from app.foundation.implant import Implant
from app.patient import ct_canal, segmentation
from app.patient.geometry import Patient
from app.patient.segmentation import Structure
from app.schema import yaml_file
from app.schema.section import faults
from meshes import room
from meshes.placement import lengthening

if TYPE_CHECKING:
    from app.patient.bone import PatientBone

CUT_HEIGHT = 8.0  # height of the neck cut above the lesser trochanter (mm)
CUT_ANGLES = (38.0, 45.0, 30.0)  # angles of the neck cut that are tried (deg)
OFFSET_RANGE = (32.0, 55.0)  # range of the stem's offset (mm)
# Least distance of a stem without cement from the widest canal that reaming may make (mm). That
# canal leaves 1.5 mm of cortex.
CEMENTLESS_ROOM = 3.0
CELL_SIZE = 6.0  # size of cells (mm)
BODY_WEIGHT = 600.0  # body weight of the loads in the library (N)
CT_THRESHOLD = 600.0  # CT number at the endosteum
LEG_LIMIT = 8.0  # largest proposed change of the leg length (mm): patients notice 10 mm
# Options of ``mantle init`` by the keys of a case for which they stand.
OPTIONS = {"geometry.bone.side": "--side", "geometry.canal.ct": "--ct", "canal.ct": "--ct"}
# Section of a case with the landmarks that a short scan lacks.
LANDMARKS = """\
  base: stance
  geometry:
    kind: patient
    bone: {image: FILE, label: NUMBER}
    landmarks:
      shaft: [[X, Y, Z], [X, Y, Z]] # two points of the axis, the distal one first
      lesser_trochanter: [X, Y, Z] # its apex, if the scan does not contain it
  loads: {library: one_leg_stance}"""
# A key of a case in a message.
CASE_KEY = r"\b(geometry|landmarks|bone|canal)\.[a-z]"


@dataclass(frozen=True)
class Fixation:
    """Stems that are tried, and what holds them in the bone.

    Attributes:
        stems: Length (mm), and width over `widths`, of stems that are tried, from large to small.
        widths: Widths of a stem (mm), by key.
        cement_thickness: Thickness of the cement (mm); 0: none.
        base: Shipped case with its interfaces, stages and materials.
        sections: Sections of the case that differ from those of the base.
    """

    stems: tuple[tuple[float, float], ...]
    widths: dict[str, float]
    cement_thickness: float
    base: str
    sections: dict[str, object]


CEMENTED = Fixation(
    stems=((147.0, 1.0), (130.0, 1.0), (130.0, 0.85), (115.0, 0.85), (100.0, 0.8), (90.0, 0.7)),
    widths={
        "half_width": 8.5,
        "half_depth": 5.0,
        "corner_radius": 3.0,
        "tip_half_width": 3.0,
        "tip_half_depth": 3.0,
        "tip_corner_radius": 2.1,
        "neck_diameter": 13.0,
        "trunnion_diameter": 12.0,
    },
    cement_thickness=3.0,
    base="stance",
    sections={"loads": {"library": "one_leg_stance"}},
)
# The widest stem with `CEMENTLESS_ROOM` fills the canal.
CEMENTLESS = Fixation(
    stems=(
        (147.0, 1.2),
        (147.0, 1.1),
        (147.0, 1.0),
        (147.0, 0.9),
        (130.0, 0.9),
        (130.0, 0.8),
        (115.0, 0.8),
        (100.0, 0.7),
    ),
    widths={
        "half_width": 12.0,
        "half_depth": 8.0,
        "corner_radius": 4.0,
        "tip_half_width": 5.0,
        "tip_half_depth": 5.0,
        "tip_corner_radius": 4.0,
    },
    cement_thickness=0.0,
    base="pressed",
    sections={
        "interfaces": {"stem_bone": {"interference": "0.01 mm"}},
        "loads": {"library": "one_leg_stance", "history": [0, 1]},
    },
)


@dataclass(frozen=True)
class Proposal:
    """Geometry of a first case.

    Attributes:
        keys: Its keys, as in a case file.
        geometry: The geometry that they make.
        lowered: Distance by which the stem's head is lower than usual (mm).
    """

    keys: dict[str, object]
    geometry: Patient
    lowered: int = 0


def write(
    path: Path,
    labels: Path,
    ct: Path | None,
    side: str | None,
    label: str | None,
    cementless: bool = False,
) -> tuple[Path, list[str]]:
    """Write a case of the femur in a segmentation that runs as it is.

    Args:
        path: The new file.
        labels: File of the segmentation, or folder of its files.
        ct: CT of the same bone, by which the canal is known.
        side: Side of the femur; None: by its name, or its landmarks.
        label: Name or number of the femur's label.
        cementless: True for a stem without cement.

    Returns:
        The file, and lines on what was assumed.

    Raises:
        InputError: There is not one femur, its scan is too short, or no stem fits; or the file
            exists, or its folder does not.
    """
    path = new_case.new_file(path)
    bone = segmentation.femur_structure(labels, side, label)
    fixation = CEMENTLESS if cementless else CEMENTED
    proposal = _propose(
        path.parent, fixation, bone, segmentation.canal_structure(labels, bone), ct, side
    )
    keys: dict[str, object] = {
        "base": fixation.base,
        "title": f"Hip of {labels.name}",
        "geometry": {"kind": "patient", **proposal.keys},
        "mesh": {"size": f"{CELL_SIZE:g} mm"},
        **fixation.sections,
    }
    new_case.save_case_text(
        path,
        "# The hip of a segmentation, standing on one leg. `mantle explain KEY` explains a key.\n"
        "# `mantle place` shows and changes the position of the stem.\n\n"
        + yaml_file.to_yaml(keys, short=True),
    )
    return path, list(_assumptions(bone, ct, fixation, proposal))


def _propose(
    folder: Path,
    fixation: Fixation,
    bone: Structure,
    canal: Structure | None,
    ct: Path | None,
    side: str | None,
) -> Proposal:
    """Return the largest stem that fits, with the keys of its geometry.

    Raises:
        InputError: The bone is refused, or no stem fits.
    """
    bone_keys: dict[str, object] = {"image": _relative(bone.path, folder), "label": bone.number}
    if bone.side or side:
        bone_keys["side"] = bone.side or side
    canal_keys: dict[str, object] = {"ream": "broach"}
    if canal:
        image = {"image": _relative(canal.path, folder), "label": canal.number}
        canal_keys = image | canal_keys
    try:
        femur = _geometry_of({"bone": bone_keys, "canal": canal_keys}, folder).femur
    except InputError as error:
        message = _with_options(str(error))
        raise InputError(message if str(bone.path) in message else f"{bone}: {message}") from error
    if ct and not canal and ct_canal.contains_canal(femur.frame):
        canal_keys = {"ct": _relative(ct, folder), "threshold": CT_THRESHOLD} | canal_keys
        # A CT without this femur is refused here, not as a reason against each stem.
        try:
            _geometry_of({"bone": bone_keys, "canal": canal_keys}, folder)
        except InputError as error:
            raise InputError(_with_options(str(error))) from error
    reasons = list[str]()
    for angle in CUT_ANGLES:
        resection = {"height": f"{CUT_HEIGHT:g} mm", "angle": f"{angle:g} deg"}
        for length, width in fixation.stems:
            keys: dict[str, object] = {
                "bone": bone_keys,
                "canal": canal_keys,
                "stem": _stem(fixation, length, width, femur),
                "resection": resection,
                "insertion": "best",
                "cement_thickness": f"{fixation.cement_thickness:g} mm",
            }
            try:
                geometry = _geometry_of(keys, folder)
                geometry.check_fit(MeshOptions.model_validate({"size": f"{CELL_SIZE:g} mm"}))
                if not geometry.is_cemented:
                    _check_room(geometry)
            except InputError as error:
                reasons.append(f"{length:g} mm: {error}")
            else:
                return _with_limited_leg(Proposal(keys, geometry), folder)
    lengths = [length for length, _ in fixation.stems]
    raise InputError(
        f"{bone.path}: no stem of {lengths[-1]:g} to {lengths[0]:g} mm fits into this femur."
        f" Reason for the smallest, {reasons[len(lengths) - 1]}. Write a case with your own stem:"
        " see docs/howto/patient.md"
    )


def _with_limited_leg(proposal: Proposal, folder: Path) -> Proposal:
    """Return a proposal whose head is so low that the leg becomes at most `LEG_LIMIT` longer."""
    excess = math.ceil(lengthening(proposal.geometry) - LEG_LIMIT)
    if excess <= 0:
        return proposal
    stem = proposal.keys["stem"]
    assert isinstance(stem, dict)
    assert isinstance(proposal.geometry.stem, Stem)
    height = proposal.geometry.stem.head_height - excess
    keys = proposal.keys | {"stem": stem | {"head_height": f"{height:g} mm"}}
    return Proposal(keys, _geometry_of(keys, folder), lowered=excess)


def _with_options(message: str) -> str:
    """Return a message on a bone in which a remedy is an option of ``mantle init``, if it has one.

    For other keys of a case it says how to give them.
    """
    for key, option in OPTIONS.items():
        message = message.replace(key, option)
    if not re.search(CASE_KEY, message):
        return message
    advice = "`mantle init` takes no such keys: write a case with them (docs/howto/patient.md)"
    if "landmarks.shaft" in message:
        advice += f", in mm in the axes of the image:\n{LANDMARKS}"
    return f"{message.rstrip('.')}. {advice}"


def _check_room(geometry: Patient) -> None:
    """Raise InputError, with the place, if a stem without cement has too little room."""
    fit = room.fit_of(geometry)
    if fit.least < CEMENTLESS_ROOM:
        room_text = fit.words(geometry.placement)
        raise InputError(f"room {room_text}; expected at least {CEMENTLESS_ROOM:g} mm")


def _geometry_of(keys: dict[str, object], folder: Path) -> Patient:
    """Return the geometry of keys.

    Raises:
        InputError: It is refused.
    """
    keys_with_kind = {"kind": "patient"} | keys
    try:
        return Patient.model_validate(keys_with_kind, context={"folder": folder})
    except ValidationError as error:
        messages = [fault.text for fault in faults(error, Patient, keys_with_kind)]
        raise InputError("; ".join(messages)) from error


def _stem(fixation: Fixation, length: float, width: float, femur: PatientBone) -> dict[str, object]:
    """Return keys of a stem with the offset of the patient's head, as far as its neck allows."""
    offset = min(max(round(float(femur.head[0])), OFFSET_RANGE[0]), OFFSET_RANGE[1])
    stem: dict[str, object] = {"length": f"{length:g} mm", "head_offset": f"{offset:g} mm"}
    # Widths of a parametric stem without keys need none.
    for key, size in fixation.widths.items():
        width_of_key = round(width * size, 2)
        if width_of_key != Stem.model_fields[key].default:
            stem[key] = f"{width_of_key:g} mm"
    return stem


def _assumptions(
    bone: Structure, ct: Path | None, fixation: Fixation, proposal: Proposal
) -> Iterator[str]:
    """Lines on what was assumed."""
    geometry = proposal.geometry
    femur, implant, details = geometry.femur, geometry.implant, geometry.details
    frame = femur.frame
    source = f", {bone.source}" if bone.source else ""
    axes = f"but {femur.side_doubt}" if femur.side_doubt else "and the axes of the image agree"
    side_source = "" if geometry.bone.side else ", by the lesser trochanter"
    yield f"femur: {bone}{source}; {frame.side}{side_source}, {axes}"
    end_level = geometry.continued_below
    scan = "the scan contains the shaft that is needed"
    if end_level is not None and femur.continuation:
        scan_end = femur.continuation.scan_end
        scan = (
            f"the scan ends {-scan_end:.0f} mm below the lesser trochanter, and the shaft is"
            f" continued from {-end_level:.0f} mm below it on, for"
            f" {end_level - geometry.level:.0f} mm (bone.extend)"
        )
    neck = f"neck-shaft angle {details['neck-shaft angle']}"
    yield f"bone: head of radius {frame.radius:.1f} mm, {neck}; {scan}"
    yield f"canal: {_canal(geometry, ct)}"
    angle = math.degrees(geometry.resection.angle)
    cut = f"neck cut {CUT_HEIGHT:g} mm above the lesser trochanter at {angle:g} deg"
    best_position = geometry.placement_details["best position"]
    cement = ", without cement"
    if fixation.cement_thickness:
        cement = f" with {fixation.cement_thickness:g} mm of cement"
    stem = f"{_size(implant)}{cement}"
    head = geometry.placement_details["head of the stem"]
    if proposal.lowered:
        head += (
            f"; the neck is {proposal.lowered} mm shorter (stem.head_height), since the leg would"
            f" become more than {LEG_LIMIT:g} mm longer"
        )
    yield f"operation: {cut}; {stem}; best position: {best_position}; head: {head}"
    medial = "the condyles" if femur.has_condyles else "the neck, since the scan has no condyles"
    weight = f"body weight {BODY_WEIGHT:g} N (loads.body_weight)"
    yield f"loads: one leg, {weight}; x is along {medial}; materials of `{fixation.base}`"
    for doubt in femur.notes:
        yield f"note: {doubt}"


def _canal(geometry: Patient, ct: Path | None) -> str:
    """The source of the canal, in words."""
    canal = geometry.femur.canal
    if geometry.canal.ct and canal:
        return f"{canal.notes[0]}; above, the cortex thins to 2 mm"
    if geometry.canal.image:
        return f"label {geometry.canal.label} of {geometry.canal.image.name}"
    reason = "since no label contains it; --ct FILE takes it from a CT"
    if ct:
        reason = "since the scan contains too little of the shaft"
    width = f"{geometry.femur.assumed_isthmus:.1f} mm wide at its isthmus (canal.isthmus)"
    return f"with the ratios of the parametric femur, {reason}; {width}"


def _size(implant: Implant) -> str:
    """Length and width of a stem, in words."""
    return f"a stem of {implant.length:g} mm, {2 * implant.half_width:g} mm wide"


def _relative(path: Path, folder: Path) -> str:
    """A path as a case file in a folder names it."""
    return os.path.relpath(path.resolve(), folder.resolve())
