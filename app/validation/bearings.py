"""Experiments on the bearing of a hip: friction and wear of a head in its cup."""

from __future__ import annotations

from app.results.reading import Results
from app.validation.experiment import Experiment, PredictedQuantity


def wear(run: Results) -> float:
    """Volume worn off in a million cycles [mm^3]."""
    return float(run.summary["interfaces"]["bearing"]["wear_volume_million"])


RATE = (
    "Outside of the band the wear factor of this material and serum is not that of the range, or "
    "wear does not follow pressure times sliding distance."
)
WEAR_SIZE = Experiment(
    name="wear_size",
    title="Wear of polyethylene cups by head size",
    blind=True,
    quantities={
        "rate22": PredictedQuantity(
            "wear under heads of 22 mm", "mm^3/million", lambda runs: wear(runs["head22"]), RATE
        ),
        "rate28": PredictedQuantity(
            "wear under heads of 28 mm", "mm^3/million", lambda runs: wear(runs["head28"]), RATE
        ),
        "ratio": PredictedQuantity(
            "wear under heads of 28 mm over that of 22 mm",
            "-",
            lambda runs: wear(runs["head28"]) / wear(runs["head22"]),
            "Outside of the band wear depends on pressure or on the directions of sliding, not "
            "only on force times sliding distance.",
        ),
        "growth": PredictedQuantity(
            "growth of wear from 22 to 28 mm, in percent of that of 22 mm for each mm",
            "%/mm",
            lambda runs: 100 * (wear(runs["head28"]) / wear(runs["head22"]) - 1) / 6,
            "As for the ratio.",
        ),
    },
)
