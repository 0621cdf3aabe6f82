"""Images as people have them: headers that lie, labels that are none, folders of a hospital."""

from __future__ import annotations

import gzip
import os
import random
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pydicom
import pytest

from app.foundation.errors import GeometryError, InputError
from app.patient import bone_surface, dicom_series, images, label_image, label_surface
from tests.patient.bones import enhanced, slices

SHAPE = (12, 10, 8)
SPACING = np.array([0.7, 0.8, 1.25])
PLACES = np.array([[-0.7, 0, 0, 9], [0, -0.8, 0, 8], [0, 0, 1.25, 7], [0, 0, 0, 1.0]])
VALUES = np.random.default_rng(0).integers(-1000, 1500, SHAPE).astype(np.int16)


def nifti(
    path: Path,
    sform: Any = PLACES,
    qform: Any = PLACES,
    codes: tuple[int, int] = (1, 1),
    values: Any = VALUES,
    pixdim: Any = None,
) -> Path:
    """An image whose sform, qform and pixdim are given, with their codes."""
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
    """As browsers do, or the other way round."""
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
    """Times are no slices."""
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
    """A change of either is a change of the image."""
    nibabel.Nifti1Pair(VALUES, PLACES).to_filename(tmp_path / "ct.img")
    header, numbers = tmp_path / "ct.hdr", tmp_path / "ct.img"
    assert {*images.files_of(header)} == {*images.files_of(numbers)} == {header, numbers}
    assert (images.read(header).values == VALUES).all()
    nibabel.Nifti1Pair(VALUES + 1, PLACES).to_filename(numbers)
    later = header.stat().st_mtime + 5
    os.utime(numbers, (later, later))
    assert (images.read(header).values == VALUES + 1).all()


def test_images_padding_is_no_air(tmp_path: Path) -> None:
    """Numbers below -1500 stand where nothing was measured."""
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


# Labels

BALL = (np.indices((24, 24, 24)) - 12.0) ** 2
LABELS = (BALL.sum(axis=0) < 81.0) + 1 * (BALL.sum(axis=0) < 30.0)


def labelled(folder: Path, values: Any) -> Path:
    path = folder / "labels.npz"
    np.savez(path, values=values, affine=np.eye(4))
    return path


@pytest.mark.parametrize(
    ("factor", "off"), [(0.99999, "2e-05"), (1.01, "0.02"), (32768 / 32767, "6.1e-05")]
)
def test_label_surface_nearly_integer_labels_are_rounded(
    factor: float, off: str, tmp_path: Path
) -> None:
    corners, _ = label_surface.read(labelled(tmp_path, LABELS), 1)
    values = (LABELS * factor).astype(np.float32)
    near, body = label_surface.read(labelled(tmp_path, values), 1)
    assert near == pytest.approx(corners)
    assert f"labels rounded by up to {off}" in body.notes


def test_label_surface_interpolated_labels_are_refused(tmp_path: Path) -> None:
    """As linear interpolation leaves them at borders."""
    values = 0.5 * (LABELS + np.roll(LABELS, 1, axis=0))
    between = int((values % 1 > 0).sum())
    with pytest.raises(
        InputError, match=f"{between:,} voxels have values that are not whole .* nearest"
    ):
        label_surface.read(labelled(tmp_path, values), 1)


def test_label_surface_mask_has_label_1(tmp_path: Path) -> None:
    corners, _ = label_surface.read(labelled(tmp_path, LABELS == 2), 1)
    assert corners == pytest.approx(label_surface.read(labelled(tmp_path, LABELS), 2)[0])


def test_label_surface_nan_labels_are_background(tmp_path: Path) -> None:
    values = np.where(LABELS > 0, LABELS, np.nan)
    corners, body = label_surface.read(labelled(tmp_path, values), 2)
    assert f"{int((LABELS == 0).sum()):,} voxels are not numbers; they count as 0" in body.notes
    assert corners == pytest.approx(label_surface.read(labelled(tmp_path, LABELS), 2)[0])


