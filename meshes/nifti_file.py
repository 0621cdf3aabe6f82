"""Images in NIfTI files: numbers and places of voxels, and checks for a consistent header."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import InputError

SIZE_OFF = 0.01  # largest relative difference of the edges of voxels by sform and by pixdim
APART = 0.5  # voxels: largest distance of places by sform from those by qform
# Spaces in which sform and qform place voxels, by their codes.
SPACES = {1: "scanner", 2: "aligned", 3: "Talairach", 4: "MNI"}
TEMPLATES = (3, 4)  # spaces to which images of patients are scaled


def read(path: Path) -> tuple[Any, Floats, list[str], list[str]]:
    """Return numbers, their affine to mm, notes on what was read of the header, and doubts.

    Raises:
        InputError: The header has no axes, other units than mm, or axes that contradict each other.
        Exception: It is damaged; nibabel raises errors of any kind.
    """
    import nibabel

    image = nibabel.load(path)
    if not isinstance(image, nibabel.Nifti1Pair):
        kind = type(image).__name__.removesuffix("Image")
        raise InputError(f"{path}: is no NIfTI but {kind}: convert it, as `mri_convert` does")
    header = image.header
    sform, qform = int(header["sform_code"]), int(header["qform_code"])
    if not (sform or qform):
        raise InputError(f"{path}: its header has neither qform nor sform: no spacing, no axes")
    unit = header.get_xyzt_units()[0]
    if unit not in ("mm", "unknown"):
        raise InputError(f"{path}: its unit is {unit}; expected mm: it is in {unit}")
    doubts = []
    if sform:
        by_sform = header.get_sform()
        edges = np.linalg.norm(by_sform[:3, :3], axis=0)
        sizes = np.abs(np.asarray(header["pixdim"][1:4], float))
        if not np.allclose(edges, sizes, rtol=SIZE_OFF):
            raise InputError(
                f"{path}: by its sform voxels have {_by(edges)} mm, by its pixdim {_by(sizes)} mm:"
                " which is right? Correct the header, or write the image anew"
            )
        if qform:
            doubts += _against_qform(path, image.shape, by_sform, header.get_qform())
    if sform in TEMPLATES and not qform:
        space = SPACES.get(sform, f"code {sform}")
        doubts.append(
            f"{path.name}: its sform is in {space} space: is it still the patient's size?"
        )
    name, code = ("sform", sform) if sform else ("qform", qform)
    return (
        np.asanyarray(image.dataobj),
        image.affine,
        [f"NIfTI, axes by its {name} ({SPACES.get(code, f'code {code}')})"],
        doubts,
    )


def _against_qform(path: Path, shape: tuple[int, ...], sform: Floats, qform: Floats) -> list[str]:
    """Return a doubt if qform places voxels elsewhere than sform.

    Raises:
        InputError: One is the mirror image of the other.
    """
    if np.linalg.det(sform[:3, :3]) * np.linalg.det(qform[:3, :3]) < 0:
        raise InputError(
            f"{path}: its sform is the mirror image of its qform: which is right? Left and right"
            " depend on it. Correct the header, or write the image anew"
        )
    corners = np.array([*np.ndindex(2, 2, 2)]) * (np.array(shape[:3]) - 1)
    apart = (sform - qform)[:3, :3] @ corners.T + (sform - qform)[:3, 3:]
    far = float(np.linalg.norm(apart, axis=0).max())
    if far <= APART * float(np.linalg.norm(sform[:3, :3], axis=0).min()):
        return []
    return [f"{path.name}: its sform and qform differ by up to {far:.3g} mm; sform is taken"]


def _by(edges: Floats) -> str:
    """Return lengths as text: ``1 x 1 x 2.5``."""
    return " x ".join(f"{edge:.4g}" for edge in edges)
