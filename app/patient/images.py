"""Images of bones: numbers on a lattice of voxels, read from files and interpolated.

nibabel reads NIfTI files, pydicom DICOM (`dicom_series`). This module checks that the header gives
one consistent transform from voxels to the patient. Libraries use the sform without a warning where
it contradicts the qform or the sizes of voxels.
"""

from __future__ import annotations

import gzip
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from app.foundation.arrays import Bools, Floats
from app.foundation.errors import InputError
from app.foundation.files import files_at
from app.foundation.layout import product_text
from app.patient import dicom_segmentation, dicom_series, nrrd
from app.patient.foreign_formats import WRAPPED, ForeignFormats, foreign_format, vtk_formats
from app.patient.voxels import LabelSegment, Voxels

HALF_VOXEL = 0.5 + 1e-6  # edges from the middle of a voxel to its end
MOST_TILT = 0.01  # largest cosine of the angle between edges of voxels
# Of NIfTI files
SIZE_TOLERANCE = 0.01  # largest relative difference of the edges of voxels by sform and by pixdim
PLACE_TOLERANCE = 0.5  # voxels: largest distance of places by sform from those by qform
# Spaces in which sform and qform place voxels, by their codes.
SPACES = {1: "scanner", 2: "aligned", 3: "Talairach", 4: "MNI"}
TEMPLATES = (3, 4)  # spaces to which images of patients are scaled
PADDING = -1500.0  # CT number: lower ones are written where nothing was measured
GZIP = b"\x1f\x8b"
HEADER_SIZE = 348  # bytes of the header of NIfTI
IMAGE_FORMATS = "NIfTI, NRRD, DICOM or .npz"
NIFTI2_SIZE = 540  # first number of NIfTI of version 2
SAVE = "save it as NIfTI or NRRD, as 3D Slicer does"
EXPORT = "export the scan as NIfTI, NRRD or DICOM"
GIVE = "give it as `surface`"
# Files of other formats, with their remedies.
OTHER_FORMATS: ForeignFormats = {
    **WRAPPED,
    **vtk_formats(SAVE),
    b"ObjectType": ("is a MetaImage (.mha, .mhd)", SAVE),
    b"II*\0": ("is a TIFF picture without voxel positions", EXPORT),
    b"MM\0*": ("is a TIFF picture without voxel positions", EXPORT),
    b"\x89PNG": ("is a PNG picture without voxel positions", EXPORT),
    b"solid": ("is an STL surface", GIVE),
    b"ply": ("is a PLY surface", GIVE),
}


class OutsideImageError(InputError):
    """A point is outside the image."""


@dataclass(frozen=True)
class Image:
    """An image: numbers of voxels, and their places.

    Attributes:
        values: Numbers (i, j, k); those of layers (i, j, k, n).
        affine: Matrix from (i, j, k, 1) to the middle of a voxel (4, 4) [mm].
        summary: Format, lattice and type of what was read, then what was left out, in words.
        notes: Doubts about it.
        segments: Segments by their names, if the file has names.
    """

    values: Any
    affine: Floats
    summary: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    segments: Mapping[str, LabelSegment] | None = None

    @cached_property
    def sha256(self) -> str:
        """Hash of numbers and places."""
        digest = hashlib.sha256(np.round(self.affine, 6).tobytes())
        digest.update(np.ascontiguousarray(self.values))
        return digest.hexdigest()

    def angle_to(self, other: Image) -> float:
        """Largest angle between an axis of the voxels and the nearest of another image [rad]."""
        axes, other_axes = (
            m / np.linalg.norm(m, axis=0) for m in (self.affine[:3, :3], other.affine[:3, :3])
        )
        cosines = np.abs(axes.T @ other_axes).max(axis=1)
        return float(np.arccos(min(cosines.min(), 1.0)))

    @cached_property
    def _finite_values(self) -> Any:
        """Values of all voxels that are numbers (n,)."""
        return self.values[np.isfinite(self.values)]

    @cached_property
    def percentile_99_9(self) -> float:
        """Number that is exceeded in one voxel of a thousand."""
        return float(np.percentile(self._finite_values, 99.9))

    @cached_property
    def min_measured(self) -> float:
        """Lowest number of a voxel that was measured."""
        measured_numbers = self._finite_values[self._finite_values > PADDING]
        return float((measured_numbers if measured_numbers.size else self._finite_values).min())

    @property
    def nan_count(self) -> int:
        """Number of voxels that are no numbers."""
        return int(self.values.size - self._finite_values.size)

    def values_at(self, x: Floats) -> Floats:
        """Return values (n,) at points (n, 3) [mm], linear between the centres of voxels.

        Raises:
            OutsideImageError: A point is outside the image.
            InputError: A point is in a voxel that is not a number.
        """
        index = (x - self.affine[:3, 3]) @ np.linalg.inv(self.affine[:3, :3]).T
        # The outermost voxels extend by half an edge beyond their centres.
        nearest = np.clip(index, 0.0, np.array(self.values.shape) - 1.0)
        index = np.where(np.abs(index - nearest) <= HALF_VOXEL, nearest, index)
        values = ndimage.map_coordinates(self.values, index.T, float, order=1, cval=np.nan)
        is_lost = ~np.isfinite(values)
        if is_lost.any():
            last_voxel = np.array(self.values.shape) - 1
            outside = is_lost & ((index < 0) | (index > last_voxel)).any(axis=1)
            if outside.any():
                raise OutsideImageError(_count(x, outside, "outside the image"))
            fault = _count(x, is_lost, "in voxels that are not numbers")
            raise InputError(f"{fault}; fill these voxels")
        return np.asarray(values)


