"""Image files: wrong headers, other formats, damaged files."""

from __future__ import annotations

import gzip
import os
import random
import re
import warnings
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest

from app.foundation.errors import InputError
from app.patient import dicom_series, images, label_image, label_surface
from tests.patient.bones import enhanced, slices
from tests.patient.voxel_images import LABELS, NUMBERS, PLACES, SHAPE, labelled

SPACING = np.array([0.7, 0.8, 1.25])
VALUES = np.random.default_rng(0).integers(-1000, 1500, SHAPE).astype(np.int16)


def nifti(
    path: Path,
    sform: Any = PLACES,
    qform: Any = PLACES,
    codes: tuple[int, int] = (1, 1),
    values: Any = VALUES,
    pixdim: Any = None,
) -> Path:
    """An image with given sform, qform and pixdim, and their codes."""
    image = nibabel.Nifti1Image(values, None)
    header = image.header
    header.set_qform(PLACES if qform is None else qform, codes[1])
    header.set_sform(PLACES if sform is None else sform, codes[0])
    if pixdim is not None:
        header["pixdim"][1:4] = pixdim
    image = nibabel.Nifti1Image(values, None, header)
    image.to_filename(path)
    return path


UNIT = PLACES @ np.diag([*(1 / SPACING), 1])
LYING: dict[str, tuple[dict[str, Any], str]] = {
    "unit voxels": ({"sform": UNIT}, r"its voxels have 1 x 1 x 1 mm by sform but 0\.7"),
    "z stretched": ({"sform": PLACES @ np.diag([1, 1, 1.25, 1])}, r"0\.7 x 0\.8 x 1\.562 mm by"),
    "x mirrored": ({"sform": np.diag([-1, 1, 1, 1]) @ PLACES}, "sform is the mirror image of its"),
    "pixdim alone": ({"codes": (1, 0), "pixdim": (1, 1, 1)}, "1 x 1 x 1 mm by pixdim"),
    "template": ({"codes": (4, 1), "sform": PLACES * 1.1}, r"its voxels have 0\.77"),
    "no codes": ({"codes": (0, 0)}, "has neither qform nor sform"),
}


@pytest.mark.parametrize("name", LYING)
def test_images_nifti_contradictory_headers_are_refused(name: str, tmp_path: Path) -> None:
    given, message = LYING[name]
    with pytest.raises(InputError, match=message):
        images.read(nifti(tmp_path / "ct.nii.gz", **given))


@pytest.mark.parametrize(
    ("codes", "suffix", "axes"),
    [((1, 1), "nii.gz", "sform"), ((1, 0), "nii", "sform"), ((0, 1), "nii", "qform")],
)
def test_images_nifti_axes_are_used_and_reported(
    codes: tuple[int, int], suffix: str, axes: str, tmp_path: Path
) -> None:
    image = images.read(nifti(tmp_path / f"ct.{suffix}", codes=codes))
    assert image.affine == pytest.approx(PLACES, abs=1e-5)
    (line,) = image.summary
    assert line == (
        f"NIfTI, axes by its {axes} (scanner): 12 x 10 x 8 voxels of 0.7 x 0.8 x 1.25 mm, int16"
    )
    assert image.notes == ()


def test_images_nifti_shifted_sform_has_a_note(tmp_path: Path) -> None:
    moved = PLACES.copy()
    moved[:3, 3] += [3, 0, 4]
    image = images.read(nifti(tmp_path / "ct.nii", sform=moved))
    assert image.affine == pytest.approx(moved, abs=1e-5)
    assert "sform and qform differ by up to 5 mm; sform is used" in image.notes[0]


@pytest.mark.parametrize(("code", "notes"), [(2, 0), (3, 1), (4, 1)])
def test_images_nifti_template_sform_has_a_note(code: int, notes: int, tmp_path: Path) -> None:
    image = images.read(nifti(tmp_path / "ct.nii", codes=(code, 0)))
    assert len(image.notes) == notes
    assert "is it still the patient's size" in "".join(image.notes) or not notes


