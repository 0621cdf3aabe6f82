"""Why a solve failed, in the words of the model: which interface, where, which body is free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from app.arrays import Floats
from app.errors import Reason
from app.mechanics.contact import Jumps
from app.mechanics.problem import Problem, TrialState
from app.numerics.active_set import ActiveSet
from app.numerics.newton import NewtonResult, Solver
from app.numerics.rigid_motions import add_relative, describe, rigid_modes
from app.scene.bodies import bodies_at
from app.soundness import uniqueness
from forms.contact import OPEN

# A rigid mode is free when the contact holds it by less than this fraction of the best-held one.
_FREE = 1e-10
# A body is held in every direction when supports hold more than this of each.
HELD = 1e-3
# What a contact point does, by its status.
STATES = ("open", "stick", "slip")
# Changing points that a message lists.
SHOWN = 3
# A body slides when so much of the area that holds it bears so much of the most friction can.
SLIDES, ALL_OF_IT = 0.95, 1 - 1e-6
# Fraction of the size of the interfaces beyond which a jump is no small displacement.
RUNAWAY = 0.05
# Motion in units of load / (modulus of the softer side x size): 5 for a stem wedged by friction, 70
# for a frictionless taper of 1.5 degrees, 600 for a straight frictionless stem.
LOOSE = 200.0


@dataclass(frozen=True)
class Explanation:
    """Why a solve failed.

    Attributes:
        short: One clause for the log.
        where: Interface and place of the largest residual, if it is at one.
        free: Sentences on bodies that nothing holds.
        notes: Sentences on bodies that friction hardly holds, and on friction beyond which
            solutions need not be unique.
        oscillating: Contact points that keep changing their states: where, between which.
        history: Residuals, relative to the force scale.
        tried: What the solver tried in turn, and the residual that it got to.
    """

    short: str
    where: str
    free: tuple[str, ...]
    notes: tuple[str, ...]
    oscillating: tuple[str, ...]
    history: tuple[float, ...]
    tried: tuple[tuple[str, float], ...]

    def text(self, stage: str, reach: float, steps: Sequence[float]) -> str:
        """The whole message for the user.

        Args:
            stage: Name of the stage.
            reach: Part of it at which the solve failed.
            steps: Halved steps that were tried before, as parts of the stage.
        """
        code = f" [{Reason.LOOSE_BODY}]" if self.free else ""
        lines = [
            f"no convergence in stage '{stage}' at {100 * reach:.3g} % of it: {self.short}{code}",
            *(f"  {line}" for line in self.free if line != self.short),
        ]
        lines += [f"  {line}" for line in self.notes]
        if self.where:
            lines.append(f"  largest residual: {self.where}")
        lines += [f"  changing: {line}" for line in self.oscillating]
        tail = ", ".join(f"{r:.1e}" for r in self.history[-6:])
        lines.append(f"  last residuals (relative to the forces): {tail}")
        lines.append(f"  tried: {attempts(self.tried, steps)}")
        advice = "more increments, a finer mesh at the interface, or a smaller load"
        if self.notes:
            advice += "; other friction, or a support"
        if self.free:
            advice = "hold the free body (a support, friction, an elastic foundation)"
        lines.append(f"  what to change: {advice}")
        return "\n".join(lines)


def explain(problem: Problem, solver: Solver, outcome: NewtonResult) -> Explanation:
    """Say why the last solve failed; collective."""
    x = solver.failed_state
    where = ""
    free: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    oscillating: tuple[str, ...] = ()
    u, q = solver.u_and_q(x)
    if q is not None:
        (j,) = problem.jumps
        trial = problem.trial(u, q)
        where = _largest(problem, j, trial)
        oscillating = _restless(problem, j, solver.system.active)
        free = tuple(free_bodies(problem, trial))
        notes = (*(() if free else sliding(problem)), *uniqueness.beyond(problem))
    if free:
        short = free[0]
    elif outcome.linear_failed:
        short = "the linear solver failed"
    elif sum(outcome.changes[-5:]) > 0:
        short = f"contact states keep changing ({outcome.changes[-1]} in the last iteration"
        again = f", the same every {outcome.period} iterations" if outcome.period else ""
        short += f"{again})"
    else:
        short = f"the residual stays at {outcome.residuals[-1]:.1e} times the forces"
    return Explanation(short, where, free, notes, oscillating, outcome.residuals, outcome.tried)


def attempts(tried: Sequence[tuple[str, float]], steps: Sequence[float] = ()) -> str:
    """List what the solver tried, in words.

    Args:
        tried: Changes of the solver, and the residuals that they got to.
        steps: Halved steps that were tried before, as parts of the stage.
    """
    words = [f"{what}: {residual:.1e}" for what, residual in tried]
    text = f"{'; '.join(words)} (with final residuals)" if words else "plain Newton only"
    halved = f"; steps of {', '.join(f'{s:.3g}' for s in steps)} of the stage" if steps else ""
    return text + halved


def _restless(problem: Problem, j: Jumps, active: ActiveSet) -> tuple[str, ...]:
    """Contact points that change their states most in the last iterations, in words; collective."""
    local = [
        (
            r.changes,
            f"{' <-> '.join(map(_state, r.states))} at "
            f"{_place(j.points.x[j.mine[r.row]])} on interface "
            f"'{problem.scene.contacts[j.interface[r.row]].name}', in {r.changes} of the last "
            f"{r.iterations} iterations",
        )
        for r in active.oscillating()[:SHOWN]
    ]
    every = sorted((r for part in problem.comm.allgather(local) for r in part), reverse=True)
    return tuple(text for _, text in every[:SHOWN])


def _largest(problem: Problem, j: Jumps, trial: TrialState) -> str:
    """Interface, place and state of the largest residual in the jump block."""
    r = np.linalg.norm(j.residual(trial.equilibrium, trial.jump, trial.law), axis=1)
    best = (float(r.max(initial=0.0)), problem.comm.rank)
    size, rank = problem.comm.allreduce(best, MPI.MAX)
    text = ""
    if rank == problem.comm.rank and len(r):
        k = int(np.argmax(r))
        x = j.points.x[j.mine[k]]
        name = problem.scene.contacts[j.interface[k]].name
        state = _state(trial.law.status[k])
        text = f"{size:.2e} N on interface '{name}' at {_place(x)}, {state}"
    return str(problem.comm.bcast(text, root=rank))


def _state(status: int) -> str:
    return STATES[status] if status < len(STATES) else f"state {status}"


def _place(x: Floats) -> str:
    return "({:.2f}, {:.2f}, {:.2f}) mm".format(*x)


def free_bodies(problem: Problem, trial: TrialState) -> list[str]:
    """Rigid motions of bodies that no support and no closed contact resists; collective.

    The resistance of the contacts is the generalized Jacobian at each point, seen through the
    relative rigid motions of the two bodies; its null space beyond the supports is what is free.
    """
    (j,) = problem.jumps
    names = problem.bodies.names
    held = held_bodies(problem)
    n = len(names)
    centre = j.points.x.mean(axis=0)
    size = np.linalg.norm(np.ptp(j.points.x, axis=0)) or 1.0
    A = np.zeros((6 * n, 6 * n))
    x = (j.points.x[j.mine] - centre) / size
    B = trial.law.jacobian
    S = np.where((trial.law.status == OPEN)[:, None, None], 0.0, (B + B.transpose(0, 2, 1)) / 2)
    R = rigid_modes(x)
    K = j.weight[:, None, None] * (R.transpose(0, 2, 1) @ S @ R)
    sides = j.points.bodies[j.mine]
    for m, s, k in zip(sides[:, 0], sides[:, 1], K, strict=True):
        add_relative(A, int(m), int(s), k)
    A = problem.comm.allreduce(A, MPI.SUM)
    total = float(np.sum(j.points.weight)) or 1.0
    for body in held:
        A[6 * body : 6 * body + 6, 6 * body : 6 * body + 6] += total * np.eye(6)
    values, vectors = np.linalg.eigh((A + A.T) / 2)
    free = vectors[:, values <= _FREE * max(values[-1], total)]
    every = j.points.bodies
    centres = np.array(
        [
            j.points.x[here].mean(axis=0) if (here := (every == b).any(axis=1)).any() else centre
            for b in range(n)
        ]
    )
    return describe(free, [f"'{name}'" for name in names], centres, centre, float(size))


def sliding(problem: Problem) -> list[str]:
    """Bodies that friction alone held in the last converged state, and hardly did; collective.

    Pulled further they may come off. That is no proof: smaller steps are tried all the same.
    """
    (j,) = problem.jumps
    old, names = j.history, problem.bodies.names
    normal = np.einsum("pi,pi->p", old.force - old.friction, old.force - old.friction) ** 0.5
    shear = np.linalg.norm(old.friction, axis=1)
    sides = j.points.bodies[j.mine]
    found = []
    for i, contact in enumerate(problem.scene.contacts):
        on = (j.interface == i) & (normal > 0)
        slips = on & (shear >= ALL_OF_IT * contact.law.friction * normal)
        local = np.array([j.weight[slips].sum(), j.weight[on].sum()])
        slip, touch = problem.comm.allreduce(local, MPI.SUM)
        pairs = problem.comm.allgather({tuple(map(int, s)) for s in sides[on]})
        loose = {b for pair in set().union(*pairs) for b in pair} - _held_every_way(problem)
        if contact.law.frictional and touch and slip >= SLIDES * touch and loose:
            who = "' and '".join(names[b] for b in sorted(loose))
            found.append(
                f"friction hardly holds body '{who}': {100 * slip / touch:.0f} % of what touches "
                f"on interface '{contact.name}' slips in the last converged state "
                f"[{Reason.LOOSE_BODY}]"
            )
    return found


def runaway(problem: Problem, trial: TrialState) -> str:
    """A sentence if loads moved an interface as only a free body moves; collective.

    A body that contact does not hold may still be caught by the facets of a curved interface. It
    has then moved further than small displacements allow, and against hardly any stiffness.
    """
    (j,) = problem.jumps
    forces = sum(float(np.linalg.norm(r)) for r in problem.forces.resultants(problem.time))
    pushed = any(unit.any() for unit in problem.reduction.unit)
    if problem.comm.allreduce(pushed, MPI.LOR) or not forces:
        return ""  # where supports move the model, they may move it far
    size = float(np.linalg.norm(np.ptp(j.points.x, axis=0)))
    # What closes a gap or makes room for an interference is no running away.
    moved = np.linalg.norm(trial.jump, axis=1) - np.linalg.norm(j.gap, axis=1)
    for i, contact in enumerate(problem.scene.contacts):
        local = float(moved[j.interface == i].max(initial=0.0))
        largest = problem.comm.allreduce(local, MPI.MAX)
        elastic = forces / (contact.modulus * size)
        if largest > RUNAWAY * size and largest > LOOSE * elastic:
            free = free_bodies(problem, trial)
            how = (
                f"moved {largest:.3g} mm apart or along each other, {100 * largest / size:.0f} % "
                "of the interface's size"
                if largest < size
                else "left each other for good"
            )
            by = "" if free else ": nothing holds them but the facets of the mesh"
            return "; ".join([*free, f"the sides of interface '{contact.name}' {how}{by}"])
    return ""


def _held_every_way(problem: Problem) -> set[int]:
    """Bodies with supports or foundations along all three axes; planes of symmetry leave one."""
    scene = problem.scene
    conditions = [(s.boundary, np.diag(s.components).astype(float)) for s in scene.supports]
    if problem.frames is not None:
        for s, support in enumerate(scene.supports):
            if support.normal:
                conditions[s] = support.boundary, problem.frames.held_by(s)
    conditions += [(f.boundary, np.diag(np.sign(f.stiffness))) for f in scene.foundations]
    held: dict[int, Floats] = {}
    for boundary, part in conditions:
        for body in bodies_at(problem.tagged, problem.bodies, boundary):
            held[body] = held.get(body, 0.0) + part
    return {body for body, part in held.items() if np.linalg.eigvalsh(part)[0] > HELD}


def held_bodies(problem: Problem) -> set[int]:
    """Bodies with a support or a foundation."""
    boundaries = [s.boundary for s in problem.scene.supports]
    boundaries += [f.boundary for f in problem.scene.foundations]
    return {body for name in boundaries for body in bodies_at(problem.tagged, problem.bodies, name)}
