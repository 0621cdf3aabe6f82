"""Experiments on cement alone: heat of setting, residual stress, creep."""

from __future__ import annotations

import numpy as np

from app.foundation.arrays import Floats
from app.results.reading import Results
from app.validation.experiment import Experiment, PredictedQuantity

# Discs that set in moulds

# Temperature of the room in which a disc sets [degC].
ROOM = 23.0


def peak(run: Results) -> float:
    """Highest temperature in the centre of a disc [degC]."""
    return float(run.step_record["centre [degC]"].max())


def setting(run: Results) -> float:
    """Setting time: the centre is halfway from room temperature to its peak (ISO 5833) [s]."""
    centre = run.step_record["centre [degC]"]
    rise = slice(int(np.argmax(centre)) + 1)
    halfway = (ROOM + centre.max()) / 2
    return float(np.interp(halfway, centre[rise], run.step_record["seconds [s]"][rise]))


KINETICS = (
    "Outside of the band the kinetics do not describe how heat that stays in the cement speeds up "
    "its setting, or a gap opens between cement and mould."
)
DISC = Experiment(
    name="disc",
    title="Exotherm in moulds of PTFE and of polyurethane foam",
    blind=False,
    quantities={
        "foam_peak": PredictedQuantity.difference(
            "peak at 6 mm, foam minus PTFE", "K", peak, "foam_thin", "PTFE_thin", KINETICS
        ),
        "PTFE_rise": PredictedQuantity.difference(
            "peak in PTFE, 40 mm minus 6 mm", "K", peak, "PTFE_thick", "PTFE_thin", KINETICS
        ),
        "foam_rise": PredictedQuantity.difference(
            "peak in foam, 40 mm minus 6 mm", "K", peak, "foam_thick", "foam_thin", KINETICS
        ),
        "PTFE_time": PredictedQuantity.difference(
            "setting time in PTFE, 6 mm minus 40 mm",
            "s",
            setting,
            "PTFE_thin",
            "PTFE_thick",
            KINETICS,
        ),
        "foam_time": PredictedQuantity.difference(
            "setting time in foam, 6 mm minus 40 mm",
            "s",
            setting,
            "foam_thin",
            "foam_thick",
            KINETICS,
        ),
    },
)

# Cement that sets around a stem


MANTLE = Experiment(
    name="mantle",
    title="Residual stress of cement that has set around a stem",
    blind=False,
    quantities={
        "tension": PredictedQuantity(
            "largest tension (p99) of cement that has set around a stem",
            "MPa",
            lambda runs: float(runs[""].summary["regions"]["cement"]["principal_p99"]),
            "Outside of the band cement stops to flow at another degree of cure, or shrinks more "
            "after it.",
        )
    },
)

# A strip in four-point bending


def _deflection(run: Results, inner: str = "middle") -> Floats:
    """Deflection of the middle, or another point, against the outer rollers by step [mm]."""
    record = run.step_record
    return record["outer displacement.y [mm]"] - record[f"{inner} displacement.y [mm]"]


def _elastic(run: Results) -> float:
    """Deflection of the middle before creep [mm]."""
    loaded = run.step_record["creep time [s]"] == 0
    return float(_deflection(run)[loaded][-1])


def _crept(run: Results) -> float:
    """Growth of the deflection of the middle from the first reading at 8 min to 72 h [mm]."""
    stages = np.floor(run.step_record["time [-]"] + 1e-9)
    first_reading = _deflection(run)[np.flatnonzero(stages >= 1)[0]]
    return float(_deflection(run)[-1] - first_reading)


CREEP_FAILURE = (
    "Above the band cement that is wet and at 37 degC creeps more than the law, which is of dry "
    "cement or of another temperature; below it a steady load makes it creep less than cycles do."
)
BENDING_CREEP = Experiment(
    name="bending_creep",
    title="Creep of bone cement in four-point bending",
    blind=True,
    quantities={
        "total": PredictedQuantity(
            "deflection of the middle after 72 h, from the unloaded strip",
            "mm",
            lambda runs: float(_deflection(runs[""])[-1]),
            CREEP_FAILURE,
        ),
        "crept": PredictedQuantity.of_run(
            "deflection of the middle after 72 h, from the first reading at 8 min",
            "mm",
            _crept,
            "",
            CREEP_FAILURE,
        ),
        "crept_inner": PredictedQuantity(
            "deflection under the inner rollers after 72 h over that of the middle",
            "-",
            lambda runs: float(
                _deflection(runs[""], "inner")[-1] / _deflection(runs[""], "middle")[-1]
            ),
            "Outside of the band the spans are not those assumed.",
        ),
        "creep_over_elastic": PredictedQuantity(
            "growth of the deflection by creep in 72 h over the elastic deflection",
            "-",
            lambda runs: float(_deflection(runs[""])[-1] / _elastic(runs[""]) - 1),
            CREEP_FAILURE,
        ),
    },
)

# Heat under a resurfacing cap


def interface_peak(run: Results) -> float:
    """Highest temperature at the reamed surface of the bone [degC]."""
    interfaces = run.summary["thermal"]["interfaces"]
    return float(interfaces["mixed_cement"]["temperature_max_first"])


HEAT = (
    "Above the band cement sets faster than these kinetics, and has less time to lose its heat; "
    "below it the cap or blood takes more heat away."
)
RESURFACING = Experiment(
    name="resurfacing",
    title="Temperature under a resurfacing cap by mantle thickness",
    blind=True,
    quantities={
        **{
            f"{bone}_{mantle}": PredictedQuantity.of_run(
                f"highest temperature of bone at its surface, mantle of {thickness} mm, bone at "
                f"{start} degC at the start",
                "degC",
                interface_peak,
                f"{bone}_{mantle}",
                HEAT,
            )
            for bone, start in (("cold", "20 to 25"), ("warm", "32 to 37"))
            for mantle, thickness in (("thin", "0.5"), ("thick", "1.5"))
        },
        **{
            f"{bone}_difference": PredictedQuantity(
                f"highest temperature with a mantle of 1.5 mm minus that with 0.5 mm, bone at "
                f"{start} degC at the start",
                "K",
                lambda runs, bone=bone: (  # type: ignore[misc]
                    interface_peak(runs[f"{bone}_thick"]) - interface_peak(runs[f"{bone}_thin"])
                ),
                "Above the band cement sets faster than these kinetics; below it penetration "
                "differs more than the mantle.",
            )
            for bone, start in (("cold", "20 to 25"), ("warm", "32 to 37"))
        },
    },
)
