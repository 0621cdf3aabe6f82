"""The femur in a segmentation: a file of labels, or a folder with a file for each structure.

Names are those of the file (NRRD, or the table that TotalSegmentator adds to NIfTI), else the name
of a file with one structure. Without names, a file with the numbers of TotalSegmentator has its
structures. Source of the numbers: totalsegmentator/map_to_binary.py, versions 1 and 2.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from app.foundation.errors import InputError
from app.foundation.layout import shortened_list
from app.patient import label_image

# Numbers of the femora in multi-label files of TotalSegmentator, and those of the hip bones, by
# which a version is recognized.
TOTAL_SEGMENTATOR = {
    "version 2": {"femur_left": 75, "femur_right": 76, "hip_left": 77, "hip_right": 78},
    "version 1": {"femur_left": 88, "femur_right": 89, "hip_left": 90, "hip_right": 91},
}
# Largest number of version 1; a torso of version 2 has larger ones, such as those of ribs.
LARGEST_OF_VERSION_1 = 104
BY_NUMBER = "by its number in TotalSegmentator"
# A file with more labels, or larger ones, is taken for one of TotalSegmentator.
MANY_LABELS = 20
# Structures that a message lists.
LISTED = 8
ENDINGS = (".nii.gz", ".nii", ".seg.nrrd", ".nrrd", ".nhdr", ".npz", ".dcm")
SIDES_OF_BODY = ("left", "right")
FEMUR = re.compile(r"femur|femoral|thigh ?bone|oberschenkelknochen", re.IGNORECASE)
NO_FEMUR = re.compile(r"artery|vein|nerve|muscle|cartilage|canal|marrow|medull", re.IGNORECASE)
CANAL = re.compile(r"canal|marrow|medull|cavity|intramedull", re.IGNORECASE)


@dataclass(frozen=True)
class Structure:
    """A structure of a segmentation.

    Attributes:
        path: Its file.
        number: Label of its voxels.
        name: Its name; empty if none is known.
        source: Origin of the name, in words.
    """

    path: Path
    number: int
    name: str
    source: str

    @property
    def side(self) -> str | None:
        """Side by the name; None: the name has no side."""
        separated = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", self.name)  # LeftFemur
        words = re.split(r"[^a-z]+", separated.lower())
        sides = {
            side for side in SIDES_OF_BODY if side in words or (side[0] in words and len(words) > 1)
        }
        return sides.pop() if len(sides) == 1 else None

    @property
    def label(self) -> str:
        """Name and label, where the file is known."""
        label = f"label {self.number}"
        return f"{self.name} ({label})" if self.name else label

    def __str__(self) -> str:
        """Name, label and file."""
        label = f"label {self.number} of {self.path.name}"
        return f"{self.name} ({label})" if self.name else label


def segments(path: Path) -> list[Structure]:
    """Return the structures of a file, or of the files of a folder whose names are of a femur.

    Raises:
        InputError: There is no file, or it cannot be read.
    """
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.name.endswith(ENDINGS))
        named = [file for file in files if FEMUR.search(file.name)]
        if not files:
            raise InputError(
                f"{path}: contains no segmentation; expected files that end in"
                f" {', '.join(ENDINGS)}, such as femur_left.nii.gz"
            )
        if not named:
            names = ", ".join(file.name for file in files[:6])
            raise InputError(
                f"{path}: has no file of a femur, such as femur_left.nii.gz; it has {names}"
            )
        return [segment for file in named for segment in segments(file)]
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    image = label_image.read(path)
    numbers = image.numbers
    labels = _names(path) if image.names is None else image.names
    if labels:
        present_labels = {name: n for name, n in labels.items() if n in numbers}
        return [Structure(path, n, name, "by its name") for name, n in present_labels.items()]
    stem = path.name[: -len(next((ending for ending in ENDINGS if path.name.endswith(ending)), ""))]
    if len(numbers) == 1:
        structure = Structure(path, numbers[0], stem, "by the name of the file")
        is_named = FEMUR.search(stem) or CANAL.search(stem) or structure.side
        return [structure if is_named else Structure(path, numbers[0], "", "")]
    if len(numbers) > MANY_LABELS or (numbers and max(numbers) > MANY_LABELS):
        return _of_total_segmentator(path, numbers)
    return [Structure(path, n, "", "") for n in numbers]


def _of_total_segmentator(path: Path, numbers: Sequence[int]) -> list[Structure]:
    """Return the structures of a file with the numbers of TotalSegmentator.

    The version is that with more of its bones of the hip. A torso has all their numbers in both
    versions: then larger numbers are of version 2.
    """
    bones = {name: len({*n.values()} & {*numbers}) for name, n in TOTAL_SEGMENTATOR.items()}
    likely = "version 2" if bones["version 2"] > bones["version 1"] else "version 1"
    if max(numbers) > LARGEST_OF_VERSION_1:
        likely = "version 2"
    source = f"{BY_NUMBER}, {likely}"
    names = {n: name for name, n in TOTAL_SEGMENTATOR[likely].items()}
    return [Structure(path, n, names.get(n, ""), source if n in names else "") for n in numbers]


def _names(path: Path) -> dict[str, int]:
    """Return the labels of NIfTI by the names of its table; none without names."""
    if not path.name.endswith((".nii", ".nii.gz")):
        return {}
    import nibabel

    names = dict[str, int]()
    for extension in nibabel.load(path).header.extensions:
        content = extension.get_content()
        extension_text = (
            content.decode("utf-8", "replace") if isinstance(content, bytes) else str(content)
        )
        if "LabelTable" in extension_text:
            table = ET.fromstring(extension_text.strip("\0 \n")).iter("Label")
            names |= {(row.text or "").strip(): int(row.get("Key", "0")) for row in table}
    return names


def femur_structure(path: Path, side: str | None, label: str | None) -> Structure:
    """Return the structure of a segmentation that is the femur.

    Args:
        path: File or folder.
        side: Side of the femur that is asked for.
        label: Name or number of the femur's label, where no name identifies it.

    Raises:
        InputError: There is no femur, or more than one.
    """
    structures = segments(path)
    if label is not None:
        matching = [s for s in structures if label in (s.name, str(s.number))]
        if not matching:
            raise InputError(
                f"--label {label}: {path} has no such label; it has {_list(structures)}"
            )
        by_number = [s for s in structures if s.source.startswith(BY_NUMBER)]
        if by_number == matching[:1] and label == str(matching[0].number):
            # One number of TotalSegmentator alone may be by chance.
            return Structure(matching[0].path, matching[0].number, "", "")
        return _of_side(matching[0], side)
    femora = [s for s in structures if FEMUR.search(s.name) and not NO_FEMUR.search(s.name)]
    if not femora and len(structures) == 1:
        femora = structures
    if not femora:
        raise InputError(
            f"{path}: no label is named femur; its labels are {_list(structures)}."
            " Give --label with the"
            " name or number of the femur"
        )
    if len(femora) > 1 and side:
        femora = [s for s in femora if s.side == side] or femora
    if len(femora) > 1:
        sides = {s.side for s in femora}
        remedy = (
            "--side left or --side right" if sides == {*SIDES_OF_BODY} else "--label NAME or NUMBER"
        )
        raise InputError(
            f"{path}: has {len(femora)} femora: {_list(femora)}; choose one with {remedy}"
        )
    return _of_side(femora[0], side)


def _of_side(femur: Structure, side: str | None) -> Structure:
    """Return a femur; raise InputError if its name has the other side than the one asked for."""
    if side and femur.side not in (None, side):
        raise InputError(f"--side {side}: the femur is {femur}")
    return femur


def canal_structure(path: Path, bone: Structure) -> Structure | None:
    """Return the structure that is the medullary canal of a femur; None: there is none."""
    if path.is_dir():
        path = bone.path
    canals = [s for s in segments(path) if CANAL.search(s.name) and s.number != bone.number]
    canals = [s for s in canals if s.side in (None, bone.side)]
    return canals[0] if len(canals) == 1 else None


def _list(structures: Sequence[Structure]) -> str:
    """Return structures in words, the first ones of many; their files, if there are several."""
    several_files = len({s.path for s in structures}) > 1
    texts = [str(s) if several_files else s.label for s in structures]
    return shortened_list(texts, LISTED) or "no label"