def _count(x: Floats, mask: Bools, place: str) -> str:
    """Return a text on the number of masked points (n, 3) [mm] and the first one of them."""
    first_place = "({:.0f}, {:.0f}, {:.0f}) mm".format(*x[mask][0])
    return f"{int(mask.sum()):,} of {len(x):,} points are {place}, such as {first_place}"


def read(path: Path) -> Image:
    """Read NIfTI, NRRD, DICOM (folder, or file of frames), or ``values``, ``affine`` of `.npz`.

    Raises:
        InputError: It cannot be read, or has several numbers in each voxel.
    """
    image = read_layers(path)
    if image.values.ndim > 3:
        count = image.values.shape[3]
        content = "layers, since its segments overlap" if image.segments else "numbers per voxel"
        raise InputError(f"{path}: has {count} {content}; expected one number per voxel")
    return image


def read_layers(path: Path) -> Image:
    """Read an image as `read`; segments that overlap are in several layers."""
    return _read(path, modification_time(path))


def files_of(path: Path) -> list[Path]:
    """Return all files of an image: those of a folder, and numbers and header in two files."""
    if path.is_dir():
        return files_at(path)
    partner = {".hdr": ".img", ".img": ".hdr"}.get(path.suffix)
    candidates = [path, path.with_suffix(partner)] if partner else [path]
    with path.open("rb") as file:
        is_nrrd = file.read(len(nrrd.MAGIC)) == nrrd.MAGIC
    return [file for file in candidates if file.is_file()] + (
        nrrd.data_files(path) if is_nrrd else []
    )


def modification_time(path: Path) -> int:
    """Return the time of the last change of the files of an image [ns]."""
    return max(file.stat().st_mtime_ns for file in (path, *files_of(path)))


@lru_cache(maxsize=2)
def _read(path: Path, _modification_time: int) -> Image:
    try:
        voxels = _reader(path)(path)
        values = np.asarray(voxels.values)
        affine = np.asarray(voxels.affine, dtype=float).reshape(4, 4)
    except InputError:
        raise
    except ModuleNotFoundError as error:
        raise missing(path, error) from None
    except Exception as error:  # damaged files let readers fail in any way
        raise InputError(f"{path}: cannot be read as an image: {error}") from error
    if values.dtype == bool:
        values = values.astype(np.uint8)
    # Axes of one entry after the three of space have no content.
    if values.ndim > 3 and int(np.prod(values.shape[3:])) == 1:
        values = values.reshape(values.shape[:3])
    layered = values.ndim == 4 and voxels.segments is not None
    _check_values(path, values, layered)
    edge_lengths = _check_affine(path, affine)
    lattice, spacing = (product_text(row, digits=4) for row in (values.shape[:3], edge_lengths))
    layers = f" in {values.shape[3]} layers" if layered else ""
    description = f"{voxels.kind}: {lattice} voxels of {spacing} mm{layers}, {values.dtype}"
    summary = (description, *voxels.left_out)
    image = Image(values, affine, summary, voxels.doubts, voxels.segments)
    if image.nan_count:
        lost_text = f"{image.nan_count:,} voxels are not numbers"
        return replace(image, summary=(*image.summary, lost_text))
    return image


