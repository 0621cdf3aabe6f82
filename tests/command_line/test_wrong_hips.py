"""Wrong hips of patients: `mantle check` exits with 2 and says what, where, and what to do.

Stems from CAD are in `test_cad_stem`.
"""

from __future__ import annotations

import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.cli import main
from app.foundation.arrays import Floats
from app.patient.bone_surface import BoneSurface
from tests.patient.bones import (
    moved,
    opened,
    parametric_canal,
    parametric_femur,
    slices,
    tube,
    write,
)

EYE = np.eye(3)
ZERO = np.zeros(3)
PLACE = r"\(-?\d+, -?\d+, -?\d+\) mm"


def without(s: BoneSurface, near: tuple[float, float, float], radius: float) -> BoneSurface:
    """A surface with a hole."""
    far = np.linalg.norm(s.corners.mean(axis=1) - near, axis=1) > radius
    return BoneSurface(s.points, s.triangles[far])


def with_body(s: BoneSurface, x: Floats, triangles: Any) -> BoneSurface:
    """A surface with more triangles, whose corners are numbered after those of the surface."""
    points = np.concatenate([s.points, x])
    return BoneSurface(points, np.concatenate([s.triangles, triangles]))


def finned(s: BoneSurface) -> BoneSurface:
    a, b, _ = s.triangles[np.abs(s.corners.mean(axis=1)[:, 2] + 60.0).argmin()]
    return with_body(s, s.points[[a]] + 5.0, [[a, b, len(s.points)]])


def twice(s: BoneSurface) -> BoneSurface:
    return with_body(s, s.points + np.array([200.0, 0, 0]), s.triangles + len(s.points))