def test_label_surface_knows_where_the_image_cuts_the_body(tmp_path: Path) -> None:
    """The ball of radius 9 with its upper third and a side cut off."""
    whole_body = label_surface.body(labelled(tmp_path, LABELS > 0), 1)
    assert whole_body.borders == ()
    cut_off = (LABELS > 0)[5:, :, :16]
    np.savez(tmp_path / "cut.npz", values=cut_off, affine=np.eye(4))
    side, top = label_surface.body(tmp_path / "cut.npz", 1).borders
    assert side == pytest.approx(np.argwhere(cut_off[:1]) * [1.0, 1.0, 1.0])
    assert (top[:, 2] == 15.0).all() and len(top) == cut_off[:, :, 15].sum()
    # A voxel apart from the body is left out: it does not reach the border for it.
    apart = LABELS > 0
    apart[0, 0, 0] = True
    assert label_surface.body(labelled(tmp_path, apart), 1).borders == ()


# Folders of DICOM slices

NUMBERS = np.random.default_rng(1).integers(-900, 1400, SHAPE).astype(float)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return slices(tmp_path / "ct", NUMBERS, PLACES)


def change(path: Path, to: Path | None = None, **tags: Any) -> Path:
    """Write a slice with other tags, or without those that are None."""
    data = pydicom.dcmread(path)
    for tag, value in tags.items():
        if value is None:
            delattr(data, tag)
        else:
            setattr(data, tag, value)
    data.save_as(to or path)
    return to or path


def dicomdir(folder: Path) -> None:
    data = pydicom.dcmread(folder / "1.2.0", stop_before_pixels=True)
    for tag in ("Rows", "Columns", "SeriesInstanceUID", "ImagePositionPatient"):
        delattr(data, tag)
    data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.1.3.10"
    data.save_as(folder / "DICOMDIR")


def report(folder: Path) -> None:
    data = pydicom.dcmread(folder / "1.2.0", stop_before_pixels=True)
    for tag in ("Rows", "Columns", "ImageOrientationPatient", "ImagePositionPatient"):
        delattr(data, tag)
    data.SOPClassUID, data.Modality = "1.2.840.10008.5.1.4.1.1.88.67", "SR"
    data.save_as(folder / "dose.dcm")


def junk(folder: Path) -> None:
    (folder / "notes.txt").write_text("no slice")
    (folder / "empty").write_bytes(b"")
    (folder / "thumbs.db").write_bytes(b"\x08\x00\x01")


def localizer(folder: Path) -> None:
    change(
        folder / "1.2.0",
        folder / "scout",
        ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"],
        SeriesInstanceUID="1.9",
        ImageOrientationPatient=[0, 1, 0, 0, 0, -1],
    )


def captured(folder: Path) -> None:
    change(folder / "1.2.0", folder / "shot", ImagePositionPatient=None)


def twice(folder: Path) -> None:
    for file in sorted(folder.iterdir()):
        (folder / f"copy_{file.name}").write_bytes(file.read_bytes())


def once_more(folder: Path) -> None:
    (folder / "copy").write_bytes((folder / "1.2.3").read_bytes())


def without_preamble(folder: Path) -> None:
    for file in folder.iterdir():
        file.write_bytes(file.read_bytes()[132:])


def without_meta(folder: Path) -> None:
    """As old programs write: neither preamble nor the group that names the syntax."""
    for file in folder.iterdir():
        data = pydicom.dcmread(file)
        data.is_implicit_VR, data.is_little_endian = True, True
        data.file_meta = pydicom.dataset.FileMetaDataset()
        pydicom.dcmwrite(file, data, write_like_original=True)
        content = file.read_bytes()
        file.write_bytes(content[132:] if content[128:132] == b"DICM" else content)


def turned(folder: Path) -> None:
    change(folder / "1.2.3", ImageOrientationPatient=[1, 2e-4, 0, -2e-4, 1, 0])