def test_images_of_other_formats_are_named(tmp_path: Path) -> None:
    nibabel.MGHImage(VALUES, PLACES).to_filename(tmp_path / "ct.mgz")
    with pytest.raises(InputError, match="is not a NIfTI file but MGH; convert it"):
        images.read(tmp_path / "ct.mgz")
    folder = slices(tmp_path / "ct", VALUES / 1.0, PLACES)
    with pytest.raises(InputError, match="is a single DICOM slice; give the folder"):
        images.read(folder / "1.2.0")


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("names", [("ct.nii", "ct.nii.gz"), ("ct.nii.gz", "ct.nii")])
def test_images_nifti_may_be_unpacked_under_its_name(
    names: tuple[str, str], version: int, tmp_path: Path
) -> None:
    """Browsers unpack files and keep their names, or the reverse."""
    kind = {1: nibabel.Nifti1Image, 2: nibabel.Nifti2Image}[version]
    kind(VALUES, PLACES).to_filename(tmp_path / names[0])
    image = images.read((tmp_path / names[0]).rename(tmp_path / names[1]))
    assert (image.values == VALUES).all()
    assert image.affine == pytest.approx(PLACES, abs=1e-5)


SHAPES: dict[str, tuple[Any, str]] = {
    "one slice at eight times": (VALUES[:, :, None, :], "has 8 numbers per voxel, such as colours"),
    "two volumes": (np.stack([VALUES, VALUES], axis=-1), "has 2 numbers per voxel"),
    "one slice": (VALUES[:, :, :1], "is a single slice of 12 x 10 x 1 voxels"),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("suffix", ["nii", "npz"])
def test_images_of_times_or_of_one_slice_are_refused(
    name: str, suffix: str, tmp_path: Path
) -> None:
    """Times are not slices."""
    values, message = SHAPES[name]
    path = tmp_path / f"ct.{suffix}"
    if suffix == "npz":
        np.savez(path, values=values, affine=PLACES)
    else:
        nibabel.Nifti1Image(values, PLACES).to_filename(path)
    with pytest.raises(InputError, match=message):
        images.read(path)


@pytest.mark.parametrize("axes", [1, 2])
def test_images_axes_of_one_entry_do_not_matter(axes: int, tmp_path: Path) -> None:
    values = VALUES.reshape(*SHAPE, *[1] * axes)
    nibabel.Nifti1Image(values, PLACES).to_filename(tmp_path / "ct.nii")
    assert (images.read(tmp_path / "ct.nii").values == VALUES).all()


OTHERS: dict[str, tuple[bytes, str]] = {
    "a.mha": (
        b"ObjectType = Image\nNDims = 3\n",
        "is a MetaImage .*: save it as NIfTI or NRRD, as",
    ),
    "a.vtk": (b"# vtk DataFile Version 3.0\n", "is a file of VTK: save it as NIfTI or NRRD, as"),
    "a.tif": (
        b"II*\0" + bytes(100),
        "is a TIFF picture without voxel positions: export the scan as NIfTI, NRRD or DICOM",
    ),
    "a.stl": (b"solid bone\n", "is an STL surface: give it as `surface`"),
    "a.zip": (b"PK\x03\x04" + bytes(100), "is a ZIP archive: unpack it"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_images_files_of_other_kinds_have_a_remedy(name: str, tmp_path: Path) -> None:
    content, message = OTHERS[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=rf"{re.escape(name)}: {message}"):
        images.read(tmp_path / name)


@pytest.mark.parametrize("compressed", [False, True])
def test_images_text_under_the_name_of_an_image_is_named(compressed: bool, tmp_path: Path) -> None:
    content = b"femur 75\n" * 20
    path = tmp_path / "labels.nii.gz"
    path.write_bytes(gzip.compress(content) if compressed else content)
    with pytest.raises(InputError, match=r"labels\.nii\.gz: is a text file, not an image"):
        images.read(path)


def test_images_header_and_numbers_in_two_files_are_both_its_files(tmp_path: Path) -> None:
    """A change of either file changes the image."""
    nibabel.Nifti1Pair(VALUES, PLACES).to_filename(tmp_path / "ct.img")
    header, numbers = tmp_path / "ct.hdr", tmp_path / "ct.img"
    assert {*images.files_of(header)} == {header, numbers}
    assert {*images.files_of(numbers)} == {header, numbers}
    assert (images.read(header).values == VALUES).all()
    nibabel.Nifti1Pair(VALUES + 1, PLACES).to_filename(numbers)
    later = header.stat().st_mtime + 5
    os.utime(numbers, (later, later))
    assert (images.read(header).values == VALUES + 1).all()


def test_images_padding_is_no_air(tmp_path: Path) -> None:
    """Numbers below -1500 stand for missing data."""
    values = np.maximum(VALUES, -900)
    values[:2] = -2000
    np.savez(tmp_path / "ct.npz", values=values, affine=PLACES)
    assert images.read(tmp_path / "ct.npz").min_measured == values[2:].min()
    np.savez(tmp_path / "padding.npz", values=0 * values - 2000, affine=PLACES)
    assert images.read(tmp_path / "padding.npz").min_measured == -2000


def test_images_nan_voxels_matter_only_where_needed(
    tmp_path: Path,
) -> None:
    values = VALUES.astype(np.float32)
    values[:2] = np.nan
    values[3, 3, 3] = np.inf
    image = images.read(nifti(tmp_path / "ct.nii.gz", values=values))
    lost = 2 * 10 * 8 + 1
    assert image.summary[1] == f"{lost} voxels are not numbers"
    assert image.percentile_99_9 == np.percentile(values[np.isfinite(values)], 99.9)
    inside = (PLACES @ [6.5, 2.5, 4.5, 1])[:3]
    assert np.isfinite(image.values_at(inside[None])).all()
    for index, message in (
        (0, "are in voxels that are not numbers"),
        (-2, "are outside the image"),
    ):
        x = (PLACES @ [index + 0.5, 2, 4, 1])[:3]
        with pytest.raises(InputError, match=f"1 of 2 points {message}"):
            image.values_at(np.stack([inside, x]))


def test_images_damaged_files_are_read_or_refused(folder: Path, tmp_path: Path) -> None:
    """There is no other error in 150 files: NIfTI plain and compressed, arrays, slices, labels."""
    slice_file = folder / "1.2.3"
    paths = {
        "nii": nifti(tmp_path / "ct.nii"),
        "nii.gz": nifti(tmp_path / "ct.nii.gz"),
        "npz": labelled(tmp_path, LABELS),
        "dicom": slice_file,
        "frames": enhanced(tmp_path / "ct.dcm", NUMBERS, PLACES),
    }
    whole = {name: path.read_bytes() for name, path in paths.items()}
    for seed in range(150):
        rng = random.Random(seed)
        name = rng.choice(sorted(whole))
        content = whole[name]
        for _ in range(rng.choice((1, 1, 3))):
            at = rng.randrange(min(len(content), rng.choice((400, 10**6))) + 1)
            cut_off = rng.random() < 0.2
            end = b"" if cut_off else content[at + rng.randint(0, 3) :]
            content = content[:at] + rng.randbytes(rng.randint(1, 4)) + end
        paths[name].write_bytes(content)
        path = folder if name == "dicom" else paths[name]
        images._read.cache_clear()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of the readers, on what is damaged
                image = images.read(path)
                label_image.as_whole_numbers(path, image.values)
                if name == "npz":
                    label_surface.read(path, 1)
        except InputError as error:
            assert str(path) in str(error)
        except BaseException as error:
            raise AssertionError(f"seed {seed}: {name}") from error
    assert dicom_series.is_dicom(whole["dicom"])
