"""Images in folders of DICOM slices, or in one file of many frames, as a hospital exports them.

An image has the slices of one series; a frame of a file is a slice. Other files in the folder are
left out and listed: the directory of the medium, reports, localizers, secondary captures. A folder
is refused if several images could be meant.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.foundation.errors import InputError
from app.foundation.files import files_at
from app.foundation.layout import product_text, shortened_list
from app.patient.voxels import Voxels

STEP_TOLERANCE = 0.1  # largest distance of a slice from its even place, as a part of the step
SAME_PLACE = 0.01  # mm: slices that are nearer are at one place
AXES_TOLERANCE = (
    2e-3  # largest difference of the cosines of a slice's axes from those of the others
)
THICKNESS_RATIO = 1.5  # slices farther apart than this part of their thickness have a note
# First bytes of a file without preamble: a group of its first element, little-endian.
FIRST_GROUPS = (b"\x02\x00", b"\x08\x00")
# What to do with a file that mantle cannot read.
CONVERT = "convert it to NIfTI, for example with dcm2niix"
PREAMBLE = 128  # bytes before the letters DICM
MOST_NAMES = 3  # most files that a message names
PLACE_TAGS = ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing")
# Functional groups of a frame, with the tags that single slices have themselves.
GROUPS = {
    "PlanePositionSequence": ("ImagePositionPatient",),
    "PlaneOrientationSequence": ("ImageOrientationPatient",),
    "PixelMeasuresSequence": ("PixelSpacing", "SliceThickness"),
    "PixelValueTransformationSequence": ("RescaleSlope", "RescaleIntercept"),
    "FrameContentSequence": ("StackID",),
    "SegmentIdentificationSequence": ("ReferencedSegmentNumber",),
}
# Tags of a file that its frames share.
COMMON = (
    *("SOPClassUID", "SeriesInstanceUID", "SeriesDescription", "Modality", "ImageType"),
    *("Rows", "Columns", "SamplesPerPixel", "FrameOfReferenceUID", "LossyImageCompression"),
    *("BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation", "ModalityLUTSequence"),
)


def read(path: Path, headers: Sequence[Any], left_out: Sequence[str]) -> Voxels:
    """Return the CT numbers of a series with their affine to mm.

    Axes to the left and posterior become axes to the right and anterior.

    Args:
        path: The folder, or the file of many frames.
        headers: Headers of its files.
        left_out: Notes on its other files.

    Raises:
        InputError: There are no slices of one series, in one plane, at even steps.
        Exception: A slice is damaged; pydicom raises errors of any kind.
    """
    notes = list(left_out)
    slices = _of_one_series(path, headers, notes)
    check_equal(path, slices)
    row_direction, column_direction = np.split(
        np.mean([s.ImageOrientationPatient for s in slices], axis=0), 2
    )
    normal = np.cross(row_direction, column_direction)
    slices.sort(key=lambda s: float(normal @ np.array(s.ImagePositionPatient, float)))
    slices, numbers = _without_copies(path, slices, notes)
    positions = np.array([s.ImagePositionPatient for s in slices], dtype=float)
    if len(slices) < 2:
        raise InputError(
            f"{path}: has only one slice, {name_of_slice(slices[0])}; expected several"
        )
    step = (positions[-1] - positions[0]) / (len(positions) - 1)
    gaps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    distances = np.linalg.norm(
        positions - positions[0] - np.outer(range(len(positions)), step), axis=1
    )
    if not distances.max() < STEP_TOLERANCE * np.linalg.norm(step):
        message = f"{path}: its slices are {gaps.min():.3g} to {gaps.max():.3g} mm apart"
        name_before_gap = name_of_slice(slices[int(gaps.argmax())])
        raise InputError(
            f"{message}; is one missing after {name_before_gap}? If not, resample them evenly"
        )
    spacing = np.array(slices[0].PixelSpacing, dtype=float)
    affine = np.eye(4)
    affine[:3] = np.stack(
        [row_direction * spacing[1], column_direction * spacing[0], step, positions[0]], axis=1
    )
    affine[:2] *= -1
    modality = str(slices[0].get("Modality", "") or "no modality")
    slice_kind = "slices" if _frame(slices[0]) is None else "frames"
    series = f"{len(slices)} DICOM {slice_kind} of {_described(slices[0])} ({modality})"
    doubts = tuple(
        f"{path.name}: {doubt}" for doubt in _doubts(slices, float(np.linalg.norm(step)))
    )
    return Voxels(np.stack(numbers).T, affine, series, tuple(notes), doubts)


def _doubts(slices: Sequence[Any], step: float) -> Iterator[str]:
    """Doubts about a series whose slices are `step` [mm] apart."""
    thickness = max(float(s.get("SliceThickness") or 0.0) for s in slices)
    if 0.0 < THICKNESS_RATIO * thickness < step:
        yield (
            f"its slices are {step:.3g} mm apart and {thickness:.3g} mm thick; are slices missing?"
        )
    frames = {str(s.get("FrameOfReferenceUID") or "") for s in slices}
    if len(frames) > 1:
        yield f"its slices are in {len(frames)} frames of reference; was the patient moved?"
    numbers = Counter(str(s.get("InstanceNumber") or "") for s in slices)
    repeated = sum(count for count in numbers.values() if count > 1)
    if repeated and len(numbers) > 1:
        doubt = f"{repeated} of its {len(slices)} slices share their instance number with another"
        yield f"{doubt}; are there two acquisitions or reconstructions in one series?"
    if any(str(s.get("LossyImageCompression") or "") == "01" for s in slices):
        yield "its slices have lossy compression, so CT numbers differ from those of the scanner"


def is_dicom(start: bytes) -> bool:
    """Return True if a file's first bytes are those of DICOM with its preamble."""
    return start[PREAMBLE : PREAMBLE + 4] == b"DICM"