def empty_slope(folder: Path) -> None:
    for file in folder.iterdir():
        data = pydicom.dcmread(file)
        stored = (0.5 * data.pixel_array - 1000).astype("<i2")
        data.PixelData, data.PixelRepresentation = stored.tobytes(), 1
        data.RescaleSlope, data.RescaleIntercept = None, None
        data.save_as(file)


def subfolder(folder: Path) -> None:
    (folder / "S2").mkdir()
    (folder / "1.2.0").replace(folder / "S2" / "other")
    (folder / "1.2.0").write_bytes((folder / "S2" / "other").read_bytes())


def stored_in(bits: int, signed: bool, shift: int = 0, above: int = 0) -> Callable[[Path], None]:
    """Store the numbers in few bits, from bit `shift` on, and something else above them.

    By DICOM PS3.5, 8.1.1. The CT numbers become whole.
    """

    def alter(folder: Path) -> None:
        for file in folder.iterdir():
            data = pydicom.dcmread(file)
            numbers = np.floor(0.5 * data.pixel_array - 1000).astype(np.int64)
            stored = (numbers + (0 if signed else 1024)) & ((1 << bits) - 1)
            pixels = (stored << shift) | (above << (bits + shift))
            data.RescaleSlope, data.RescaleIntercept = 1, 0 if signed else -1024
            data.BitsAllocated, data.BitsStored, data.HighBit = 16, bits, bits - 1 + shift
            data.PixelRepresentation = int(signed)
            del data.PixelPaddingValue
            data.PixelData = pixels.astype("<u2").tobytes()
            data.save_as(file)

    return alter


BITS = {
    "12 bits": stored_in(12, signed=False),
    "an overlay above them": stored_in(12, signed=False, above=5),
    "12 bits with a sign": stored_in(12, signed=True),
    "the upper 12 bits": stored_in(12, signed=False, shift=4),
    "16 bits with a sign": stored_in(16, signed=True),
}


@pytest.mark.parametrize("name", BITS)
def test_dicom_series_pixels_have_their_stored_bits_alone(name: str, folder: Path) -> None:
    BITS[name](folder)
    assert (images.read(folder).values == np.floor(NUMBERS)).all()


def few_of_many(folder: Path) -> None:
    for file in folder.iterdir():
        change(file, SliceThickness=0.6)


def moved(folder: Path) -> None:
    change(folder / "1.2.3", FrameOfReferenceUID="1.99")