def _check_values(path: Path, values: Any, layered: bool) -> None:
    """Check the array of an image.

    Raises:
        InputError: It is not a volume of numbers, one for each voxel, or has no finite one.
    """
    if values.ndim == 4 and not layered:
        fault = f"has {values.shape[3]} numbers per voxel, such as colours or times"
        raise InputError(f"{path}: {fault}; expected one")
    if not (values.ndim == 3 or layered) or values.dtype.kind not in "iuf" or not values.size:
        fault = f"is an array of type {values.dtype} in {values.ndim} dimensions"
        raise InputError(f"{path}: {fault}; expected numbers in 3 dimensions")
    if min(values.shape[:3]) < 2:
        voxel_counts = " x ".join(str(n) for n in values.shape[:3])
        raise InputError(f"{path}: is a single slice of {voxel_counts} voxels; expected a volume")
    if not np.isfinite(values).any():
        raise InputError(f"{path}: none of its voxels is a number")


def _check_affine(path: Path, affine: Floats) -> Floats:
    """Check the affine of an image (4, 4), and return the edge lengths of its voxels (3,) [mm].

    Raises:
        InputError: It is not finite, has no spacing, or its axes are not perpendicular.
    """
    if not np.isfinite(affine).all():
        raise InputError(f"{path}: its affine contains values that are not numbers")
    edge_lengths = np.linalg.norm(affine[:3, :3], axis=0)
    if not (np.isfinite(edge_lengths).all() and edge_lengths.all()):
        raise InputError(
            f"{path}: the spacing of its voxels is {product_text(edge_lengths, digits=4)}"
            " mm; expected above 0"
        )
    directions = affine[:3, :3] / edge_lengths
    if np.abs(directions.T @ directions - np.eye(3)).max() > MOST_TILT:
        raise InputError(
            f"{path}: its axes are not perpendicular; was the gantry tilted? Resample it"
        )
    return np.asarray(edge_lengths)


def _reader(path: Path) -> Callable[[Path], Voxels]:
    """Return the reader for a path, by its kind.

    Raises:
        InputError: The file is of another kind.
    """
    if path.is_dir():
        return _dicom
    if path.suffix == ".npz":
        return _npz
    with path.open("rb") as file:
        first_bytes = file.read(200)
    if first_bytes.startswith(nrrd.MAGIC):
        return nrrd.read
    if dicom_series.is_dicom(first_bytes):
        return _dicom
    foreign = foreign_format(first_bytes, OTHER_FORMATS, IMAGE_FORMATS)
    if foreign:
        raise InputError(f"{path}: {foreign}")
    if _is_text(path):
        raise InputError(f"{path}: is a text file, not an image; expected {IMAGE_FORMATS}")
    return _nifti


def _is_text(path: Path) -> bool:
    """Return True for a text, also a compressed one: the header of an image contains zeros."""
    with path.open("rb") as file:
        compressed = file.read(len(GZIP)) == GZIP
    try:
        with gzip.open(path) if compressed else path.open("rb") as file:
            content = file.read(HEADER_SIZE)
    except (OSError, EOFError):
        return False  # damaged, which the reader of images reports
    return bool(content) and b"\0" not in content and content.isascii()


def _dicom(path: Path) -> Voxels:
    """Read the slices of a series, or a segmentation if there is nothing else."""
    headers, left_out = dicom_series.headers_of(path)
    with_image = [header for header in headers if "Rows" in header]
    segmentations = [header for header in with_image if dicom_segmentation.is_segmentation(header)]
    if not segmentations or len(segmentations) < len(with_image):
        return dicom_series.read(path, headers, left_out)
    if len(segmentations) > 1:
        names = ", ".join(dicom_series.name_of_slice(header) for header in segmentations[:3])
        raise InputError(f"{path}: has {len(segmentations)} segmentations: {names}; give one file")
    return dicom_segmentation.read(path, segmentations[0], left_out)


