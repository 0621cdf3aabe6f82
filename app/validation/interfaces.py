"""Experiments on the hold of a stem in cement: push-out, torsion."""

from __future__ import annotations

from app.results.reading import Results
from app.validation.experiment import Experiment, PredictedQuantity


def shear_strength(run: Results) -> float:
    """Force along the stem over the area of its interface [MPa]."""
    numbers = run.summary["interfaces"]["stem_cement"]
    return float(abs(numbers["force"][2]) / numbers["area"])


PUSH_OUT = Experiment(
    name="push_out",
    title="Push-out of titanium dowels from cement",
    blind=True,
    quantities={
        "clean": PredictedQuantity(
            "apparent shear strength of the smooth clean dowel by shrinkage and friction alone",
            "MPa",
            lambda runs: shear_strength(runs["clean"]),
            "Above the band adhesion or interlock adds to friction; below it the cement swells or "
            "lies against the tube, and does not grip.",
        ),
        "lubricated": PredictedQuantity(
            "strength of a lubricated smooth dowel over that of a clean one",
            "-",
            lambda runs: shear_strength(runs["lubricated"]) / shear_strength(runs["clean"]),
            "Below the band a lubricant also prevents that cement wets the metal; above it no film "
            "is left between them.",
        ),
        "rough": PredictedQuantity(
            "strength of the rough dowel by friction alone, without interlock",
            "MPa",
            lambda runs: shear_strength(runs["rough"]),
            "A measured strength inside the band means that interlock adds nothing.",
        ),
        "smooth_over_rough": PredictedQuantity(
            "strength of the smooth clean dowel over that of the rough one, both by friction",
            "-",
            lambda runs: shear_strength(runs["clean"]) / shear_strength(runs["rough"]),
            "Below the band the rough dowel holds by interlock, which is not modelled.",
        ),
    },
)