def repeated_numbers(folder: Path) -> None:
    for k, file in enumerate(sorted(folder.iterdir())):
        change(file, InstanceNumber=k // 2)


def lossy(folder: Path) -> None:
    for file in folder.iterdir():
        change(file, LossyImageCompression="01")


DOUBTFUL: dict[str, tuple[Callable[[Path], None], str]] = {
    "gaps": (few_of_many, "slices are 1.25 mm apart and 0.6 mm thick; are slices missing?"),
    "moved": (moved, "its slices are in 2 frames of reference; was the patient moved?"),
    "two in one": (repeated_numbers, "8 of its 8 slices share their instance number with another"),
    "lossy": (lossy, "its slices have lossy compression"),
}


@pytest.mark.parametrize("name", DOUBTFUL)
def test_dicom_series_doubtful_folders_have_a_note(name: str, folder: Path) -> None:
    alter, message = DOUBTFUL[name]
    assert images.read(folder).notes == ()
    alter(folder)
    (note,) = images.read(folder).notes
    assert message in note


READ: dict[str, tuple[Callable[[Path], None], str]] = {
    "DICOMDIR": (dicomdir, "1 files without an image left out: DICOMDIR"),
    "dose report": (report, "1 files without an image left out: dose.dcm"),
    "junk": (junk, "3 other files left out: empty, notes.txt, thumbs.db"),
    "localizer": (localizer, "1 localizers left out: scout"),
    "secondary capture": (captured, "1 images without position left out: shot"),
    "all twice": (twice, "8 copies of slices left out: "),
    "one twice": (once_more, "1 copies of slices left out: "),
    "no preamble": (without_preamble, ""),
    "no preamble, no syntax": (without_meta, ""),
    "turned by rounding": (turned, ""),
    "slope without value": (empty_slope, ""),
    "subfolder": (subfolder, "its folder S2 (1 files) is not read"),
}


@pytest.mark.parametrize("name", READ)
def test_dicom_series_of_hospital_folders(name: str, folder: Path) -> None:
    alter, note = READ[name]
    alter(folder)
    image = images.read(folder)
    assert image.values == pytest.approx(NUMBERS)
    assert image.affine == pytest.approx(PLACES, abs=1e-3)
    line, *more = image.summary
    assert line.startswith("8 DICOM slices of ")
    assert "12 x 10 x 8 voxels of 0.7 x 0.8 x 1.25 mm" in line
    assert note in "; ".join(more) and bool(note) == bool(more)


def fewer_rows(folder: Path) -> None:
    data = pydicom.dcmread(folder / "1.2.3")
    data.PixelData = data.pixel_array[:5].tobytes()
    data.Rows = 5
    data.save_as(folder / "1.2.3")


def other_series(folder: Path) -> None:
    for file in sorted(folder.iterdir())[:3]:
        change(
            file, folder / f"b{file.name}", SeriesInstanceUID="1.7", SeriesDescription="Thin B70"
        )


def other_plane(folder: Path) -> None:
    change(folder / "1.2.3", ImageOrientationPatient=[0, 1, 0, 0, 0, -1])


def other_values(folder: Path) -> None:
    data = pydicom.dcmread(folder / "1.2.3")
    data.PixelData = (data.pixel_array + 5).tobytes()
    data.save_as(folder / "phase2")


def in_folders(folder: Path) -> None:
    (folder / "S1").mkdir()
    for file in list(folder.iterdir()):
        if file.is_file():
            file.replace(folder / "S1" / file.name)


def in_folders_of_folders(folder: Path) -> None:
    (folder / "A" / "S1").mkdir(parents=True)
    for file in list(folder.iterdir()):
        if file.is_file():
            file.replace(folder / "A" / "S1" / file.name)


def table_of_numbers(folder: Path) -> None:
    data = pydicom.dcmread(folder / "1.2.3")
    del data.RescaleSlope, data.RescaleIntercept
    table = pydicom.Dataset()
    table.LUTDescriptor, table.LUTData, table.ModalityLUTType = [3, 0, 16], b"\1\0\2\0\3\0", "HU"
    data.ModalityLUTSequence = [table]
    data.save_as(folder / "1.2.3")


def emptied(folder: Path) -> None:
    for file in folder.iterdir():
        file.unlink()
    (folder / "readme.txt").write_text("none")


def no_positions(folder: Path) -> None:
    for file in folder.iterdir():
        change(file, ImageOrientationPatient=None, SOPClassUID="1.2.840.10008.5.1.4.1.1.7")


def frames(folder: Path) -> None:
    change(folder / "1.2.3", NumberOfFrames=8)


def alone(folder: Path) -> None:
    for file in folder.iterdir():
        if file.name != "1.2.3":
            file.unlink()


def cut(folder: Path) -> None:
    path = folder / "1.2.3"
    path.write_bytes(path.read_bytes()[:-1000])


def spacing(folder: Path) -> None:
    change(folder / "1.2.3", PixelSpacing=[0.8, 0.9])


DICOM_REFUSED: dict[str, tuple[Callable[[Path], None], str]] = {
    "other rows": (fewer_rows, r"1\.2\.3 has 5 x 12 pixels, the other slices 10 x 12; leave"),
    "other spacing": (
        spacing,
        r"1\.2\.3 has 0\.8 x 0\.9 mm between pixels, the other slices 0\.8 x 0\.7",
    ),
    "two series": (
        other_series,
        "has 2 series or orientations; .* 3 slices of 'Thin B70', such as b1",
    ),
    "other plane": (other_plane, r"1\.2\.3 is not parallel to the other slices"),
    "two phases": (
        other_values,
        r"1\.2\.3 and phase2 differ, but have the same position|phase2 and 1",
    ),
    "subfolder alone": (in_folders, r"has no slices; its folders have: S1 \(8 files\)"),
    "subfolder of a subfolder": (in_folders_of_folders, r"its folders have: A/S1 \(8 files\)"),
    "table": (table_of_numbers, r"1\.2\.3: gives CT numbers by a table .Modality LUT."),
    "nothing": (emptied, "has no slices: none of its 1 files is a DICOM file"),
    "no position": (no_positions, "no position in the patient .Secondary Capture Image Storage"),
    "many frames at one place": (
        frames,
        r"1\.2\.3: has 8 frames but only one position; convert it",
    ),
    "one slice": (alone, r"has only one slice, 1\.2\.3"),
    "cut": (cut, r"1\.2\.3: its pixels cannot be read"),
}


@pytest.mark.parametrize("name", DICOM_REFUSED)
def test_dicom_series_folders_are_refused_with_file_and_reason(name: str, folder: Path) -> None:
    alter, message = DICOM_REFUSED[name]
    alter(folder)
    with pytest.raises(InputError, match=message):
        images.read(folder)


def test_dicom_series_file_without_voxels_says_its_kind(folder: Path) -> None:
    path = folder / "1.2.0"
    data = pydicom.dcmread(path, stop_before_pixels=True)
    del data.Rows, data.Columns
    data.SOPClassUID = "1.2.840.10008.5.1.4.1.1.481.3"
    data.save_as(path)
    with pytest.raises(InputError, match=r"has no voxels \(RT Structure Set Storage\); export its"):
        images.read(path)


# One file of many frames


@pytest.fixture
def framed(tmp_path: Path) -> Path:
    return enhanced(tmp_path / "ct.dcm", NUMBERS, PLACES)


def test_dicom_series_frames_of_a_file_are_slices(framed: Path) -> None:
    """Given as the file, in a folder, and in one with other files."""
    images_of = [images.read(framed)]
    folder = framed.parent / "alone"
    folder.mkdir()
    framed.rename(folder / "ct.dcm")
    images_of.append(images.read(folder))
    change(
        framed.parent / "slices" / "1.2.0",
        folder / "scout",
        ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"],
    )
    images_of.append(images.read(folder))
    for image in images_of:
        assert image.values == pytest.approx(NUMBERS)
        assert image.affine == pytest.approx(PLACES, abs=1e-3)
        assert image.summary[0].startswith("8 DICOM frames of ")
        assert "12 x 10 x 8 voxels of 0.7 x 0.8 x 1.25 mm" in image.summary[0]
    assert images_of[2].summary[1] == "1 localizers left out: scout"


def test_dicom_series_files_of_frames_are_joined(framed: Path, tmp_path: Path) -> None:
    """A series of two files: the lower slices in one, the upper in the other."""
    folder = tmp_path / "two"
    folder.mkdir()
    for name, rows in (("a", slice(0, 5)), ("b", slice(5, 8))):
        places = PLACES @ np.array([*np.eye(4)[:3], [0, 0, 0, 1.0]])
        places[:3, 3] += places[:3, 2] * rows.start
        enhanced(tmp_path / name / "x.dcm", NUMBERS[:, :, rows], places).rename(folder / name)
    image = images.read(folder)
    assert image.values == pytest.approx(NUMBERS)
    assert image.affine == pytest.approx(PLACES, abs=1e-3)


def without_frame(data: Any, frame: int = 3) -> None:
    groups = list(data.PerFrameFunctionalGroupsSequence)
    pixels = data.pixel_array
    kept = [k for k in range(len(groups)) if k != frame]
    data.PerFrameFunctionalGroupsSequence = [groups[k] for k in kept]
    data.PixelData, data.NumberOfFrames = pixels[kept].tobytes(), len(kept)


def frames_of_two_stacks(data: Any) -> None:
    for group in data.PerFrameFunctionalGroupsSequence[:3]:
        group.FrameContentSequence[0].StackID = "2"


def frames_at_one_place(data: Any) -> None:
    first, second, *_ = data.PerFrameFunctionalGroupsSequence
    second.PlanePositionSequence = first.PlanePositionSequence


def frames_without_place(data: Any) -> None:
    for group in data.PerFrameFunctionalGroupsSequence:
        del group.PlanePositionSequence


def fewer_places(data: Any) -> None:
    data.PerFrameFunctionalGroupsSequence = data.PerFrameFunctionalGroupsSequence[:5]


def frames_of_other_plane(data: Any) -> None:
    group = data.PerFrameFunctionalGroupsSequence[2]
    group.PlaneOrientationSequence = [pydicom.Dataset()]
    group.PlaneOrientationSequence[0].ImageOrientationPatient = [0, 1, 0, 0, 0, -1]


def fewer_pixels(data: Any) -> None:
    data.PixelData = data.PixelData[:-200]


def one_frame(data: Any) -> None:
    for _ in range(7):
        without_frame(data, 0)


FRAMES_REFUSED: dict[str, tuple[Callable[[Any], None], str]] = {
    "missing": (without_frame, r"2\.5 mm apart; is one missing after ct\.dcm \(frame \d\)\?"),
    "two stacks": (
        frames_of_two_stacks,
        r"series or orientations; convert it .* as ct\.dcm \(frame 1\); .* as ct\.dcm \(frame 4\)",
    ),
    "two phases": (frames_at_one_place, r"ct\.dcm \(frame .\) differ, but have the same position"),
    "no place": (frames_without_place, "have no position in the patient .Enhanced CT Image"),
    "fewer places": (
        fewer_places,
        r"ct\.dcm: has 8 frames but the positions of 5; is the file damaged",
    ),
    "other plane": (frames_of_other_plane, r"ct\.dcm \(frame 3\) is not parallel"),
    "cut": (fewer_pixels, r"ct\.dcm: its pixels cannot be read"),
    "one frame": (one_frame, r"ct\.dcm: is a single DICOM slice; give the folder of its series"),
}


@pytest.mark.parametrize("name", FRAMES_REFUSED)
def test_dicom_series_frames_are_refused_with_reason(name: str, framed: Path) -> None:
    alter, message = FRAMES_REFUSED[name]
    data = pydicom.dcmread(framed)
    alter(data)
    data.save_as(framed)
    with pytest.raises(InputError, match=message):
        images.read(framed)


def test_images_damaged_files_are_read_or_refused(folder: Path, tmp_path: Path) -> None:
    """No other error, of 150 files: NIfTI plain and compressed, arrays, slices, labels of them."""
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


@pytest.mark.parametrize(
    ("edge", "units"),
    [(7.2, None), (0.72, "cm"), (7.2 / 25.4, "cm or inch"), (0.0072, "m")],
)
def test_bone_surface_of_an_image_in_another_unit_names_it(
    edge: float, units: str | None, tmp_path: Path
) -> None:
    """40 voxels of 7.2 mm are 288 mm long, as a femur; 288 mm are 11.3 inch, or 113 mm by cm."""
    values = np.zeros((12, 12, 44), np.uint8)
    values[3:9, 3:9, 2:42] = 1
    affine = np.diag([edge, edge, edge, 1.0])
    nibabel.Nifti1Image(values, affine).to_filename(tmp_path / "labels.nii")
    if units is None:
        bone_surface.read(tmp_path / "labels.nii", label=1)
        return
    with pytest.raises(GeometryError, match=rf"is the unit of the image {units}\?") as caught:
        bone_surface.read(tmp_path / "labels.nii", label=1)
    assert "or give the label of the femur" in str(caught.value)
