"""Changes that make each shipped case small enough for a test."""

from __future__ import annotations

COARSE: dict[str, list[str]] = {
    "iso_7206_4.yaml": [
        "mesh.size=10 mm",
        "mesh.around=8",
        "output.error=false",
    ],
    "iso_7206_6.yaml": [
        "mesh.size=10 mm",
        "mesh.around=8",
        "output.error=false",
    ],
    "blocks.yaml": [
        "mesh.size=3 mm",
    ],
    "cylinders.yaml": [
        "mesh.size=2.5 mm",
        "mesh.far_size=5 mm",
    ],
    "stance.yaml": [
        "mesh.size=6 mm",
        "stages.0.increments=1",
        "output.error=false",
    ],
    "stance_cocr.yaml": [
        "mesh.size=6 mm",
        "stages.0.increments=1",
        "output.error=false",
    ],
    "pressed.yaml": [
        "mesh.size=10 mm",
        "mesh.around=16",
        "output.error=false",
    ],
    "collar.yaml": [
        "mesh.size=10 mm",
        "mesh.around=16",
        "output.error=false",
    ],
    "thin_femur.yaml": [
        "mesh.size=6 mm",
        "stages.0.increments=1",
        "output.error=false",
    ],
    "composite_intact.yaml": [
        "mesh.size=12 mm",
        "output.error=false",
    ],
    "composite_stem.yaml": [
        "mesh.size=12 mm",
        "output.error=false",
    ],
    "intact.yaml": [
        "mesh.size=6 mm",
        "output.error=false",
    ],
    "variations.yaml": [
        "mesh.size=4 mm",
        "mesh.far_size=6 mm",
    ],
    "thermal_100C.yaml": [
        "mesh.size=6 mm",
        "time.tolerance=0.2 K",
        "mesh.order=1",
    ],
    "thermal_rings.yaml": [
        "mesh.size=0.8 mm",
        "time.tolerance=0.02 K",
        "output.error=true",
    ],
    "cure.yaml": [
        "mesh.size=6 mm",
        "mesh.far_size=10 mm",
        "time.tolerance=0.2 K",
    ],
    "history.yaml": [
        "mesh.size=10 mm",
        "mesh.around=8",
        "mesh.order=1",
        "time.tolerance=0.2 K",
        "time.mechanical_step=100 K",
        "stages.2.cycles=3",
    ],
    "fatigue.yaml": [
        "mesh.size=10 mm",
        "mesh.around=8",
        "output.error=false",
        "stages.0.cycles=1",
        "stages.4.cycles=1",
    ],
    "day.yaml": [
        "mesh.size=12 mm",
        "mesh.around=8",
        "output.error=false",
        *(f"stages.{k}.cycles=1" for k in (0, 2, 4, 6, 8)),
    ],
    "debonding.yaml": [
        "mesh.size=10 mm",
        "mesh.around=8",
        "stages.0.increments=4",
    ],
    "remodelling.yaml": [
        "mesh.size=10 mm",
        "mesh.around=8",
        "mesh.order=1",
        "stages.1.increments=1",
    ],
    "creep_taper.yaml": [
        "mesh.size=8 mm",
        "variations={}",
    ],
    "life.yaml": [
        "mesh.size=10 mm",
        "mesh.around=8",
        "mesh.order=1",
        "time.tolerance=0.2 K",
        "time.mechanical_step=100 K",
    ],
    "interface_strength.yaml": [
        "mesh.size=10 mm",
        "mesh.around=8",
        "stages.0.increments=6",
    ],
    "head_cup.yaml": [
        "mesh.size=4 mm",
        "stages.1.increments=8",
        "motions.ball.largest_step=30 deg",
    ],
    "head_cup_heat.yaml": [
        "mesh.size=5 mm",
        "mesh.order=1",
        "stages.1.increments=8",
        "motions.ball.largest_step=30 deg",
        "time.tolerance=1 K",
    ],
    "head_cup_static.yaml": [
        "mesh.size=4 mm",
    ],
    "sliding_block.yaml": [
        "stages.1.increments=3",
    ],
    "walk.yaml": [
        "mesh.size=10 mm",
        "mesh.around=8",
        "stages.0.cycles=4",
    ],
    "residual.yaml": [
        "mesh.size=6 mm",
        "mesh.order=1",
        "time.tolerance=0.2 K",
        "time.mechanical_step=100 K",
        "stages.2.increments=1",
    ],
}