def headless() -> BoneSurface:
    """A femur that is cut across the neck and closed at the cut."""
    s, turn = parametric_femur(), np.radians(15.0)
    head = np.array([43 * np.cos(turn), 43 * np.sin(turn), 54.0])
    beyond = s.points @ head / np.linalg.norm(head) > np.linalg.norm(head) - 21.0
    kept = s.triangles[~beyond[s.triangles].any(axis=1)]
    ends = kept[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, first, times = np.unique(np.sort(ends), axis=0, return_index=True, return_counts=True)
    rim = ends[first[times == 1]]
    cap = np.column_stack([rim[:, ::-1], np.full(len(rim), len(s.points))])
    return with_body(BoneSurface(s.points, kept), s.points[rim].mean(axis=(0, 1))[None], cap)


def tibia() -> BoneSurface:
    """A shaft with a plateau of 76 by 50 mm."""
    z, t = np.linspace(0, 360, 181)[:, None], 2 * np.pi * np.arange(48) / 48
    wide = np.interp(z, [0, 30, 80, 250, 330, 360], [24, 20, 12, 14, 34, 38])
    deep = np.interp(z, [0, 30, 80, 250, 330, 360], [20, 17, 11, 15, 24, 25])
    x, y = wide * np.cos(t), deep * np.sin(t)
    return tube(np.stack([x, y, np.broadcast_to(z, x.shape)], axis=2))


def bent(axis: int, far: float, centre: Any, size: Any) -> BoneSurface:
    """A femur that is pushed through itself along an axis."""
    x = parametric_femur().points.copy()
    x[:, axis] += far * np.exp(-(((x - centre) / size) ** 2).sum(axis=1))
    return BoneSurface(x, parametric_femur().triangles)


def change(**keys: str) -> dict[str, dict[str, str]]:
    return {"resection": {"angle": "10 deg"}, "canal": {"ream": "broach"}, "stem": keys}


BONES: dict[str, tuple[BoneSurface | bytes, str]] = {
    "hole": (
        without(parametric_femur(), (15.0, 0.0, -60.0), 8.0),
        f"open at {PLACE} .*, not at an end; repair",
    ),
    "fin": (
        finned(parametric_femur()),
        f"2 bodies; the largest have 5,056 and 1 triangles, the second is at {PLACE}",
    ),
    "two": (
        twice(parametric_femur()),
        f"2 bodies; .* at {PLACE} in the file; keep the femur",
    ),
    "inch": (
        moved(parametric_femur(), EYE / 25.4, ZERO),
        "13.27 units long, .* set its unit to cm or inch",
    ),
    "tibia": (tibia(), f"no head at either end: .* sphere, at {PLACE} .* femur with its head"),
    "distal half": (
        opened(moved(parametric_femur(), -EYE, ZERO), 70.0),
        f"no lesser .* {PLACE}.* proximal",
    ),
    "headless": (headless(), f"no lesser trochanter .* {PLACE} .*; expected a proximal femur"),
    "dented": (bent(0, 60.0, (-14, 0, -70), 9.0), f"bone at {PLACE}.* crosses itself"),
    "folded": (bent(2, 25.0, (0, 0, -70), (9e9, 9e9, 10.0)), f"than once, near {PLACE}"),
    "empty": (b"", "empty.stl: is empty"),
    "cut off": (
        b"\0" * 80 + b"\x10\0\0\0" + b"\0" * 99,
        "has 1 of the 16 triangles in its header",
    ),
    "text cut off": (
        b"solid x facet outer loop vertex 0 0",
        "no `endsolid` after 0 facets; is the file cut short",
    ),
    "no triangles": (b"solid x\nendsolid x", "has no triangles"),
    "nan": (
        b"solid x\nfacet normal 0 0 1 outer loop vertex 0 0 nan vertex 1 0 0 vertex 0 1 0"
        b" endloop endfacet\nendsolid",
        "corners that are not numbers",
    ),
}
CANALS = {
    "outside": (
        moved(parametric_canal(), np.diag([2.3, 2.3, 1]), ZERO),
        f"outside the bone at {PLACE}",
    ),
    "elsewhere": (
        moved(parametric_canal(), EYE, np.array([90.0, 0, 0])),
        "90 mm from .* axes of the bone",
    ),
    "short": (
        moved(parametric_canal(), np.diag([1, 1, 0.5]), np.array([0, 0, -20.0])),
        f"ends at {PLACE}",
    ),
    "with a hole": (without(parametric_canal(), (12.0, 0.0, -60.0), 8.0), f"open at {PLACE}"),
}
KEYS: dict[str, tuple[dict[str, Any], str]] = {
    "no file": ({"bone": {"surface": "none.stl"}}, "no such file"),
    "no bone": ({"bone": {"image": "bone.stl"}}, "expected `surface`, or `image` and `label`"),
    "no image": ({"bone": {"image": "bone.stl", "label": 1}}, "cannot be read as an image|needs"),
    "gantry": ({"bone": {"image": "tilted", "label": 1}}, "tilted: .* gantry tilted|needs"),
    "metre": ({"bone": {"surface": "bone.stl", "unit": "m"}}, "337 m long, .* set its unit to mm"),
    "side": ({"bone": {"surface": "bone.stl", "side": "right"}}, "14 mm behind the axis of a left"),
    "no end": ({"distal_cut_z": "-400 mm"}, "between the end of the surface"),
    "no condyles": ({"insertion": {"version": {"relative_to": "condyles"}}}, "relative_to: neck"),
    "too long": (
        {"stem": {"length": "300 mm"}, "bone": {"surface": "bone.stl", "extend": False}},
        "plug's end at z = -277 mm, but the bone ends at -26. mm: .* mm of bone are missing",
    ),
    "too long to search": (
        {
            "stem": {"length": "300 mm"},
            "bone": {"surface": "bone.stl", "extend": False},
            "canal": {"surface": "whole canal.stl"},
            "insertion": "best",
        },
        "geometry.stem.length: .* the bone ends at -26. mm: .* geometry.bone.extend: true",
    ),
    "too short": (
        {"stem": {"length": "50 mm", "corner_radius": "4 mm", "tip_corner_radius": "2 mm"}},
        "leaves 42 mm of the stem below the cut; expected at least 50",
    ),
    "too wide": (
        {"stem": {"half_width": "16 mm", "neck_diameter": "12 mm"}},
        f"1.3 mm into the cortex medially at {PLACE}, 65 mm below the cut; ream",
    ),
    "corner": ({"stem": {"corner_radius": "6 mm"}}, "half-depth, 5 mm"),
    "void": ({"tip_void": "9.5 mm"}, "less than 1 mm of plug_length, 10 mm"),
    "valgus neck": ({"stem": {"neck_angle": "150 deg"}}, "between 100 and 145 deg"),
    "too thick": ({"cement_thickness": "12 mm"}, "at most 8 mm"),
    "no room": ({"stem": {"tip_half_width": "6 mm"}}, f"the cortex laterally at {PLACE}"),
    "deep": ({"insertion": {"depth": "15 mm"}}, "at most 14 mm"),
    "proud": ({"insertion": {"depth": "-60 mm"}}, "leaves 80 mm of the stem .* 98 mm"),
    "shoulder": (
        change() | {"insertion": {"depth": "8 mm"}},
        f"into the cortex medially at {PLACE}, 0 mm below the cut",
    ),
    "neck": (change(head_height="1 mm"), "1 mm above the shoulder, does not clear .* raise"),
    "fossa": (
        {"resection": {"angle": "45 deg", "height": "10 mm"}},
        f"for cement .least: 1 mm. laterally at {PLACE}, 0 mm below the cut",
    ),
    "steep": ({"resection": {"angle": "60 deg", "height": "20 mm"}}, f"outside .* at {PLACE}"),
    "high": ({"resection": {"height": "120 mm"}}, "outside the bone 120 mm above .*; cut lower"),
    "varus": ({"insertion": {"varus": "4 deg"}}, rf"into the cortex \w*-?laterally at {PLACE}"),
    "more varus": ({"insertion": {"varus": "6 deg"}}, f"outside the bone at {PLACE}, 139 mm"),
    "most varus": ({"insertion": {"varus": "20 deg"}}, "at most"),
}


WRONG = KEYS | {
    name: ({key: {"surface": f"{name}.stl"}}, words)
    for key, rows in (("bone", BONES), ("canal", CANALS))
    for name, (_, words) in rows.items()
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("wrong")
    for name, (surface, _) in {
        "bone": (parametric_femur(), ""),
        "whole canal": (parametric_canal(), ""),
        **BONES,
        **CANALS,
    }.items():
        file = path / f"{name}.stl"
        file.write_bytes(surface) if isinstance(surface, bytes) else write(file, surface)
    with suppress(ModuleNotFoundError):
        slices(path / "tilted", np.ones((4, 4, 4)), np.eye(4) + 0.2 * np.eye(4, k=1))
    return path


def written(folder: Path, changes: dict[str, Any], mesh: str = "{}") -> Path:
    geometry = json.dumps({"kind": "patient", "bone": {"surface": "bone.stl"}} | changes)
    case, loads = folder / "case.yaml", "{library: one_leg_stance}"
    case.write_text(f"base: stance\ngeometry: {geometry}\nmesh: {mesh}\nloads: {loads}\n")
    return case


def test_wrong_hips_sound_hip_is_reported(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(written(folder, {}, "{size: 6 mm, around: 14}"))]) == 0
    assert "cells through cement, cancellous and cortical bone" in capsys.readouterr().out


@pytest.mark.parametrize("name", WRONG)
def test_wrong_hips_are_refused(
    name: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changes, words = WRONG[name]
    case = written(folder, changes)
    assert main(["check", str(case)]) == 2
    printed = capsys.readouterr().err
    assert printed.startswith(f"{case}:2:") and printed.count("\n") == 1
    assert re.search(words, printed), printed


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (
            "geometry.side=right",
            r"^--set geometry\.side: unknown key; expected geometry\.bone\.side$",
        ),
        (
            "geometry.stem.length=40 mm",
            r":2:\d+: geometry\.stem\.half_width: .*; does it fit --set geometry\.stem\.length\?",
        ),
    ],
)
def test_wrong_hips_override_is_named(
    override: str, words: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The option contradicts keys of the file."""
    case = written(folder, {"stem": {"length": "147 mm", "half_width": "8.5 mm"}})
    assert main(["check", str(case), "--set", override]) == 2
    printed = capsys.readouterr().err.strip()
    assert re.search(words, printed), printed


def test_wrong_hips_value_of_a_base_names_the_changes_of_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The length of the file contradicts the widths of the base."""
    case = tmp_path / "short.yaml"
    case.write_text("base: pressed\ntitle: Short\ngeometry: {stem: {length: 40 mm}}\n")
    assert main(["check", str(case)]) == 2
    place = rf"geometry\.stem\.length \({re.escape(str(case))}:3:19\)"
    words = rf"pressed\.yaml:\d+:5: geometry\.stem\.half_width: .*; does it fit {place}\?$"
    printed = capsys.readouterr().err.strip()
    assert re.search(words, printed), printed
