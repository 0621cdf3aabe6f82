"""DICOM slices and frames: folders of hospitals, stored bits, refused files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest

from app.foundation.errors import InputError
from app.patient import images
from tests.patient.bones import enhanced
from tests.patient.voxel_images import NUMBERS, PLACES, change, frames, moved


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
    """Write files like old programs, without preamble and without the group of the syntax."""
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
    """Store the numbers in few bits, from bit `shift` on, with other data above them.

    DICOM PS3.5, 8.1.1 allows this. The CT numbers become integers.
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
    """The path is the file, a folder with it, or a folder with it and other files."""
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
    """A series has two files: the lower slices in one, the upper in the other."""
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