def headers_of(path: Path) -> tuple[list[Any], list[str]]:
    """Return the headers of a file or of all files of a folder, and notes on its other files.

    Raises:
        InputError: There is no image.
    """
    if not path.is_dir():
        return [_header_with_frames(path)], []
    headers = []
    other_files = []
    for file in files_at(path):
        header = _header(file)
        if header is None:
            other_files.append(file.name)
        else:
            headers.append(header)
    slice_counts = {}
    for folder in sorted(file for file in path.rglob("*") if file.is_dir()):
        count = sum(map(_is_slice, files_at(folder)))
        if count:
            slice_counts[str(folder.relative_to(path))] = count
    subfolders = [f"{name} ({count} files)" for name, count in slice_counts.items()]
    if not headers and subfolders:
        raise InputError(f"{path}: has no slices; its folders have: {_names(subfolders)}. Give one")
    if not headers:
        message = f"has no slices: none of its {len(other_files)} files is a DICOM file"
        raise InputError(f"{path}: {message}")
    notes = [f"its folder {folder} is not read" for folder in subfolders]
    if other_files:
        notes.append(f"{len(other_files)} other files left out: {_names(other_files)}")
    return headers, notes


def _header_with_frames(path: Path) -> Any:
    """Return the header of a file of many frames.

    Raises:
        InputError: It is one slice, or has no image.
    """
    header = _header(path)
    if "Rows" not in header:
        kind = header.get("SOPClassUID", "")
        fault = f"has no voxels ({getattr(kind, 'name', kind)})"
        raise InputError(f"{path}: {fault}; export its structures as a labelmap")
    if int(header.get("NumberOfFrames") or 1) < 2:
        raise InputError(f"{path}: is a single DICOM slice; give the folder of its series")
    return header


def frames_of_file(header: Any) -> list[Any]:
    """Return the frames of a file, each with the tags of a slice; a file of one slice itself."""
    import pydicom

    count = int(header.get("NumberOfFrames") or 1)
    groups = header.get("PerFrameFunctionalGroupsSequence")
    if groups is None and count > 1 and _is_placed(header):
        fault = f"has {count} frames but only one position"
        raise InputError(f"{header.filename}: {fault}; {CONVERT}")
    if groups is None:
        return [header]
    if len(groups) != count:
        fault = f"has {count} frames but the positions of {len(groups)}"
        raise InputError(f"{header.filename}: {fault}; is the file damaged?")
    shared_groups = header.get("SharedFunctionalGroupsSequence") or [pydicom.Dataset()]
    common = {tag: header[tag] for tag in COMMON if tag in header}
    frames = []
    for number, group in enumerate(groups):
        frame = pydicom.Dataset()
        frame.update({element.tag: element for element in common.values()})
        for name, tags in GROUPS.items():
            sequence = group.get(name) or shared_groups[0].get(name) or [pydicom.Dataset()]
            frame.update(
                {sequence[0][tag].tag: sequence[0][tag] for tag in tags if tag in sequence[0]}
            )
        frame.filename = header.filename
        frame.frame = number
        frames.append(frame)
    return frames


