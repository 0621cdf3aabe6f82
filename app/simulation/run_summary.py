"""Sections of summary.json that describe a state and the work of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from mpi4py import MPI

from app.case.case import Case
from app.case.section_loads import section_loads
from app.case.summary import Memory, SolverNumbers, Summary, merge
from app.results.balance import Balance
from app.results.cycles import Cycles
from app.results.interface_numbers import ContactSamples
from app.simulation.model import Model
from app.simulation.thermal_model import ThermalModel
from app.stepping.load_steps import Effort
from app.system.timing import Timing, peak_memory


def at_rest() -> Summary:
    """Empty sections of a run without a converged step."""
    return {"interfaces": {}, "regions": {}, "probes": {}}


def numbers_of_state(
    case: Case,
    model: Model,
    samples: ContactSamples | None,
    cycles: Cycles,
    critical: Mapping[str, float],
    time: float,
) -> Summary:
    """Numbers of the last converged state; collective.

    Args:
        case: The case.
        model: The model, at the state.
        samples: Contact points at the state, if there are any.
        cycles: Numbers at the peaks and valleys of the loads.
        critical: Critical friction coefficients by interface [-].
        time: Time of the state: stage k runs from k to k + 1.
    """
    numbers = model.numbers(samples)
    numbers_of_cycles = cycles.summary()
    if numbers_of_cycles:
        merge(numbers, {"cycles": numbers_of_cycles})
    sections = section_loads(case, model.scene.load_time(time))
    if sections:
        numbers["section_loads"] = [asdict(section) for section in sections]
    for name, coefficient in critical.items():
        if name in numbers["interfaces"]:
            numbers["interfaces"][name]["critical_friction"] = coefficient
    return numbers


def balances(balance: Balance | None, thermal: ThermalModel | None) -> dict[str, float]:
    """Relative errors of the balances of forces, moments, energy and heat [-]."""
    errors: dict[str, float] = {}
    if balance:
        errors |= {"force": balance.force, "moment": balance.moment, "energy": balance.energy}
    if thermal:
        heat = thermal.balance
        errors |= {"heat": heat.heat, "heat_quadrature": heat.quadrature}
    return errors


def solver_numbers(model: Model, steps: int, effort: Effort, rejected: int | None) -> SolverNumbers:
    """Unknowns, steps and iterations of a run; collective.

    Args:
        model: The model.
        steps: Number of recorded steps.
        effort: Iterations of the run.
        rejected: Attempts that were not committed; None if the run has not ended.
    """
    sizes = model.sizes()
    contact = model.mechanics.problem.contact if model.mechanics else None
    return {
        "dofs": sum(sizes.values()),
        "blocks": sizes,
        "steps": steps,
        "newton_iterations": effort.newton_iterations,
        "linear_iterations": effort.linear_iterations,
        "rejected_steps": rejected,
        "augmentation": contact.augmentation() if contact else {},
        "ranks": model.tagged.mesh.comm.size,
    }


def cpu_seconds(comm: MPI.Comm, timing: Timing) -> dict[str, float]:
    """CPU time of all ranks by phase [s]; collective."""
    cpu = comm.allgather(timing.cpu)
    return {phase: round(sum(c.get(phase, 0.0) for c in cpu), 3) for phase in cpu[0]}


def memory(comm: MPI.Comm, unknowns: int) -> Memory:
    """Peak memory of all ranks together [MB], and per unknown [kB]; collective."""
    peak = comm.allreduce(peak_memory())
    return {"peak": round(peak, 1), "per_unknown": round(1e3 * peak / unknowns, 2)}
