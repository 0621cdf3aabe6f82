"""Remodelling: bone whose density follows its strain energy, in separate stages.

`laws` has the keys and the formula, `stimulus` the stimulus, `intact_femur` its reference before
surgery. `stepper` advances the density in time, `bone` sums the mass, `findings` has faults and
notes. Importing the package registers it; the core does not know it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from app.case.case import Case
from app.case.run_options import add_stage_kind
from app.laws.densities import ChangingDensity
from app.remodelling import findings as findings  # registers its checks
from app.remodelling.laws import Remodelling, regions_of, remodelling_of
from app.remodelling.stages import STAGES
from app.results.records import RecordedModel, add_record
from app.scene.scene import by_density
from app.schema.section import add_key
from app.simulation.steppers import add_stepper

if TYPE_CHECKING:
    from app.remodelling.bone import BoneMass
    from app.remodelling.stepper import Remodeller
    from app.simulation.model import Model
    from app.stepping.load_steps import LoadStepper


@by_density
def _bone(case: Case) -> Mapping[str, ChangingDensity]:
    """Density of the bone that remodels, by region."""
    law = remodelling_of(case)
    if law is None:
        return {}
    return dict.fromkeys(regions_of(case), ChangingDensity(law.law, law.density))


def _mass(case: Case, mechanics: RecordedModel) -> BoneMass | None:
    """The record of a run, or None if nothing in its case remodels."""
    if not remodelling_of(case):
        return None
    from app.remodelling.bone import BoneMass  # starts MPI

    return BoneMass(mechanics)


def _stepper(model: Model, load_stepper: LoadStepper) -> Remodeller:
    """The stepper of a run whose case has stages that remodel."""
    from app.remodelling.stepper import remodeller  # starts MPI

    return remodeller(model, load_stepper)


add_key(
    Case,
    "remodelling",
    Remodelling,
    "Response of bone to its load in the stages that remodel it.",
)
add_stage_kind(STAGES)
add_stepper(STAGES.key, _stepper)
add_record("bone", _mass)
