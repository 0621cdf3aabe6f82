"""Columns of history.csv: the numbers of a converged step by column title, with units."""

from __future__ import annotations

from app.case.quantities import TABLE, Quantity
from app.case.summary import Numbers
from app.results.balance import Balance
from app.results.interface_numbers import ContactSamples
from app.simulation.model import Model
from app.stepping.load_steps import LoadStep

# Row in history.csv: numbers by column title, with units.
Row = dict[str, float | None]


def mechanical_columns(
    model: Model,
    step: LoadStep,
    balance: Balance,
    samples: ContactSamples | None,
    stem_motion: Numbers,
) -> Row:
    """Columns of history.csv that mechanics computes.

    They are those of the solver and of creep, of probes, of interfaces, bonds and the stem (rows of
    `case.quantities` with `step_record`), and of records (`results.records`).

    Args:
        model: The model, at the end of the step.
        step: The step.
        balance: Balances after the step.
        samples: Contact points after the step, if there are any.
        stem_motion: Motion of the stem after the step.
    """
    row: Row = {
        "newton [-]": step.outcome.iterations,
        "krylov [-]": step.outcome.linear_iterations,
        "residual [-]": step.outcome.residuals[-1],
        "step [s]": round(step.wall_seconds, 3),
        "augmentation [-]": step.outcome.augmentation,
        "force balance [-]": balance.force,
        "moment balance [-]": balance.moment,
        "energy balance [-]": balance.energy,
    }
    mechanics = model.mechanics
    creep = mechanics.problem.creep if mechanics else None
    if creep:
        row[f"creep {creep.measure} [{creep.unit}]"] = creep.elapsed
        row["creep dissipation [N mm]"] = creep.dissipated
    row |= model.probes.step_record() if model.probes else {}
    columns = [c for c in TABLE["interfaces"].values() if c.step_record]
    for name, q in (samples.step_numbers if samples else {}).items():
        row |= {f"{name} {c.key} [{c.unit}]": q[c.key] for c in columns if c.key in q}
    columns = [c for c in TABLE["bonds"].values() if c.step_record]
    for name, q in mechanics.bonds.numbers(strong=True).items() if mechanics else ():
        row |= {f"{name} {c.key} [{c.unit}]": q[c.key] for c in columns}
    row |= {f"stem {q.key} [{q.unit}]": stem_motion[q.key] for q in stem_columns(stem_motion)}
    for record in model.records.values():
        row |= record.step_record()
    return row


def stem_columns(stem_motion: Numbers) -> list[Quantity]:
    """Quantities of the stem in history.csv, those that the run has."""
    return [q for key, q in TABLE["stem"].items() if q.step_record and key in stem_motion]
