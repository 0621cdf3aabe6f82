"""Notes on a patient's bone and on its image."""

from __future__ import annotations

from collections.abc import Iterable

from app.case.case import Case
from app.foundation.verdict import Verdict, note
from app.patient.geometry import Patient
from app.patient.image_modulus import ImageModulus
from app.soundness.preview import input_note
from meshes.placement import lengthening

# Change of the leg length above which a note is given [mm]: patients notice it.
DIFFERENT_LEG = 10.0


@input_note
def _bone(case: Case) -> Iterable[Verdict]:
    """Notes on a rare size or shape of the bone, on an open end, and on a continued shaft."""
    if isinstance(case.geometry, Patient):
        for note_text in case.geometry.femur.notes:
            yield note(note_text, "geometry.bone")
        for name, note_text in case.geometry.femur.frame.given_doubts:
            yield note(note_text, f"geometry.landmarks.{name}")
        side_doubt = case.geometry.femur.side_doubt
        if case.geometry.bone.image and side_doubt:
            side = case.geometry.femur.frame.side
            yield note(
                f"the landmarks are those of a {side} femur, but {side_doubt}",
                "geometry.bone.image",
            )
        longer = lengthening(case.geometry)
        if abs(longer) > DIFFERENT_LEG:
            word = "longer" if longer > 0 else "shorter"
            yield note(
                f"the leg becomes {abs(longer):.0f} mm {word}",
                "geometry.stem.head_height",
                "change head_height, insertion.depth or resection.height",
            )
        end_level, continuation = case.geometry.continued_below, case.geometry.femur.continuation
        if end_level is not None and continuation:
            yield note(
                f"the scan ends at z = {continuation.scan_end:.0f} mm; the bone below z ="
                f" {end_level:.0f} mm is not the patient's, but continues the last sections",
                "geometry.bone.extend",
            )


@input_note
def _images(case: Case) -> Iterable[Verdict]:
    """Notes on implausible numbers of images; each once, where several regions have one image."""
    fields = [region.modulus_field for region in case.regions.values() if region.modulus_field]
    texts = [
        text
        for field in fields
        if isinstance(field, ImageModulus)
        for text in field.doubts(case.geometry)
    ]
    for text in dict.fromkeys(texts):
        yield note(text)
