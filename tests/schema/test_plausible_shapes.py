"""Shapes that no hip has, and lengths that no mesh has: refused with key, place and limit."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from app.case.case import load
from app.cli import main
from app.errors import InputError

HIP = """\
geometry:
  kind: {kind}
  {key}: {value}
mesh: {{size: 6 mm, order: 1}}
regions:
  cortical_bone: {{youngs_modulus: 17 GPa, poisson_ratio: 0.3}}
  cancellous_bone: {{youngs_modulus: 1 GPa, poisson_ratio: 0.3}}
{more}supports: {{shaft: {{kind: fixed, boundary: distal_cut}}}}
loads: {{pull: {{kind: pressure, boundary: bone_surface, pressure: 1 MPa}}}}
"""
IMPLANT = """\
  stem: {youngs_modulus: 200 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: bonded}
"""
# What is asked for, the key that is blamed, the limit in the message; by the default femur: head at
# (43, 54), tip at -118, cut at 5 + 24.747 tan 38 = 24.33 mm on the axis.
IMPOSSIBLE = [
    ("stem_length", "250 mm", "stem_length", "at most 172 mm"),
    ("stem_tip_z", "-80 mm", "stem_length", "at most 134 mm"),
    ("head_height", "27 mm", "stem_length", "at most 145 mm"),
    # 1.5 (58 + 24.747 tan 38) mm.
    ("resection_height", "-60 mm", "stem_length", "at most 116 mm"),
    ("distal_cut_z", "-100 mm", "distal_cut_z", "below -128 mm"),
    ("distal_cut_z", "-900 mm", "distal_cut_z", "at least -350 mm"),
    ("neck_diameter", "0.1 mm", "neck_diameter", "at least 5 mm"),
    ("neck_diameter", "24 mm", "neck_diameter", "at most 18.2 mm"),
    ("trunnion_diameter", "60 mm", "trunnion_diameter", "at most 22 mm"),
    ("head_offset", "1 mm", "head_offset", "at least 20 mm"),
    ("head_height", "150 mm", "head_height", "at most 100 mm"),
    ("neck_angle", "160 deg", "neck_angle", "between 100 and 145 deg"),
    ("canal_widening", "12 mm", "canal_widening", "at most 5 mm"),
]  # fmt: skip


@pytest.mark.parametrize("kind", ["femur", "intact_femur"])
@pytest.mark.parametrize(("key", "value", "blamed", "limit"), IMPOSSIBLE)
def test_no_hip_is_like_that(
    kind: str, key: str, value: str, blamed: str, limit: str, tmp_path: Path
) -> None:
    path = tmp_path / "case.yaml"
    more = IMPLANT if kind == "femur" else ""
    path.write_text(HIP.format(kind=kind, key=key, value=value, more=more))
    with pytest.raises(InputError) as caught:
        load(path)
    (message,) = caught.value.messages
    line = 3 if key == blamed else 1
    assert re.match(rf"{re.escape(str(path))}:{line}:\d+: geometry\.{blamed}: ", message)
    assert limit in message


@pytest.mark.parametrize("kind", ["femur", "intact_femur"])
def test_a_femur_that_is_made_here_is_a_left_one(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    more = IMPLANT if kind == "femur" else ""
    text = HIP.format(kind=kind, key="canal_widening", value="1 mm", more=more)
    path.write_text(f"{text.rstrip()}\nside: left\n")
    load(path)
    path.write_text(f"{text.rstrip()}\nside: right\n")
    with pytest.raises(InputError) as caught:
        load(path)
    (message,) = caught.value.messages
    line = len(text.rstrip().splitlines()) + 1
    assert message.startswith(f"{path}:{line}:1: side: the geometry ({kind}) is a left femur;")
    assert "expected left" in message


def test_what_only_the_mesher_sees_has_its_place_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stem whose shoulder is buried: where bone is, is known to the mesher."""
    path = tmp_path / "case.yaml"
    path.write_text(HIP.format(kind="femur", key="stem_length", value="136 mm", more=IMPLANT))
    for command in (["check", "--mesh"], ["run", "-o", str(tmp_path / "out")], ["mesh"]):
        assert main([command[0], str(path), *command[1:]]) == 3
        assert f"{path}:3:3: geometry.stem_length: the stem's shoulder" in capsys.readouterr().err


ROD = """\
geometry:
  kind: cylinders
  stem_radius: {stem} mm
  cement_thickness: {cement} mm
  bone_thickness: {bone} mm
  length: {length} mm
  taper: {taper} deg
mesh: {{size: 3 mm, order: 1}}
regions:
  stem: {{youngs_modulus: 200 GPa, poisson_ratio: 0.3}}
  cement: {{youngs_modulus: 2 GPa, poisson_ratio: 0.3}}
  bone: {{youngs_modulus: 17 GPa, poisson_ratio: 0.3}}
supports: {{base: {{kind: fixed, boundary: bone_surface}}}}
loads: {{push: {{kind: pressure, boundary: stem_top, pressure: 1 MPa}}}}
"""


@pytest.mark.parametrize(
    ("changes", "line", "key", "limits"),
    [
        ({"stem": 1}, 3, "stem_radius", ("1.5 mm", "2 mm")),
        # 10 tan 8 deg = 1.405 mm less at the narrow end.
        ({"stem": 2, "taper": 8}, 3, "stem_radius",
         ("1.5 mm", f"{2 * (2 - 10 * math.tan(math.radians(8))):.3g} mm")),
        ({"cement": 0.01}, 4, "cement_thickness", ("0.15 mm", "0.2 mm")),
        ({"bone": 0.1}, 5, "bone_thickness", ("0.15 mm", "2 mm")),
        ({"length": 0.01}, 6, "length", ("0.12 mm", "0.25 mm")),
    ],
)  # fmt: skip
def test_lengths_that_no_mesh_of_this_size_has(
    changes: dict[str, float], line: int, key: str, limits: tuple[str, str], tmp_path: Path
) -> None:
    """Beyond them gmsh failed, ended the process, or told to repair the mesh file."""
    values = {"stem": 7, "cement": 4, "bone": 6, "length": 20, "taper": 0} | changes
    path = tmp_path / "case.yaml"
    path.write_text(ROD.format(**values))
    with pytest.raises(InputError) as caught:
        load(path)
    (message,) = caught.value.messages
    assert message.startswith(f"{path}:{line}:3: geometry.{key}: ")
    least, largest = limits
    assert f"expected at least {least}, or a mesh.size of at most {largest}" in message


def test_a_thin_block_is_named(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(
        "geometry:\n  kind: blocks\n  blocks:\n"
        "    - {name: a, size: [10 mm, 10 mm, 10 mm]}\n"
        "    - {name: b, size: [10 mm, 10 mm, 0.01 mm]}\n"
        "mesh: {size: 3 mm, order: 1}\n"
        "regions:\n"
        "  a: {youngs_modulus: 200 GPa, poisson_ratio: 0.3}\n"
        "  b: {youngs_modulus: 2 GPa, poisson_ratio: 0.3}\n"
        "supports: {base: {kind: fixed, boundary: bottom}}\n"
        "loads: {push: {kind: pressure, boundary: top, pressure: 1 MPa}}\n"
    )
    with pytest.raises(InputError, match=r"case.yaml:5:\d+: geometry.blocks\[1\].size: .*0.12 mm"):
        load(path)
