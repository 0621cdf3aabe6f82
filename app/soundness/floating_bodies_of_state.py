"""Floating bodies of a state: rigid motions that neither supports nor contact hold.

The functions detect floating bodies on the contact points of a state, after a solve. Before
solving, `app.soundness.bodies_on_mesh` detects them on the parts of a mesh.

Facets may hide a floating body. A smooth stem can rotate in its cement without resistance. On a
mesh the mean normals of curved facets are off by a fraction of the angle between them. Contact then
resists the rotation, with a stiffness that depends on the mesh alone
(`error_of_body_held_by_facets`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Bools, Floats
from app.foundation.verdict import Reason, Severity, Verdict
from app.interfaces.faces import spread_of_normals
from app.interfaces.smooth_normals import LIKELY_MULTIPLE
from app.numerics.rigid_motions import (
    DIRECTIONS,
    add_relative,
    motions_in_words,
    motions_outside,
    relative_resistance,
)
from forms.contact import OPEN

if TYPE_CHECKING:  # they import dolfinx, which the check of a case does not need
    from app.mechanics.contact import ContactInterfaces, TrialState
    from app.mechanics.problem import Problem

# A motion is free if its resistance is below this fraction of the largest.
FREE = 1e-10
# Supports hold a body if their least resistance to translation exceeds this part.
HELD = 1e-3
# A body slides if this fraction of its touching area bears this fraction of the friction limit.
SLIDES = 0.95
ALL_OF_IT = 1 - 1e-6
# Jumps of a free body run away beyond this fraction of the size of the interfaces.
RUNAWAY = 0.05
# They must also exceed this motion in units of load / (modulus of the softer side x size). It is 5
# for a stem wedged by friction, 70 for a frictionless taper of 1.5 degrees, and 600 for a straight
# frictionless stem.
LARGEST_ELASTIC = 200.0
# Displacements are not small beyond this fraction of the size of the interfaces, whatever resists.
NOT_SMALL = 0.2
# Largest motion of an interface by a lever, over the largest prescribed displacement.
LEVER = 10.0
# Root of the compliance of springs between rigid bodies: with it a taper of 1 degree and 100 points
# bears 99 % of a push.
SPRING = 0.02
# Loads are in balance along a motion if their work is less than this fraction of its upper bound,
# for which all loads act along the motion. Such a remainder is within the tolerance of the solvers.
BALANCED = 1e-8
# Springs do not bear a direction if more than this fraction of a load along it remains.
UNBORNE = 0.1
# Largest number of iterations for the set of compressed springs.
MOST = 20
# Number of loadings of the springs, each by the load that remains. With one loading, a body under a
# large load sinks into its springs and loses contact with another one under a small load.
LOADINGS = 2
# Facets alone hold a motion if contact resists it less than this fraction of the resistance by
# randomly spread normals (0.01 for a smooth stem that rotates, 0.8 to 100 where its taper resists).
SPREAD = 0.25
# Such a motion counts if its square exceeds this fraction of the squared jumps (0.003 in a push,
# 0.15 in a rotation).
PART = 0.05
# Bodies are apart by more than this fraction of the size of the interfaces.
GAP = 1e-8
# A pressure below this fraction of (stiffness per area x size) counts as zero.
UNPRESSED = 1e-10
# Subject of verdicts on contact.
CONTACT = "contact"
# Remedy for a body that nothing holds.
HOLD = "hold the body (a support, friction, an elastic foundation)"


def texts_of_floating_bodies(problem: Problem, trial: TrialState, moved: bool = False) -> list[str]:
    """Sentences on free motions: no support and no closed contact resists them; collective.

    The resistance of contact is the generalized Jacobian at each point, projected onto the relative
    rigid motions of the two bodies.

    Args:
        problem: The problem.
        trial: Its state.
        moved: True to leave out `ContactMotions.unresisted`: no load moves bodies along them.
    """
    contact, body_names = trial.contact, problem.bodies.names
    x = contact.points.x
    centre, size = contact.motions.frame
    B = np.where((trial.forces.status == OPEN)[:, None, None], 0.0, trial.forces.resisted)
    R = contact.motions.jumps_by_motion
    A = _gathered(problem, contact.local.weight[:, None, None] * (R.transpose(0, 2, 1) @ B @ R))
    total = float(np.sum(contact.points.weight)) or 1.0
    support_resistance = support_resistance_of_bodies(problem)
    # A body with a prescribed motion counts as held here, but not in `texts_of_pulled_bodies`.
    support_resistance |= {body: np.eye(6) for body in bodies_with_prescribed_motion(problem)}
    for body, part in support_resistance.items():
        A[6 * body : 6 * body + 6, 6 * body : 6 * body + 6] += total * part
    values, vectors = np.linalg.eigh((A + A.T) / 2)
    free_vectors = vectors[:, values <= FREE * max(values[-1], total)]
    if moved:
        unresisted = contact.unresisted_motions(trial.forces.status)
        free_vectors = motions_outside(free_vectors, unresisted)
    at_body = [(contact.points.bodies == b).any(axis=1) for b in range(len(body_names))]
    centres = np.array([x[mask].mean(axis=0) if mask.any() else centre for mask in at_body])
    return motions_in_words(
        free_vectors, [f"'{name}'" for name in body_names], centres, centre, size
    )


def texts_of_pushed_bodies(problem: Problem, trial: TrialState) -> list[str]:
    """Sentences on bodies that loads, however small, push along unresisted motions; collective."""
    contact = trial.contact
    motions = contact.unresisted_motions(trial.forces.status)
    motion = motions @ (motions.T @ _on_bodies(problem))
    pressures = contact.local.weight[:, None] * trial.forces.pressures
    return _pulls(problem, motion, pressures)


def _on_bodies(problem: Problem) -> Floats:
    """Work of the loads in the rigid motions of all bodies (6 n,) [N]; collective."""
    assert problem.contact is not None
    R = problem.contact.motions.rigid(_owned_nodes(problem))
    return problem.forces.work_on_bodies(problem.load_time, R).ravel()


def _owned_nodes(problem: Problem) -> Floats:
    """Owned nodes of the displacement (n, 3) [mm]."""
    owned = problem.space.dofmap.index_map.size_local
    return np.asarray(problem.space.tabulate_dof_coordinates()[:owned])


def _frictions(problem: Problem) -> Floats:
    """Friction coefficients of the interfaces that may hold a body (i,)."""
    # A ball clears the rim of its cup, so the rim cannot wedge it.
    return np.array([0.0 if c.between else c.law.largest_friction for c in problem.scene.contacts])


def _pulls(problem: Problem, motion: Floats, pressures: Floats) -> list[str]:
    """Sentences on bodies that the loads move along a rigid motion; collective.

    Contact resists by friction and where the motion closes a face. If normals are uncertain, so is
    the axis of a free motion. Contact may then bear the loads along it.

    Args:
        problem: The problem, at the time of the loads.
        motion: The part of the loads that is not borne, as a motion of all bodies (6 n,).
        pressures: Forces on the faces of local points, positive in compression (p, 3) [N].
    """
    contact, body_names = problem.contact, problem.bodies.names
    assert contact is not None
    local = contact.local
    jump = contact.motions.relative(motion[:, None])[:, :, 0]
    closing = np.maximum(0.0, -local.along_normals(jump))
    facet_friction = LIKELY_MULTIPLE * contact.points.normal_error[local.rows]
    friction = _frictions(problem)[local.interface] + facet_friction
    sliding_resistance = friction * np.linalg.norm(jump, axis=1)
    resisted = problem.comm.allreduce(
        float((pressures * (closing + sliding_resistance[:, None])).sum())
    )
    R = contact.motions.rigid(_owned_nodes(problem))
    motion_of_bodies = np.einsum("nik,bk->bni", R, motion.reshape(len(body_names), 6))
    rounding = BALANCED * problem.forces.work_bound(problem.load_time, motion_of_bodies)
    if motion @ _on_bodies(problem) <= resisted + rounding:
        return []
    centres = np.tile(contact.motions.frame[0], (len(body_names), 1))
    motion_texts = motions_in_words(
        motion[:, None], [f"'{name}'" for name in body_names], centres, *contact.motions.frame
    )
    return [f"{motion_text}, and the loads act in this direction" for motion_text in motion_texts]


def _gathered(problem: Problem, resistance: Floats) -> Floats:
    """Resistance of all n bodies (6 n, 6 n), summed over local points (p, 6, 6); collective."""
    assert problem.contact is not None
    bodies, n = problem.contact.local.bodies, len(problem.bodies.names)
    return np.asarray(problem.comm.allreduce(relative_resistance(resistance, bodies, n)))


def warnings_of_sliding_bodies(problem: Problem, contact: ContactInterfaces) -> list[Verdict]:
    """Warnings on bodies that friction alone holds, near its limit; collective.

    The state is the last converged one. Under a larger load the bodies may come off. This is no
    proof, so smaller steps are still tried.
    """
    normal = np.linalg.norm(contact.state.force - contact.state.friction, axis=1)
    shear = np.linalg.norm(contact.state.friction, axis=1)
    fixed_bodies = {
        b
        for b, part in support_resistance_of_bodies(problem).items()
        if np.linalg.eigvalsh(part[:3, :3])[0] > HELD and np.linalg.eigvalsh(part)[0] > FREE
    }
    verdicts = []
    for i, term in enumerate(problem.scene.contacts):
        is_pressed = (contact.local.interface == i) & (normal > 0)
        slips = is_pressed & (shear >= ALL_OF_IT * term.law.largest_friction * normal)
        local = np.array(
            [contact.local.weight[slips].sum(), contact.local.weight[is_pressed].sum()]
        )
        slip, touch = problem.comm.allreduce(local)
        bodies = problem.comm.allgather(set(contact.local.bodies[is_pressed].ravel().tolist()))
        unsupported = set().union(*bodies) - fixed_bodies
        if term.law.largest_friction > 0 and touch and slip >= SLIDES * touch and unsupported:
            body_names = "' and '".join(problem.bodies.names[b] for b in sorted(unsupported))
            message = (
                f"friction hardly holds body '{body_names}': {100 * slip / touch:.0f} % of the "
                f"contact area of interface '{term.name}' slips in the last converged state"
            )
            verdicts.append(Verdict(message, severity=Severity.WARNING, code=Reason.FLOATING_BODY))
    return verdicts


def error_of_runaway(problem: Problem, trial: TrialState) -> Verdict | None:
    """Return an error if loads moved the sides of an interface too far; collective.

    The state has converged, but must not be used: displacements are not small.

    A body floats only if one of its rigid motions is free. Springs, bending arms and soft layers
    may move as far, but resist.
    """
    contact = trial.contact
    forces = sum(float(np.linalg.norm(r)) for r in problem.forces.resultants(problem.time))
    largest_prescribed = max(
        problem.comm.allgather(float(np.abs(problem.prescribed).max(initial=0.0)))
    )
    if not (forces or largest_prescribed):
        return None
    size = contact.motions.frame[1]
    # Closing a gap or making room for an interference is not running away.
    distance = np.linalg.norm(trial.jump, axis=1) - np.linalg.norm(contact.initial_gap, axis=1)
    for i, term in enumerate(problem.scene.contacts):
        at_interface = contact.local.interface == i
        largest = max(problem.comm.allgather(float(distance[at_interface].max(initial=0.0))))
        if largest <= RUNAWAY * size + LEVER * largest_prescribed:
            continue
        pressed = (trial.forces.pressures[at_interface] > 0).any()
        if term.between and any(problem.comm.allgather(bool(pressed))):
            continue  # finite sliding
        motion_text = (
            f"moved {largest:.3g} mm apart or along each other, {100 * largest / size:.0f} % "
            "of the interface's size"
            if largest < size
            else "separated completely"
        )
        message = f"the sides of interface '{term.name}' {motion_text}"
        if largest > LARGEST_ELASTIC * forces / (term.modulus * size):
            floating = texts_of_floating_bodies(
                problem, trial, moved=True
            ) or texts_of_pulled_bodies(problem, contact)
            if floating or term.between:
                return Verdict(
                    "; ".join([*floating, message]), remedy=HOLD, code=Reason.FLOATING_BODY
                )
        if largest > NOT_SMALL * size + LEVER * largest_prescribed:
            remedy = (
                "use a smaller load or gap, stiffer springs or bodies, or `sliding: finite` where "
                "slip is larger than a facet"
            )
            message = f"displacements are no longer small: {message}"
            return Verdict(message, remedy=remedy, code=Reason.LARGE_DISPLACEMENT)
    return None


def warnings_of_floating_bodies(problem: Problem, trial: TrialState) -> list[Verdict]:
    """Warnings on bodies that nothing holds within their gaps in a converged state; collective.

    No load acts on such a body along its free motion, so any place in the gaps is an equilibrium.
    """
    contact, body_names = trial.contact, problem.bodies.names
    size = contact.motions.frame[1]
    gaps = contact.openings(trial.jump).max(axis=1)
    is_open = trial.forces.status == OPEN
    if not any(problem.comm.allgather(bool((is_open & (gaps > GAP * size)).any()))):
        return []
    rounding = UNPRESSED * contact.laws.augmentation * size
    is_unpressed = contact.laws.law_is_contact & (trial.forces.pressures.max(axis=1) <= rounding)
    motions = contact.motions_resisted_by_open_points(
        np.where(is_unpressed, OPEN, trial.forces.status)
    )
    centres = np.tile(contact.motions.frame[0], (len(body_names), 1))
    motion_texts = motions_in_words(
        motions, [f"'{name}'" for name in body_names], centres, *contact.motions.frame
    )
    place = "in the last state. Its position within the gaps is arbitrary"
    return [
        Verdict(f"{motion_text} {place}", CONTACT, HOLD, Severity.WARNING)
        for motion_text in motion_texts
    ]


def texts_of_pulled_bodies(problem: Problem, contact: ContactInterfaces) -> list[str]:
    """Sentences on bodies that the loads pull off all other bodies; collective.

    Rigid bodies press on springs at the contact points. The part of the loads that the springs do
    not bear is a motion. It opens all points or slides along them (a cone and its polar, Moreau).
    Springs give way, so single facets cannot bear this part by wedging. Friction due to the
    pressures may hold it. A taper that is pulled has no pressures: nothing bears its load, however
    small it is.
    """
    local, comm = contact.local, problem.comm
    unresisted = _motions_without_support(problem)
    if not unresisted.shape[1]:
        return []
    loads = unresisted.T @ _on_bodies(problem)
    jumps = contact.motions.relative(unresisted)
    frictions = _frictions(problem)
    # Motions are scaled by their mean square jump: a narrow interface resists rolling.
    gram = comm.allreduce(np.einsum("pia,pib->ab", jumps, jumps))
    metric = gram / max(comm.allreduce(len(local)), 1) + 1e-9 * np.eye(len(loads))
    scale = np.linalg.inv(np.linalg.cholesky(metric)).T
    # Bodies that friction holds may hide a frictionless slide. The second pass lets them stick.
    mixed = frictions.min() == 0 < frictions.max()
    may_stick = frictions[local.interface] > 0
    for stick in [np.zeros_like(may_stick), may_stick][: 1 + mixed]:
        springs, pressures = _compressed_springs(problem, contact, jumps, loads, stick)
        # A large load that springs bear must not hide a small load that nothing bears.
        sizes, motions = np.linalg.eigh(scale.T @ springs @ scale)
        free_motions = np.linalg.qr(scale @ motions[:, sizes < SPRING**2 * (1 / UNBORNE - 1)])[0]
        motion_texts = _pulls(
            problem, unresisted @ (free_motions @ (free_motions.T @ loads)), pressures
        )
        if motion_texts:
            return motion_texts
    return []


def _motions_without_support(problem: Problem) -> Floats:
    """Rigid motions of all bodies that no support resists, as columns (6 n, m); collective."""
    n = len(problem.bodies.names)
    resistance = np.zeros((n, 6, n, 6))
    for b, part in support_resistance_of_bodies(problem).items():
        resistance[b, :, b] += part
    sizes, motions = np.linalg.eigh(resistance.reshape(6 * n, 6 * n))
    return np.asarray(motions[:, sizes <= FREE * sizes[-1]])


def _compressed_springs(
    problem: Problem, contact: ContactInterfaces, jumps: Floats, loads: Floats, stick: Bools
) -> tuple[Floats, Floats]:
    """Stiffness of the compressed springs (m, m), and pressures of local faces (p, 3); collective.

    Args:
        problem: The problem.
        contact: Its interfaces.
        jumps: Jumps of local points by motions of the bodies (p, 3, m).
        loads: Work of the loads in these motions (m,).
        stick: True for points that stick if they are closed (p,).
    """
    openings = contact.local.normals @ jumps
    remaining_loads: Floats = loads
    springs = np.zeros((len(loads), len(loads)))
    pressures, shear = np.zeros((2, len(contact.local), 3))
    for _ in range(LOADINGS):
        for _ in range(MOST):  # Newton's method for compressed springs
            closing = openings @ remaining_loads < SPRING**2 * pressures
            sticking = closing.any(axis=1) & stick
            rows = np.vstack([openings[closing], jumps[sticking].reshape(-1, len(loads))])
            point_forces = np.concatenate([pressures[closing], shear[sticking].ravel()])
            springs, borne = (
                problem.comm.allreduce(rows.T @ part) for part in (rows, point_forces)
            )
            stiffness = np.eye(len(loads)) + springs / SPRING**2
            remaining_loads = np.linalg.solve(stiffness, loads + borne)
        pressures = np.maximum(0.0, pressures - openings @ remaining_loads / SPRING**2)
        shear = np.where(sticking[:, None], shear - jumps @ remaining_loads / SPRING**2, 0.0)
    return springs, pressures


def error_of_body_held_by_facets(problem: Problem, trial: TrialState) -> Verdict | None:
    """Return an error on a body in smooth contact that only its mesh holds; collective.

    The stiffness of contact in relative rigid motions of the bodies is divided by the stiffness
    from the spread of facet normals in the same motions. If the quotient is small, only the mesh
    resists. A slope common to all normals of an interface does not count as spread, so a taper
    resists, however slight.
    """
    smooth = [
        c.law.can_open and c.law.largest_friction == 0 and not c.between
        for c in problem.scene.contacts
    ]
    if not any(smooth):
        return None
    contact = trial.contact
    n = len(problem.bodies.names)
    R = contact.motions.jumps_by_motion
    unsupported = np.setdiff1d(np.arange(n), sorted(support_resistance_of_bodies(problem)))
    rows = (6 * unsupported[:, None] + np.arange(6)).ravel()
    resistances = _against_spread(problem, trial, R, np.array(smooth)[contact.local.interface])
    A, N = (x[np.ix_(rows, rows)] for x in resistances)
    if not A.any():
        return None
    # If all facets have the same normals, the spread is rounding alone.
    N += np.finfo(float).eps * np.trace(A) * np.eye(len(rows))
    scale = np.linalg.inv(np.linalg.cholesky(N))
    values, vectors = np.linalg.eigh(scale @ A @ scale.T)
    is_weak = values < SPREAD
    if not is_weak.any():
        return None
    # Part of the jumps in the span of such motions, by least squares.
    soft = np.zeros((6 * n, int(is_weak.sum())))
    soft[rows] = scale.T @ vectors[:, is_weak]
    motions_of_bodies = soft.reshape(n, 6, -1)
    master, slave = contact.local.bodies.T
    motion_of_points = np.einsum(
        "pij,pjk->pik", R, motions_of_bodies[slave] - motions_of_bodies[master]
    )
    areas, jump, global_sum = contact.local.weight, trial.jump, problem.comm.allreduce
    normal_change = global_sum(np.einsum("p,pi,pik->k", areas, jump, motion_of_points))
    gram = global_sum(np.einsum("p,pik,pil->kl", areas, motion_of_points, motion_of_points))
    amounts = np.linalg.lstsq(gram, normal_change, rcond=1e-12)[0]
    jump_square = global_sum(float(np.einsum("p,pi,pi->", areas, jump, jump)))
    if normal_change @ amounts <= PART * jump_square:
        return None
    body, mode = divmod(int(np.argmax(np.abs(soft @ amounts))), 6)
    largest_motion = float(np.linalg.norm(motion_of_points @ amounts, axis=1).max(initial=0.0))
    message = (
        f"only the facets of the mesh hold body '{problem.bodies.names[body]}': on a smooth "
        f"surface it is free to {DIRECTIONS[mode]}; it moved by "
        f"{max(problem.comm.allgather(largest_motion)):.3g} mm, a distance that depends on the mesh"
    )
    return Verdict(message, remedy=HOLD, code=Reason.FLOATING_BODY)


def _against_spread(
    problem: Problem, trial: TrialState, R: Floats, smooth: Bools
) -> tuple[Floats, Floats]:
    """Resistance to rigid motions R (p, 3, 6): of contact, and of the spread of normals."""
    contact, points = trial.contact, trial.contact.points
    r = np.where(trial.forces.status == OPEN, 0.0, contact.laws.augmentation * contact.local.weight)
    B = trial.forces.resisted
    # Friction holds a touching point, although its stiffness is zero while it slips.
    S = np.where(smooth[:, None, None], (B + B.transpose(0, 2, 1)) / 2, np.eye(3))
    normal_spread = spread_of_normals(points.surface.x, points.surface.normals, points.triangles)
    normal_spread = normal_spread[contact.local.rows]
    A, N = (
        _gathered(problem, r[:, None, None] * (R.transpose(0, 2, 1) @ at_points @ R))
        for at_points in (S, normal_spread)
    )
    # Random errors of normals cancel in the mean, so the mean counts once for each point.
    touching = np.einsum(
        "pk,pki->pi", (trial.forces.pressures > 0).astype(float), contact.local.normals
    )
    mean = r[:, None] * np.einsum("pij,pi->pj", R, touching)
    body_pairs = np.column_stack([points.interface, points.bodies])
    for i, m, s in np.unique(body_pairs, axis=0):
        is_pair = (body_pairs[contact.local.rows] == (i, m, s)).all(axis=1)
        local = (mean[is_pair].sum(axis=0), float(r[is_pair].sum()), int(is_pair.sum()))
        g, weight, count = (problem.comm.allreduce(x) for x in local)
        add_relative(A, m, s, count * np.outer(g, g) / (weight or 1.0))
    return A, N


def support_resistance_of_bodies(problem: Problem) -> dict[int, Floats]:
    """Resistance of active supports and foundations to rigid motions, by body (6, 6)."""
    from app.mechanics.stiffness import support_resistance  # imports dolfinx

    assert problem.contact is not None
    return support_resistance(problem.body_forms, problem.stiffness, *problem.contact.motions.frame)


def bodies_with_prescribed_motion(problem: Problem) -> list[int]:
    """Bodies with a prescribed motion, by number."""
    return [problem.bodies.body_of_region[m.region] for m in problem.scene.motions]
