"""Faults and verdicts about wear, and about the heat and the cycles of finite sliding."""

from __future__ import annotations

from collections.abc import Iterable

from app.bearing.laws import wear_coefficient_of
from app.case.case import Case
from app.case.checks import check
from app.case.summary import Summary
from app.foundation.layout import percent, two_digits
from app.foundation.verdict import Severity, Verdict
from app.laws.loads import Load
from app.laws.motions import Motion
from app.results.verdicts import result_verdict
from app.schema.yaml_file import Fault


@check("interfaces")
def _wear(case: Case) -> Iterable[Fault]:
    """Wear without friction, or with small sliding."""
    for name, law in case.interfaces.items():
        if law is None or wear_coefficient_of(law) is None:
            continue
        path = ("interfaces", name, "wear_coefficient")
        if not law.finite_sliding:
            yield Fault(path, "needs `sliding: finite` in the same interface")
        elif not law.largest_friction > 0:
            yield Fault(path, "wear needs friction; expected a friction_coefficient above 0")


@check("interfaces", "regions")
def _heat(case: Case) -> Iterable[Fault]:
    """Finite sliding without a conductance or a cycle; heat that depends on other contact."""
    laws = {name: law for name, law in case.interfaces.items() if law is not None}
    sliding = sorted(name for name, law in laws.items() if law.finite_sliding)
    regions = [region for region in case.regions.values() if region is not None]
    if not sliding or all(region.thermal is None for region in regions):
        return
    motions_and_loads: list[Motion | Load | None]
    motions_and_loads = [*(case.motions or {}).values(), *(case.loads or {}).values()]
    cyclic = any(part is not None and part.cycle is not None for part in motions_and_loads)
    for name, law in laws.items():
        heats = law.heated_by_friction is not None
        path = ("interfaces", name, "friction_heating" if heats else "conductance")
        if name not in sliding and (heats or law.conducts_by_pressure):
            message = "heat that depends on contact cannot be combined with finite sliding "
            message += f"({', '.join(sliding)}); expected a constant conductance"
            yield Fault(path, message)
        elif name in sliding and heats and not cyclic:
            message = (
                "friction heat is the mean over a cycle; expected a cycle_table of a motion or load"
            )
            yield Fault(path, message)
        if name in sliding and law.conductance is None:
            message = (
                "the two sides share no nodes; expected a finite conductance, a large one for"
                " perfect conduction"
            )
            yield Fault(("interfaces", name, "conductance"), message)


@result_verdict
def _last_cycles(summary: Summary) -> Iterable[Verdict]:
    """Difference of the last two cycles of each interface."""
    for numbers in summary.get("cycles", {}).values():
        for name, change in numbers.get("change", {}).items():
            percentages = [
                f"{percent(change[key])} of the {key}"
                for key in ("torque", "dissipation")
                if key in change
            ]
            differences = ", ".join(
                [*percentages, f"{two_digits(1e3 * change['centre'])} um in place"]
            )
            message = f"the last two cycles of {name} differ by {differences}"
            yield Verdict(message, "cycles", severity=Severity.PLAIN)
