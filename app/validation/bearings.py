"""Experiments on the bearing of a hip: friction and wear of a head in its cup."""

from __future__ import annotations

import math

import numpy as np

from app.foundation.arrays import Floats
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
        "rate22": PredictedQuantity.of_run(
            "wear under heads of 22 mm", "mm^3/million", wear, "head22", RATE
        ),
        "rate28": PredictedQuantity.of_run(
            "wear under heads of 28 mm", "mm^3/million", wear, "head28", RATE
        ),
        "ratio": PredictedQuantity.ratio(
            "wear under heads of 28 mm over that of 22 mm",
            wear,
            "head28",
            "head22",
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

# A head that rocks under a constant load

# Time at which the cycle begins: the stage before it has pressed the head into the cup.
CYCLE = 1.0


def _in_cycle(run: Results, column: str) -> Floats:
    """Values of a column in the steps of the cycle."""
    record = run.step_record
    return record[f"bearing {column}"][record["time [-]"] > CYCLE]


def mean_torque(run: Results) -> float:
    """Mean size of the friction torque through the cycle [N m]."""
    return float(_in_cycle(run, "torque_size [N mm]").mean() / 1e3)


def offset(run: Results) -> float:
    """Mean angle between the load and the direction in which the head moves into the cup [deg]."""
    x, y, z = (_in_cycle(run, f"centre.{axis} [mm]") for axis in "xyz")
    return float(np.degrees(np.arctan2(np.hypot(x, y), z)).mean())


def _exponent(first: float, second: float, ratio: float) -> float:
    """Exponent of the power of a ratio by which a number grows."""
    return math.log(second / first) / math.log(ratio)


COULOMB = (
    "Outside of the band friction is not Coulomb's with the friction factors of other simulators."
)
SIZES = (22, 44)
ROCKING_TORQUE = Experiment(
    name="rocking_torque",
    title="Friction torque of polyethylene cups by head size and load, rocking",
    blind=True,
    quantities={
        **{
            f"torque{size}": PredictedQuantity.of_run(
                f"mean friction torque of a head of {size} mm at 2,450 N",
                "N m",
                mean_torque,
                f"size{size}",
                COULOMB,
            )
            for size in SIZES
        },
        "size_exponent": PredictedQuantity(
            "exponent of the head's diameter in the torque, 22 to 44 mm",
            "-",
            lambda runs: _exponent(
                mean_torque(runs["size22"]), mean_torque(runs["size44"]), 44 / 22
            ),
            "Outside of the band the friction factor depends on the size of the head: lubrication.",
        ),
        "load_exponent": PredictedQuantity(
            "exponent of the load in the torque, 500 to 2,450 N, head of 44 mm",
            "-",
            lambda runs: _exponent(
                mean_torque(runs["light44"]), mean_torque(runs["size44"]), 2450 / 500
            ),
            "Below the band the friction factor falls with the load, as in mixed lubrication.",
        ),
        "offset": PredictedQuantity.of_run(
            "angle by which friction moves the middle of the contact off the load, head of 44 mm",
            "deg",
            offset,
            "size44",
            COULOMB,
        ),
    },
)

# The cycle of ISO 14242-1

# Direction of the taper's axis: along the neck, in the frontal plane, at 45 degrees to the load.
TAPER = np.array([-1.0, 0.0, -1.0]) / math.sqrt(2.0)


def largest_torque(run: Results) -> float:
    """Largest size of the friction torque in the cycle [N m]."""
    return float(_in_cycle(run, "torque_size [N mm]").max() / 1e3)


def taper_torque(run: Results) -> float:
    """Largest torque about the taper's axis in the cycle [N m]."""
    torque = np.stack([_in_cycle(run, f"torque.{axis} [N mm]") for axis in "xyz"], axis=1)
    return float(np.abs(torque @ TAPER).max() / 1e3)


def time_of_largest(run: Results) -> float:
    """Part of the cycle at which the friction torque is largest [%]."""
    largest = int(np.argmax(_in_cycle(run, "torque_size [N mm]")))
    time = run.step_record["time [-]"]
    return float(100 * (time[time > CYCLE][largest] - CYCLE))


SIMULATOR_TORQUE = Experiment(
    name="simulator_torque",
    title="Friction torque of crosslinked cups in a simulator by head size",
    blind=True,
    quantities={
        **{
            f"{name}{size}": PredictedQuantity.of_run(
                f"largest {words} of a head of {size} mm",
                "N m",
                number,
                f"size{size}",
                COULOMB,
            )
            for name, words, number in (
                ("torque", "friction torque", largest_torque),
                ("taper", "torque about the taper's axis", taper_torque),
            )
            for size in (28, 40)
        },
        "ratio": PredictedQuantity.ratio(
            "largest friction torque of a head of 40 mm over that of 28 mm",
            largest_torque,
            "size40",
            "size28",
            "Outside of the band the friction factor depends on the size of the head: lubrication.",
        ),
        "time": PredictedQuantity.of_run(
            "part of the cycle at which the friction torque of a head of 28 mm is largest",
            "%",
            time_of_largest,
            "size28",
            "Outside of the band friction follows speed or film thickness, not the force. The two "
            "peaks of the force, at 12 and 50 %, have nearly the same friction here.",
        ),
    },
)
