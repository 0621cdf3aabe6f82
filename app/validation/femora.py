"""Experiments on synthetic femora with strain gauges."""

from __future__ import annotations

import numpy as np

from app.foundation.arrays import Floats
from app.results.reading import Results
from app.schema.units import Dimension
from app.validation.experiment import Experiment, PredictedQuantity

# Time at which a stem without cement is in its place, before the force.
INSERTED = 1.0
# Length of a gauge in the cement [mm].
GAUGE = 3.0
# Strain in microstrain.
MICRO = 1e6
# Quantities of a case, which are texts with units.
FORCE = Dimension("N", "a force", "2000 N")
MODULUS = Dimension("MPa", "a stress", "2.2 GPa")


def strain_of_gauge(run: Results, gauge: str) -> float:
    """Strain of a gauge by the force alone: zeroed after the insertion of the stem [um/m]."""
    record = run.step_record
    column = record[f"{gauge} strain [-]"]
    # The first stage inserts a stem without cement.
    is_cementless = "stem_bone" in run.summary["interfaces"]
    inserted_strains = column[record["time [-]"] <= INSERTED] if is_cementless else np.zeros(1)
    return float(MICRO * (column[-1] - inserted_strains[-1]))


def stiffness(run: Results) -> float:
    """Force on the head over the displacement of the head along it [N/mm]."""
    force = np.array([FORCE.read(component) for component in run.case["loads"]["head"]["force"]])
    return float(force @ force / (force @ run.summary["femur"]["head_displacement"]))


# A stem without cement, four sides

GAUGE_SIDES = ("medial", "lateral", "anterior", "posterior")
SHAPE = (
    "Outside of the band the outline or the cortex of the femur that was tested differs from this "
    "one, or its potting and force differ from the ranges."
)
SHIELDED = (
    "Above the band the stem carries less in its proximal part than one that fills the canal; "
    "below it the stem is bonded or stiffer."
)
COMPOSITE_STRAIN = Experiment(
    name="composite_strain",
    title="Stem without cement in a synthetic femur",
    blind=True,
    quantities={
        "stiffness": PredictedQuantity.of_run(
            "force on the head over its displacement along the force, intact femur",
            "N/mm",
            stiffness,
            "intact",
            SHAPE,
        ),
        "stiffness_ratio": PredictedQuantity.ratio(
            "this stiffness with the stem over that of the intact femur",
            stiffness,
            "stem",
            "intact",
            SHAPE,
        ),
        "medial": PredictedQuantity.of_run(
            "strain along the shaft for 2000 N, medial, 40 mm below mid lesser trochanter, intact",
            "um/m",
            lambda run: strain_of_gauge(run, "medial_40"),
            "intact",
            SHAPE,
        ),
        "lateral": PredictedQuantity.of_run(
            "the same, lateral",
            "um/m",
            lambda run: strain_of_gauge(run, "lateral_40"),
            "intact",
            SHAPE,
        ),
        # The experiment puts the gauges `*_10` between 5 and 20 mm below mid lesser trochanter.
        **{
            f"{side}_share": PredictedQuantity.ratio(
                f"strain along the shaft with the stem over that of the intact femur, {side}, 5 to "
                "20 mm below mid lesser trochanter",
                lambda run, side=side: strain_of_gauge(run, f"{side}_10"),  # type: ignore[misc]
                "stem",
                "intact",
                SHIELDED,
            )
            for side in GAUGE_SIDES
        },
        "distal_share": PredictedQuantity.ratio(
            "strain along the shaft with the stem over that of the intact femur, medial, 80 mm "
            "below mid lesser trochanter",
            lambda run: strain_of_gauge(run, "medial_80"),
            "stem",
            "intact",
            SHIELDED,
        ),
    },
)

# A cemented stem that loses its bond

# Levels of the gauges in the medial cement by name [mm].
GAUGE_LEVELS = {"proximal": -10.0, "middle": -50.0, "distal": -100.0}


def cement_strain(run: Results, z: float) -> float:
    """Strain along the shaft of the medial cement at the stem, mean of a gauge [um/m].

    By Hooke's law from the stress on the path along the stem.
    """
    table = run.paths["medial_cement"]
    is_last_step = table["step"] == table["step"].max()
    is_in_gauge = is_last_step & (np.abs(table["z [mm]"] - z) <= GAUGE / 2)
    xx, yy, zz = (_mean(table[f"stress.{axis} [MPa]"][is_in_gauge]) for axis in ("xx", "yy", "zz"))
    cement = run.case["regions"]["cement"]
    E, ν = MODULUS.read(cement["youngs_modulus"]), float(cement["poisson_ratio"])
    return MICRO * (zz - ν * (xx + yy)) / E


def _mean(values: Floats) -> float:
    return float(values.mean())


BOND = (
    "Outside of the band the bond was not lost everywhere, or wear and creep of a million cycles "
    "change how the stem sits in its cement."
)
COMPOSITE_BOND = Experiment(
    name="composite_bond",
    title="Cemented stem in a synthetic femur, bond lost",
    blind=True,
    quantities={
        **{
            f"cement_{name}": PredictedQuantity.ratio(
                f"strain along the shaft of the medial cement, debonded over bonded, {name}",
                lambda run, z=z: cement_strain(run, z),  # type: ignore[misc]
                "debonded",
                "bonded",
                BOND,
            )
            for name, z in GAUGE_LEVELS.items()
        },
        **{
            f"bone_{level}": PredictedQuantity.ratio(
                "strain along the shaft of the medial bone, debonded over bonded, "
                f"{level} mm below mid lesser trochanter",
                lambda run, level=level: strain_of_gauge(run, f"medial_{level}"),  # type: ignore[misc]
                "debonded",
                "bonded",
                BOND,
            )
            for level in (10, 40, 80)
        },
        "head": PredictedQuantity.ratio(
            "stiffness at the head, debonded over bonded",
            stiffness,
            "debonded",
            "bonded",
            BOND,
        ),
    },
)