def missing(path: Path, error: ModuleNotFoundError) -> InputError:
    """Return the error on a missing package that reading an image needs."""
    return InputError(f"{path}: needs the package {error.name}; `mantle setup` installs it")


def _npz(path: Path) -> Voxels:
    """Return the arrays of a file of numpy."""
    with path.open("rb") as file, np.load(file) as arrays:
        return Voxels(arrays["values"], arrays["affine"], "arrays of numpy")


def _nifti(path: Path) -> Voxels:
    """Return numbers and their affine to mm, by a header that is checked.

    Raises:
        InputError: The header has no axes, other units than mm, or axes that contradict each other.
        Exception: It is damaged; nibabel raises errors of any kind.
    """
    import nibabel

    with path.open("rb") as file:
        compressed = file.read(len(GZIP)) == GZIP
    has_nifti_suffix = path.suffix in (".nii", ".gz")
    if has_nifti_suffix and compressed != (path.suffix == ".gz"):
        # Browsers and mail programs unpack files and keep the name, or the other way round.
        content = path.read_bytes()
        content = gzip.decompress(content) if compressed else content
        is_second = int.from_bytes(content[:4], "little") == NIFTI2_SIZE or (
            int.from_bytes(content[:4], "big") == NIFTI2_SIZE
        )
        kind = nibabel.Nifti2Image if is_second else nibabel.Nifti1Image
        image = kind.from_bytes(content)
    else:
        image = nibabel.load(path)
    if not isinstance(image, nibabel.Nifti1Pair):
        kind = type(image).__name__.removesuffix("Image")
        fault = f"is not a NIfTI file but {kind}"
        raise InputError(f"{path}: {fault}; convert it, for example with `mri_convert`")
    header = image.header
    sform, qform = int(header["sform_code"]), int(header["qform_code"])
    if not (sform or qform):
        raise InputError(
            f"{path}: its header has neither qform nor sform, so its spacing and axes are unknown"
        )
    unit = header.get_xyzt_units()[0]
    if unit not in ("mm", "unknown"):
        raise InputError(f"{path}: its unit is {unit}; expected mm")
    doubts = []
    if sform:
        by_sform = header.get_sform()
        edges = np.linalg.norm(by_sform[:3, :3], axis=0)
        sizes = np.abs(np.asarray(header["pixdim"][1:4], float))
        if not np.allclose(edges, sizes, rtol=SIZE_TOLERANCE):
            raise InputError(
                f"{path}: its voxels have {product_text(edges, digits=4)} mm by sform but"
                f" {product_text(sizes, digits=4)} mm by pixdim;"
                " correct the header, or write the image again"
            )
        if qform:
            doubts += _against_qform(path, image.shape, by_sform, header.get_qform())
    if sform in TEMPLATES and not qform:
        space = SPACES.get(sform, f"code {sform}")
        doubts.append(
            f"{path.name}: its sform is in {space} space; is it still the patient's size?"
        )
    name, code = ("sform", sform) if sform else ("qform", qform)
    space = SPACES.get(code, f"code {code}")
    kind = f"NIfTI, axes by its {name} ({space})"
    return Voxels(np.asanyarray(image.dataobj), image.affine, kind, doubts=tuple(doubts))


def _against_qform(path: Path, shape: tuple[int, ...], sform: Floats, qform: Floats) -> list[str]:
    """Return a doubt if qform places voxels elsewhere than sform.

    Raises:
        InputError: One is the mirror image of the other.
    """
    if np.linalg.det(sform[:3, :3]) * np.linalg.det(qform[:3, :3]) < 0:
        raise InputError(
            f"{path}: its sform is the mirror image of its qform, so left and right are unknown;"
            " correct the header, or write the image again"
        )
    corners = np.array([*np.ndindex(2, 2, 2)]) * (np.array(shape[:3]) - 1)
    differences = (sform - qform)[:3, :3] @ corners.T + (sform - qform)[:3, 3:]
    largest = float(np.linalg.norm(differences, axis=0).max())
    if largest <= PLACE_TOLERANCE * float(np.linalg.norm(sform[:3, :3], axis=0).min()):
        return []
    return [f"{path.name}: its sform and qform differ by up to {largest:.3g} mm; sform is used"]
