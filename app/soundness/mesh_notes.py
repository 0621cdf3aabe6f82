"""Lines on a mesh: its cement, layers, quality, volumes and areas, from the notes of its mesher."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from app.case.summary import MantleNumbers
from app.foundation.layout import count, percent, plain_text, point_text

# Notes that have no line: messages are notes of the run, the others repeat a message.
WITHOUT_LINE = ("messages", "cells_without_region")


def lines_of_mesh_notes(notes: Mapping[str, Any]) -> Iterator[str]:
    """Lines on the notes of a mesh (`meshes.data.MeshData.notes`)."""
    other_notes = {name: note for name, note in notes.items() if name not in WITHOUT_LINE and note}
    if "mantle" in other_notes:
        mantle: MantleNumbers = other_notes.pop("mantle")
        yield _mantle(mantle)
        if "cortex_min" in mantle:
            yield _cortex(mantle["cortex_min"])
    if "cortex_min" in other_notes:
        yield _cortex(other_notes.pop("cortex_min"))
    if "head_centre" in other_notes:
        yield f"centre of the stem's head: {point_text(other_notes.pop('head_centre'))}"
    if "layers" in other_notes:
        yield _layers(other_notes.pop("layers"))
    if "quality" in other_notes:
        yield _quality(other_notes.pop("quality"))
    sizes = {
        "volumes_mm3": "volumes (mm³)",
        "boundary_areas_mm2": "areas of boundaries (mm²)",
        "interface_areas_mm2": "areas of interfaces (mm²)",
    }
    for key, size_words in sizes.items():
        if key in other_notes:
            sizes_by_name = other_notes.pop(key).items()
            sizes_text = ", ".join(f"{name} {count(size)}" for name, size in sizes_by_name)
            yield f"{size_words}: {sizes_text}"
    for name, note in other_notes.items():
        yield f"{name.replace('_', ' ')}: {plain_text(note)}"


def _mantle(note: MantleNumbers) -> str:
    """A line on the thickness of the cement."""
    t = note["thickness"]
    return (
        f"cement mantle: {t['min']:.2f} to {t['max']:.2f} mm thick (given: {t['nominal']:.3g} mm), "
        f"mean {t['mean']:.2f}, median {t['median']:.2f}, 5th and 95th percentile {t['p5']:.2f} "
        f"and {t['p95']:.2f} mm; the canal makes it thinner on "
        f"{100 * t['clipped_fraction']:.0f} % of the stem; {count(note['volume'])} mm³ of cement, "
        f"{count(note['plug_volume'])} of them below the stem"
    )


def _cortex(thickness: float) -> str:
    """A line on the least thickness of the cortex [mm]."""
    return f"cortex from the tip up to z = 0: at least {thickness:.2f} mm, normal to its surface"


def _layers(note: Mapping[str, Any]) -> str:
    """A line on the grid of a layered mesh (`meshes.swept.Swept.describe`)."""
    through = ", ".join(str(cells) for cells in note["cells_through"])
    moved_text = (
        f"{percent(note['moved_nodes'])} of their nodes were moved to keep layers thick enough, by "
        f"at most {note['moved_max_mm']:.2f} mm"
        if note["moved_nodes"]
        else "no node had to be moved"
    )
    thinnest = f"{note['least_thickness_mm']:.2f} mm"
    return (
        f"layers: {note['lines_around']} lines around, {note['steps_along']} steps along, "
        f"{through} cells through the layers from inside; the thinnest layer has {thinnest}; "
        f"{moved_text}"
    )


def _quality(note: Mapping[str, Any]) -> str:
    """A line on the quality of the cells (`meshes.quality.notes_on_quality`)."""
    regions = ", ".join(
        f"{name} {smallest_sicn:.2f}" for name, smallest_sicn in note["sicn_min_by_region"].items()
    )
    return (
        f"quality (SICN; 1 is a regular tetrahedron): median {note['sicn_median']:.2f}, least "
        f"{note['sicn_min']:.2f} ({regions}); {count(note['sicn_below_0.1'])} of "
        f"{count(note['cells'])} cells have less than 0.1"
    )
