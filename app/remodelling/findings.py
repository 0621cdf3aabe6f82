"""Faults and notes about bone that remodels."""

from __future__ import annotations

from collections.abc import Iterable

from app.case.case import Case
from app.case.checks import check
from app.foundation.verdict import Verdict, note
from app.laws.densities import density
from app.remodelling.laws import remodelling_of
from app.remodelling.stages import STAGES
from app.schema.section import did_you_mean
from app.schema.yaml_file import Fault
from app.soundness.preview import input_note


@check("geometry")
def _stages_and_regions(case: Case) -> Iterable[Fault]:
    """Stages without section and reverse; load cases and regions that remodelling lacks."""
    law, stages = remodelling_of(case), case.stages or ()
    timed = [i for i, stage in enumerate(stages) if stage.extension_kind is STAGES]
    if law is None:
        for i in timed:
            message = "the law of remodelling is missing or wrong; expected a section `remodelling`"
            yield Fault(("stages", i, "remodels"), message)
        return
    if stages and not timed:
        yield Fault(("stages",), "no stage has remodelling; expected `remodels: 2 years` in one")
    stages_before = [s.name for s in stages[: timed[0] if timed else None] if not s.takes_time]
    for j, name in enumerate(law.load_cases):
        if stages and name not in stages_before:
            expected = f"expected one of {', '.join(stages_before)}"
            message = f"'{name}' is not an earlier stage without duration; {expected}"
            yield Fault(
                ("remodelling", "load_cases", j), message + did_you_mean(name, stages_before)
            )
    boundaries = case.geometry.boundary_names
    for j, name in enumerate(law.frozen or () if boundaries else ()):
        if name not in boundaries:
            message = f"'{name}' is not one of {', '.join(boundaries)}"
            yield Fault(("remodelling", "frozen", j), message + did_you_mean(name, boundaries))
    regions, tissues = case.regions or {}, case.geometry.tissues
    bone = [n for n, r in regions.items() if r and (r.tissue or tissues.get(n)) == "bone"]
    for name in law.regions or bone:
        region = regions.get(name)
        is_elastic = region is not None and region.deforms and not region.eigenstrains
        if region is None or not is_elastic or (region.thermal and region.thermal.cure):
            message = (
                f"{name} cannot remodel; expected elastic regions without eigenstrains and cure"
            )
            yield Fault(("remodelling", "regions"), message)
        elif not region.modulus_field:
            lowest, highest = law.density
            for rho in density(law.law, region.axial_moduli):
                if not lowest <= rho <= highest:
                    message = (
                        f"has {rho:.4g} g/cm^3 by `remodelling.law`; expected {lowest:g} to"
                        f" {highest:g}"
                    )
                    yield Fault(("regions", name), message)


@input_note
def _no_lazy_zone(case: Case) -> Iterable[Verdict]:
    """Bone that follows every difference of its stimulus."""
    law = remodelling_of(case)
    if law and not law.lazy_zone:
        message = (
            "remodelling.lazy_zone is 0: if the modulus rises faster than the density, stiffer "
            "bone takes all load from its neighbours, and results depend on the mesh"
        )
        yield note(message)