def _is_slice(file: Path) -> bool:
    header = _header(file)
    return header is not None and "Rows" in header


def _header(file: Path) -> Any:
    """Return the data of a file before its pixels; None if it is no DICOM."""
    import pydicom

    with file.open("rb") as opened:
        first_bytes = opened.read(PREAMBLE + 4)
    if not is_dicom(first_bytes) and not first_bytes.startswith(FIRST_GROUPS):
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on values that no image needs
            # Files of old programs have no preamble.
            header = pydicom.dcmread(file, stop_before_pixels=True, force=True)
        return header if "SOPClassUID" in header or is_dicom(first_bytes) else None
    except Exception as error:  # damaged files let pydicom fail in any way
        if not is_dicom(first_bytes):
            return None
        raise InputError(f"{file}: cannot be read as a DICOM slice: {error}") from None


def _of_one_series(path: Path, headers: Sequence[Any], notes: list[str]) -> list[Any]:
    """Return the slices of the only series of a folder; add notes on what is left out.

    Raises:
        InputError: There are several series or none, or slices without a position.
    """

    def drop(
        headers: Sequence[Any], description: str, is_dropped: Callable[[Any], bool]
    ) -> list[Any]:
        dropped = [name_of_slice(h) for h in headers if is_dropped(h)]
        if dropped:
            notes.append(f"{len(dropped)} {description} left out: {_names(dropped)}")
        return [h for h in headers if not is_dropped(h)]

    slices = drop(headers, "files without an image", lambda h: "Rows" not in h)
    slices = drop(slices, "segmentations", lambda h: h.get("Modality") == "SEG")
    slices = [frame for header in slices for frame in frames_of_file(header)]
    if slices and not any(map(_is_placed, slices)):
        kind = slices[0].get("SOPClassUID", "")
        raise InputError(
            f"{path}: {name_of_slice(slices[0])} and {len(slices) - 1} other slices have no"
            f" position in the patient ({getattr(kind, 'name', kind)}); export the original series"
        )
    slices = drop(slices, "images without position", lambda s: not _is_placed(s))
    slices = drop(slices, "localizers", lambda s: "LOCALIZER" in (s.get("ImageType") or ()))
    if not slices:
        raise InputError(f"{path}: has no slices; {'; '.join(notes)}")
    series: dict[str, list[Any]] = {}
    for header in slices:
        key = f"{header.get('SeriesInstanceUID', '')} {header.get('StackID', '')}"
        series.setdefault(key, []).append(header)
    if len(series) > 1:
        series_list = "; ".join(
            f"{len(slices_of_series)} slices of {_described(slices_of_series[0])}, such as"
            f" {name_of_slice(slices_of_series[0])}"
            for slices_of_series in series.values()
        )
        one_file = len({header.filename for header in slices}) == 1
        remedy = CONVERT if one_file else "put one of them into a separate folder"
        raise InputError(
            f"{path}: has {len(series)} series or orientations; {remedy}: {series_list}"
        )
    return slices


def check_equal(path: Path, slices: Sequence[Any]) -> None:
    """Raise InputError with the file of a slice of another size or plane than most."""

    def differ(quantity: str, values: Sequence[tuple[Any, ...]]) -> None:
        (usual_value, _), *others = Counter(values).most_common()
        if others:
            odd_names = [
                name_of_slice(s)
                for s, value in zip(slices, values, strict=True)
                if value != usual_value
            ]
            odd_value = next(value for value in values if value != usual_value)
            fault = (
                f"{_names(odd_names)} has {product_text(odd_value)} {quantity}, the"
                f" other slices {product_text(usual_value)}"
            )
            raise InputError(f"{path}: {fault}; leave it out")

    differ("pixels", [(int(s.Rows), int(s.Columns)) for s in slices])
    differ("samples per pixel", [(int(s.get("SamplesPerPixel") or 1),) for s in slices])
    if int(slices[0].get("SamplesPerPixel") or 1) > 1:
        raise InputError(f"{path}: its slices are in colour; expected CT numbers")
    spacings = [tuple(np.round(np.array(s.PixelSpacing, float), 4)) for s in slices]
    differ("mm between pixels", spacings)
    axes = np.array([s.ImageOrientationPatient for s in slices], dtype=float)
    is_off = np.abs(axes - np.median(axes, axis=0)).max(axis=1) > AXES_TOLERANCE
    if is_off.any():
        odd_names = [
            name_of_slice(s) for s, is_rotated in zip(slices, is_off, strict=True) if is_rotated
        ]
        raise InputError(
            f"{path}: {_names(odd_names)} is not parallel to the other slices; leave it out"
        )


