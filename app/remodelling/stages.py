"""Stages in which bone remodels."""

from __future__ import annotations

from app.case.case import Case
from app.case.run_options import StageKind
from app.remodelling.laws import Remodelling, remodelling_of

# Solves of a stage, for each load case.
SOLVES = 60


def _law(case: Case) -> Remodelling:
    law = remodelling_of(case)
    assert law is not None  # `findings` refuses stages that remodel without it
    return law


STAGES = StageKind(
    key="remodels",
    doc="Time in which bone remodels under the load cases of `remodelling`. Its steps are chosen "
    "by their error. Fields are written at the end of each of `increments` equal parts.",
    no_cycle_table="applies the load cases of section `remodelling`",
    loads=lambda case: _law(case).load_cases[-1],
    solves=lambda case: SOLVES * len(_law(case).load_cases),
)
