"""Lines on the notes of a mesh."""

from __future__ import annotations

from app.soundness import mesh_notes


def test_mesh_notes_on_the_cement() -> None:
    note = {
        "thickness": {
            **{"nominal": 4.0, "min": 1.591, "p5": 1.8, "median": 2.95, "mean": 3.05},
            **{"p95": 4.08, "max": 4.81, "clipped_fraction": 0.6102},
        },
        "volume": 20069.8,
        "plug_volume": 1238.4,
        "cortex_min": 2.017,
    }
    assert list(mesh_notes.lines_of_mesh_notes({"mantle": note})) == [
        "cement mantle: 1.59 to 4.81 mm thick (given: 4 mm), mean 3.05, median 2.95, "
        "5th and 95th percentile 1.80 and 4.08 mm; the canal makes it thinner on 61 % of the stem; "
        "20,070 mm³ of cement, 1,238 of them below the stem",
        "cortex from the tip up to z = 0: at least 2.02 mm, normal to its surface",
    ]


def test_mesh_notes_on_layers() -> None:
    note = {
        "lines_around": 36,
        "steps_along": 44,
        "cells_through": [2, 2, 1],
        "least_thickness_mm": 0.0872,
        "moved_nodes": 0.4214,
        "moved_max_mm": 0.333,
    }
    assert list(mesh_notes.lines_of_mesh_notes({"layers": note})) == [
        "layers: 36 lines around, 44 steps along, 2, 2, 1 cells through the layers from inside; "
        "the thinnest layer has 0.09 mm; 42 % of their nodes were moved to keep layers thick "
        "enough, by at most 0.33 mm"
    ]
    (line,) = mesh_notes.lines_of_mesh_notes({"layers": note | {"moved_nodes": 0.0}})
    assert line.endswith("; no node had to be moved")


def test_mesh_notes_on_quality_and_sizes() -> None:
    quality = {
        "cells": 39466,
        "nodes": 56652,
        "sicn_min": 0.0288,
        "sicn_median": 0.3579,
        "sicn_below_0.1": 1289,
        "sicn_min_by_region": {"stem": 0.0685, "cement": 0.0822},
    }
    notes = {
        "quality": quality,
        "head_centre": [43.0, -1.2e-15, 58.6039],
        "volumes_mm3": {"stem": 20639.1},
        "interface_areas_mm2": {},
        "messages": ["a note of the run"],
    }
    assert list(mesh_notes.lines_of_mesh_notes(notes)) == [
        "centre of the stem's head: (43, 0, 58.6) mm",
        "quality (SICN; 1 is a regular tetrahedron): median 0.36, least 0.03 (stem 0.07, cement "
        "0.08); 1,289 of 39,466 cells have less than 0.1",
        "volumes (mm³): stem 20,639",
    ]


def test_mesh_notes_of_other_meshers_are_listed() -> None:
    assert list(mesh_notes.lines_of_mesh_notes({"seed_points": 12})) == ["seed points: 12"]