def _without_copies(
    path: Path, slices: Sequence[Any], notes: list[str]
) -> tuple[list[Any], list[Any]]:
    """Return the slices in their order without copies, and their CT numbers; add a note.

    Raises:
        InputError: Two slices at one place have different numbers.
    """
    kept_slices: list[Any] = []
    numbers: list[Any] = []
    copies = []
    pixels_of_file: dict[str, Any] = {}
    for header in slices:
        if header.filename not in pixels_of_file:
            pixels_of_file = {header.filename: pixels(header)}
        values = _numbers(header, pixels_of_file[header.filename])
        at_same_place = kept_slices and np.allclose(
            np.array(header.ImagePositionPatient, float),
            np.array(kept_slices[-1].ImagePositionPatient, float),
            rtol=0.0,
            atol=SAME_PLACE,
        )
        if not at_same_place:
            kept_slices.append(header)
            numbers.append(values)
        elif np.array_equal(values, numbers[-1]):
            copies.append(name_of_slice(header))
        else:
            fault = (
                f"{name_of_slice(kept_slices[-1])} and {name_of_slice(header)} differ, but have the"
                " same position"
            )
            raise InputError(f"{path}: {fault}; are they two series, phases or energies? Keep one")
    if copies:
        notes.append(f"{len(copies)} copies of slices left out: {_names(copies)}")
    return kept_slices, numbers


def pixels(header: Any) -> Any:
    """Return the stored pixels of the file of a slice (frames, rows, columns).

    Raises:
        InputError: They are damaged, or their compression cannot be read.
    """
    import pydicom

    try:
        dataset = pydicom.dcmread(header.filename, force=True)
        if "TransferSyntaxUID" not in dataset.file_meta:
            dataset.file_meta.TransferSyntaxUID = pydicom.uid.ImplicitVRLittleEndian
        return _stored_bits(dataset, dataset.pixel_array).reshape(
            -1, int(header.Rows), int(header.Columns)
        )
    except Exception as error:  # damaged files let pydicom fail in any way
        raise InputError(f"{header.filename}: its pixels cannot be read: {error}") from None


def _stored_bits(dataset: Any, values: Any) -> Any:
    """Return pixels by their stored bits alone, without an overlay in the other bits.

    pydicom returns all bits of a pixel. Source: DICOM PS3.5, 8.1.1.
    """
    allocated_bits, stored_bits = int(dataset.BitsAllocated), int(dataset.BitsStored)
    spare = allocated_bits - stored_bits
    if values.dtype.kind not in "iu" or not 0 < spare < allocated_bits or allocated_bits == 1:
        return values
    above = allocated_bits - 1 - int(dataset.get("HighBit", stored_bits - 1))
    # The highest stored bit is moved to the highest one; its sign is then that of the number.
    return ((values << above) >> spare).astype(values.dtype)


def _numbers(header: Any, pixels: Any) -> Any:
    """Return the CT numbers (rows, columns) of a slice, by its slope and intercept.

    Raises:
        InputError: Its numbers are by a table.
    """
    if header.get("ModalityLUTSequence") and header.get("RescaleSlope") is None:
        fault = "gives CT numbers by a table (Modality LUT), which mantle does not support"
        raise InputError(f"{header.filename}: {fault}; {CONVERT}")
    slope, intercept = header.get("RescaleSlope"), header.get("RescaleIntercept")
    slope = np.float32(1 if slope is None else slope)
    stored_numbers = pixels[_frame(header) or 0]
    return slope * stored_numbers + np.float32(0 if intercept is None else intercept)


def _is_placed(header: Any) -> bool:
    """Return True if a slice has a position in the patient."""
    return all(header.get(key) is not None for key in PLACE_TAGS)


def name_of_slice(header: Any) -> str:
    """Name of the file of a slice, with the number of a frame."""
    frame = _frame(header)
    return Path(header.filename).name + ("" if frame is None else f" (frame {frame + 1})")


def _frame(header: Any) -> int | None:
    """Return the position of a frame in its file, from 0; None for a file of one slice."""
    return getattr(header, "frame", None)


def _names(names: Iterable[str]) -> str:
    """Return the first names of several, and the number of the others."""
    return shortened_list(names, MOST_NAMES)


def _described(header: Any) -> str:
    """Description of the series of a slice, in quotes."""
    description = str(header.get("SeriesDescription") or header.get("SeriesInstanceUID") or "?")
    return f"'{description}'"
