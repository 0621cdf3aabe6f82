"""``mantle explain``: names and keys."""

from __future__ import annotations

import pytest

from app.cli import main

FEMUR = """\
geometry.cement_thickness  (kind femur)
geometry.cement_thickness  (kind intact_femur)
geometry.cement_thickness  (kind patient)
  Thickness of the mantle where the canal has room, 1 to 8 mm: one value, or values by height
  and side. 0 mm: no cement. The stem is then in contact with the bone (interface stem_bone).
  value    length, at least 0 and at most 8, e.g. 4 mm; or section
  unit     mm
  default  4.0 mm
  keys     proximal, middle, distal, medial, anterior, lateral, posterior
  example  cement_thickness: 4 mm
"""


@pytest.mark.parametrize(
    ("word", "code", "parts"),
    [
        ("materials", 0, ["  PMMA              bone cement\n"]),
        ("loads", 0, ["\n  paper_stance     standing on one leg"]),
        (
            "cancellous_bone",
            0,
            ["cancellous_bone:\n  about: ", "Morgan 2003", "    thermal_expansion: 27.5e-6 1/K\n"],
        ),
        ("PMA", 2, ["PMMA"]),
        ("neck_angle", 0, ["angle, e.g. 130 deg\n", "  example  neck_angle: 130 deg\n"]),
        (
            "interfaces.kind",
            0,
            [f"{{kind: {k}}}\n" for k in ("bonded", "contact, friction_coefficient: 0.3")],
        ),
        ("regions.kind", 0, ["  {kind: rigid}\n    Rigid region: it moves as one body"]),
        ("friction", 0, ["interfaces.<name>.friction_coefficient ", "\n  friction coefficient: "]),
        ("slip", 0, ["  interfaces.slip_p99  ", "slip, p99 (mm), a result", "  slip: tangential"]),
        ("von Mises", 0, ["  regions.von_mises_p99  "]),
        ("contact pressure", 0, ["  interfaces.pressure_p95  "]),
        ("motion", 0, ["interfaces.motion_p99", "  motion: "]),
        ("gap", 0, ["interfaces.<name>.gap  (kind contact)", "\n  interfaces.gap_p99  "]),
        ("titanium", 0, ["  Ti-6Al-4V  "]),
        ("E", 0, ["regions.<name>.youngs_modulus  (kind isotropic)"]),
        ("body_weight", 0, ["hip 1800 N (3 body weights of 600 N)"]),
        ("", 0, ["\n  mesh  ", "Mesh size and order.", "\n  PMMA  ", "\n  walking  "]),
        ("geometry.cement_thickness", 0, [FEMUR]),
        *(
            (
                f"interfaces.{name}friction_coefficient",
                0,
                ["interfaces.<name>.friction_coefficient  (kind contact)"],
            )
            for name in ("", "stem_cement.")
        ),
        ("stages.0.increments", 0, ["stages[].increments\n"]),
        ("loads.library", 0, ["library: NAME"]),
        (
            "interfaces.frictoin",
            2,
            ["interfaces.frictoin: is not a key, kind, result or term of mantle; nearest: "],
        ),
    ],
)
def test_explain_names_and_keys(
    word: str, code: int, parts: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["explain", *word.split()]) == code
    printed = capsys.readouterr()[code // 2]
    assert all(part in printed for part in parts), printed
