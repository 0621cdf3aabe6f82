"""Floating bodies of a state: rigid motions that neither supports nor contact hold.

The functions detect floating bodies on the contact points of a state, after a solve. Before
solving, `app.soundness.bodies_on_mesh` detects them on the parts of a mesh.

Facets may hide a floating body. A smooth stem can rotate in its cement without resistance. On a
mesh the mean normals of curved facets are off by a fraction of the angle between them. Contact then
resists the rotation, with a stiffness that depends on the mesh alone
(`error_of_body_held_by_facets`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Bools, Floats
from app.foundation.verdict import Reason, Severity, Verdict
from app.interfaces.faces import spread_of_normals
from app.interfaces.smooth_normals import LIKELY_MULTIPLE
from app.numerics.rigid_motions import (
    DIRECTIONS,
    FREE_RESISTANCE,
    add_relative,
    motions_in_words,
    motions_outside,
    relative_resistance,
)
from forms.contact import OPEN

if TYPE_CHECKING:  # they import dolfinx, which the check of a case does not need
    from app.mechanics.contact import ContactInterfaces, TrialState
    from app.mechanics.problem import Problem

# Supports fix a body if they resist every translation with more than this fraction of the
# resistance of a rigid support.
FIXED_RESISTANCE = 1e-3
# A body slides if this fraction of its touching area is at the friction limit.
SLIDING_AREA_FRACTION = 0.95
# A point is at the friction limit if its friction is at least this fraction of the limit.
FRICTION_LIMIT_FRACTION = 1 - 1e-6
# A free body runs away if its jumps exceed this fraction of the size of the interfaces [-].
RUNAWAY_JUMP = 0.05
# Their size must also exceed this multiple of load / (modulus of the softer side x size). It is 5
# for a stem wedged by friction, 70 for a frictionless taper of 1.5 degrees, and 600 for a straight
# frictionless stem.
LARGEST_ELASTIC_JUMP = 200.0
# Displacements are not small beyond this fraction of the size of the interfaces, even if something
# resists.
LARGEST_SMALL_JUMP = 0.2
# Largest ratio of the motion of an interface, by a lever, to the largest prescribed displacement.
LEVER_RATIO = 10.0
# Compliance of the springs between rigid bodies. With this value a taper of 1 degree with 100
# points bears 99 % of a push.
SPRING_COMPLIANCE = 0.02**2
# Loads are in balance along a motion if their work is less than this fraction of its upper bound.
# The bound assumes that all loads act along the motion. A smaller remainder is error of the solver.
BALANCED_WORK = 1e-8
# Springs do not bear a direction if more than this fraction of a load along it remains.
UNBORNE_FRACTION = 0.1
# Largest number of iterations for the set of compressed springs.
MAX_SPRING_ITERATIONS = 20
# Number of loadings of the springs, each by the load that remains. With one loading, a body under a
# large load sinks into its springs and loses contact with another one under a small load.
SPRING_LOADINGS = 2
# Facets alone hold a motion if the ratio of the resistance of contact to that of randomly spread
# normals is below this (0.01 for a smooth stem that rotates, 0.8 to 100 where its taper resists).
FACET_RESISTANCE_RATIO = 0.25
# Such a motion counts if its square exceeds this fraction of the squared jumps (0.003 in a push,
# 0.15 in a rotation).
FACET_MOTION_FRACTION = 0.05
# Bodies are apart if their gap exceeds this fraction of the size of the interfaces [-].
OPEN_GAP = 1e-8
# A pressure below this fraction of (stiffness per area x size) counts as zero.
ZERO_PRESSURE = 1e-10
# Subject of verdicts on contact.
VERDICT_SUBJECT = "contact"
# Remedy for a body that nothing holds.
HOLD_REMEDY = "hold the body (a support, friction, an elastic foundation)"


def texts_of_floating_bodies(problem: Problem, trial: TrialState, moved: bool = False) -> list[str]:
    """Sentences on free motions: no support and no closed contact resists them; collective.

    The resistance of contact is the generalized Jacobian at each point, projected onto the relative
    rigid motions of the two bodies.

    Args:
        problem: The problem.
        trial: Its state.
        moved: True to leave out `ContactMotions.unresisted`: the solver removes these motions.
    """
    contact, body_names = trial.contact, problem.bodies.names
    x = contact.points.x
    centre, size = contact.motions.frame
    weight = contact.local.weight
    resisted = np.where(trial.forces.touching[:, None, None], trial.forces.resisted, 0.0)
    R = contact.motions.jumps_by_motion
    of_points = weight[:, None, None] * (R.transpose(0, 2, 1) @ resisted @ R)
    A = _summed_resistance(problem, of_points)
    total = float(np.sum(contact.points.weight))
    support_resistance = support_resistance_of_bodies(problem)
    # A body with a prescribed motion counts as held here, but not in `texts_of_pulled_bodies`.
    body_of_region = problem.bodies.body_of_region
    support_resistance |= {body_of_region[m.region]: np.eye(6) for m in problem.scene.motions}
    for body, part in support_resistance.items():
        A[6 * body : 6 * body + 6, 6 * body : 6 * body + 6] += total * part
    values, vectors = np.linalg.eigh((A + A.T) / 2)
    free_vectors = vectors[:, values <= FREE_RESISTANCE * max(values[-1], total)]
    if moved:
        unresisted = contact.unresisted_motions(trial.forces)
        free_vectors = motions_outside(free_vectors, unresisted)
    at_body = [(contact.points.bodies == b).any(axis=1) for b in range(len(body_names))]
    centres = np.array([x[mask].mean(axis=0) if mask.any() else centre for mask in at_body])
    return motions_in_words(
        free_vectors, [f"'{name}'" for name in body_names], centres, centre, size
    )


def texts_of_pushed_bodies(problem: Problem, trial: TrialState) -> list[str]:
    """Sentences on bodies that loads, however small, push along unresisted motions; collective."""
    contact = trial.contact
    motions = contact.unresisted_motions(trial.forces)
    motion = motions @ (motions.T @ _load_work_of_bodies(problem))
    pressures = contact.local.weight[:, None] * trial.forces.pressures
    return _texts_of_unborne_motion(problem, motion, pressures)


def _load_work_of_bodies(problem: Problem) -> Floats:
    """Work of the loads in the rigid motions of all bodies (6 n,) [N]; collective."""
    assert problem.contact is not None
    R = problem.contact.motions.rigid(_owned_nodes(problem))
    return problem.forces.work_on_bodies(problem.load_time, R).ravel()


def _owned_nodes(problem: Problem) -> Floats:
    """Owned nodes of the displacement (n, 3) [mm]."""
    owned = problem.space.dofmap.index_map.size_local
    return np.asarray(problem.space.tabulate_dof_coordinates()[:owned])


def _holding_friction(problem: Problem) -> Floats:
    """Friction coefficients of local points that may hold a body (p,)."""
    contact = problem.contact
    assert contact is not None
    # Friction with finite sliding does not hold a body: a ball can leave its cup.
    slides = np.array([bool(c.between) for c in problem.scene.parting_interfaces])
    return np.where(slides[contact.local.interface], 0.0, contact.laws.friction_coefficient)


def _texts_of_unborne_motion(problem: Problem, motion: Floats, pressures: Floats) -> list[str]:
    """Sentences on bodies that the loads move along a rigid motion; collective.

    Contact resists by friction and where the motion closes a face. Errors of normals rotate the
    axis of a free motion. So contact may bear loads along it; their uncertainty counts as friction.

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
    friction = _holding_friction(problem) + facet_friction
    sliding_resistance = friction * np.linalg.norm(jump, axis=1)
    resisted = problem.comm.allreduce(
        float((pressures * (closing + sliding_resistance[:, None])).sum())
    )
    R = contact.motions.rigid(_owned_nodes(problem))
    motion_of_bodies = np.einsum("nik,bk->bni", R, motion.reshape(len(body_names), 6))
    rounding = BALANCED_WORK * problem.forces.work_bound(problem.load_time, motion_of_bodies)
    if motion @ _load_work_of_bodies(problem) <= resisted + rounding:
        return []
    motion_texts = _texts_of_motions(problem, contact, motion[:, None])
    return [f"{motion_text}, and the loads act in this direction" for motion_text in motion_texts]


def _texts_of_motions(problem: Problem, contact: ContactInterfaces, motions: Floats) -> list[str]:
    """Sentences on motions of all bodies (6 n, k), with rotations about the common origin."""
    names = [f"'{name}'" for name in problem.bodies.names]
    origin, size = contact.motions.frame
    return motions_in_words(motions, names, np.tile(origin, (len(names), 1)), origin, size)


def _summed_resistance(problem: Problem, resistance: Floats) -> Floats:
    """Resistance of all n bodies (6 n, 6 n), summed over local points (p, 6, 6); collective."""
    assert problem.contact is not None
    bodies, n = problem.contact.local.bodies, len(problem.bodies.names)
    return np.asarray(problem.comm.allreduce(relative_resistance(resistance, bodies, n)))


def warnings_of_sliding_bodies(problem: Problem, contact: ContactInterfaces) -> list[Verdict]:
    """Warnings on bodies that friction alone holds, near its limit; collective.

    The state is the last converged one. The bodies may slide off under a larger load. This is not
    certain, so smaller steps are still tried.
    """
    normal = np.linalg.norm(contact.state.force - contact.state.friction, axis=1)
    shear = np.linalg.norm(contact.state.friction, axis=1)
    limit = contact.laws.friction_coefficient * normal
    fixed_bodies = {
        b
        for b, part in support_resistance_of_bodies(problem).items()
        if np.linalg.eigvalsh(part[:3, :3])[0] > FIXED_RESISTANCE
        and np.linalg.eigvalsh(part)[0] > FREE_RESISTANCE
    }
    verdicts = []
    for i, c in enumerate(problem.scene.parting_interfaces):
        is_pressed = (contact.local.interface == i) & (normal > 0)
        slips = is_pressed & (shear >= FRICTION_LIMIT_FRACTION * limit)
        local = np.array(
            [contact.local.weight[slips].sum(), contact.local.weight[is_pressed].sum()]
        )
        slip, touch = problem.comm.allreduce(local)
        bodies = problem.comm.allgather(set(contact.local.bodies[is_pressed].ravel().tolist()))
        unsupported = set().union(*bodies) - fixed_bodies
        slides = touch and slip >= SLIDING_AREA_FRACTION * touch
        if c.law.largest_friction > 0 and slides and unsupported:
            names = [f"'{problem.bodies.names[b]}'" for b in sorted(unsupported)]
            bodies_text = f"{'body' if len(names) == 1 else 'bodies'} {' and '.join(names)}"
            message = (
                f"friction hardly holds {bodies_text}: {100 * slip / touch:.0f} % of the "
                f"contact area of interface '{c.name}' slips in the last converged state"
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
    forces = sum(float(np.linalg.norm(r)) for r in problem.forces.resultants(problem.load_time))
    largest_prescribed = max(
        problem.comm.allgather(float(np.abs(problem.prescribed).max(initial=0.0)))
    )
    if not (forces or largest_prescribed):
        return None
    size = contact.motions.frame[1]
    # Closing a gap or making room for an interference is not running away.
    distance = np.linalg.norm(trial.jump, axis=1) - np.linalg.norm(contact.gaps.initial_gap, axis=1)
    for i, c in enumerate(problem.scene.parting_interfaces):
        at_interface = contact.local.interface == i
        largest = max(problem.comm.allgather(float(distance[at_interface].max(initial=0.0))))
        if largest <= RUNAWAY_JUMP * size + LEVER_RATIO * largest_prescribed:
            continue
        pressed = (trial.forces.pressures[at_interface] > 0).any()
        if c.between and any(problem.comm.allgather(bool(pressed))):
            continue  # finite sliding
        share = f"{100 * largest / size:.0f} % of" if largest < size else "more than"
        message = (
            f"the sides of interface '{c.name}' moved {largest:.3g} mm apart or along each "
            f"other, {share} the interface's size"
        )
        if largest > LARGEST_ELASTIC_JUMP * forces / (c.modulus * size):
            floating = texts_of_floating_bodies(
                problem, trial, moved=True
            ) or texts_of_pulled_bodies(problem, contact)
            if floating or c.between:
                return Verdict(
                    "; ".join([*floating, message]), remedy=HOLD_REMEDY, code=Reason.FLOATING_BODY
                )
        if largest > LARGEST_SMALL_JUMP * size + LEVER_RATIO * largest_prescribed:
            remedy = (
                "use a smaller load or gap, stiffer springs or bodies, or `sliding: finite` where "
                "slip is larger than a facet"
            )
            message = f"displacements are no longer small: {message}"
            return Verdict(message, remedy=remedy, code=Reason.LARGE_DISPLACEMENT)
    return None


def error_of_expelled_body(problem: Problem, trial: TrialState) -> Verdict | None:
    """Return an error if a press fit has pushed a body out that nothing holds; collective.

    Its interface touches nowhere, and is open further than its sides overlapped at first. Such a
    state is in equilibrium wherever the body is, so the loads need not act for it to be wrong.
    """
    contact, comm = trial.contact, problem.comm
    if not any(c.press_fit for c in problem.scene.parting_interfaces):
        return None
    overlaps = -contact.gaps.openings(np.zeros_like(trial.jump)).min(axis=1)
    openings = contact.gaps.openings(trial.jump).max(axis=1)
    for i, c in enumerate(problem.scene.parting_interfaces):
        if not c.press_fit:
            continue
        at_interface = contact.local.interface == i
        touches = bool(trial.forces.touching[at_interface].any())
        overlap, opening = (
            max(comm.allgather(float(values[at_interface].max(initial=0.0))))
            for values in (overlaps, openings)
        )
        if any(comm.allgather(touches)) or not 0 < overlap < opening:
            continue
        floating = texts_of_floating_bodies(problem, trial)
        if floating:
            message = (
                f"the interference of interface '{c.name}', up to {1e3 * overlap:.3g} um, pushed"
                " its sides apart: they touch nowhere"
            )
            texts = "; ".join([*floating, message])
            return Verdict(texts, remedy=HOLD_REMEDY, code=Reason.FLOATING_BODY)
    return None


def warnings_of_floating_bodies(problem: Problem, trial: TrialState) -> list[Verdict]:
    """Warnings on bodies that nothing holds within their gaps in a converged state; collective.

    No load acts on such a body along its free motion, so any place in the gaps is an equilibrium.
    """
    contact, size = trial.contact, trial.contact.motions.frame[1]
    gaps = contact.gaps.openings(trial.jump).max(axis=1)
    is_open = ~trial.forces.touching
    if not any(problem.comm.allgather(bool((is_open & (gaps > OPEN_GAP * size)).any()))):
        return []
    rounding = ZERO_PRESSURE * contact.laws.augmentation * size
    is_unpressed = trial.forces.pressures.max(axis=1) <= rounding
    status = np.where(is_unpressed, OPEN, trial.forces.status)
    motions = contact.motions_resisted_by_open_points(replace(trial.forces, status=status))
    motion_texts = _texts_of_motions(problem, contact, motions)
    place = "in the last state. Its position within the gaps is arbitrary"
    return [
        Verdict(f"{motion_text} {place}", VERDICT_SUBJECT, HOLD_REMEDY, Severity.WARNING)
        for motion_text in motion_texts
    ]


def texts_of_pulled_bodies(problem: Problem, contact: ContactInterfaces) -> list[str]:
    """Sentences on bodies that the loads pull off all other bodies; collective.

    Rigid bodies press on springs at the contact points. The part of the loads that the springs do
    not bear is a motion. This motion opens or slides at every point (a cone and its polar, Moreau).
    The springs are soft, so no single facet can wedge a body. Friction due to the pressures may
    hold it. A taper that is pulled has no pressures: nothing bears its load, however small it is.
    """
    local, comm = contact.local, problem.comm
    unresisted = _motions_without_support(problem)
    if not unresisted.shape[1]:
        return []
    loads = unresisted.T @ _load_work_of_bodies(problem)
    jumps = contact.motions.relative(unresisted)
    # Motions are scaled by their mean square jump: a narrow interface resists rolling.
    gram = comm.allreduce(np.einsum("pia,pib->ab", jumps, jumps))
    metric = gram / comm.allreduce(len(local)) + 1e-9 * np.eye(len(loads))
    scale = np.linalg.inv(np.linalg.cholesky(metric)).T
    # Bodies that friction holds may hide a frictionless slide. The second pass lets them stick.
    may_stick = _holding_friction(problem) > 0
    some_stick, some_slide = comm.allreduce(np.array([may_stick.sum(), (~may_stick).sum()])) > 0
    passes = [np.zeros_like(may_stick)]
    if some_stick and some_slide:
        passes.append(may_stick)
    for stick in passes:
        springs, pressures = _compressed_springs(problem, contact, jumps, loads, stick)
        # A large load that springs bear must not hide a small load that nothing bears.
        sizes, motions = np.linalg.eigh(scale.T @ springs @ scale)
        is_unborne = sizes < SPRING_COMPLIANCE * (1 / UNBORNE_FRACTION - 1)
        free_motions = np.linalg.qr(scale @ motions[:, is_unborne])[0]
        motion_texts = _texts_of_unborne_motion(
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
    return np.asarray(motions[:, sizes <= FREE_RESISTANCE * sizes[-1]])


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
    for _ in range(SPRING_LOADINGS):
        for _ in range(MAX_SPRING_ITERATIONS):  # Newton's method for compressed springs
            closing = openings @ remaining_loads < SPRING_COMPLIANCE * pressures
            sticking = closing.any(axis=1) & stick
            rows = np.vstack([openings[closing], jumps[sticking].reshape(-1, len(loads))])
            point_forces = np.concatenate([pressures[closing], shear[sticking].ravel()])
            springs, borne = (
                problem.comm.allreduce(rows.T @ part) for part in (rows, point_forces)
            )
            stiffness = np.eye(len(loads)) + springs / SPRING_COMPLIANCE
            remaining_loads = np.linalg.solve(stiffness, loads + borne)
        pressures = np.maximum(0.0, pressures - openings @ remaining_loads / SPRING_COMPLIANCE)
        shear = np.where(
            sticking[:, None], shear - jumps @ remaining_loads / SPRING_COMPLIANCE, 0.0
        )
    return springs, pressures


def error_of_body_held_by_facets(problem: Problem, trial: TrialState) -> Verdict | None:
    """Return an error on a body in smooth contact that only its mesh holds; collective.

    The stiffness of contact in relative rigid motions of the bodies is divided by the stiffness
    from the spread of facet normals in the same motions. If the quotient is small, only the mesh
    resists. The mean slope of an interface is not spread, so even a slight taper resists.
    """
    contact = trial.contact
    laws = contact.laws
    has_given_pairs = np.array([not c.between for c in problem.scene.parting_interfaces])
    is_smooth = (
        laws.can_open & ~laws.has_friction & has_given_pairs[contact.local.interface]
    ) & ~trial.forces.bonded
    if not any(problem.comm.allgather(bool(is_smooth.any()))):
        return None
    n = len(problem.bodies.names)
    R = contact.motions.jumps_by_motion
    unsupported = np.setdiff1d(np.arange(n), sorted(support_resistance_of_bodies(problem)))
    rows = (6 * unsupported[:, None] + np.arange(6)).ravel()
    resistances = _resistances(problem, trial, R, is_smooth)
    of_contact, of_spread = (matrix[np.ix_(rows, rows)] for matrix in resistances)
    if not of_contact.any():
        return None
    # If all facets have the same normals, the spread is rounding alone.
    of_spread += np.finfo(float).eps * np.trace(of_contact) * np.eye(len(rows))
    scale = np.linalg.inv(np.linalg.cholesky(of_spread))
    values, vectors = np.linalg.eigh(scale @ of_contact @ scale.T)
    is_weak = values < FACET_RESISTANCE_RATIO
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
    if normal_change @ amounts <= FACET_MOTION_FRACTION * jump_square:
        return None
    body, mode = divmod(int(np.argmax(np.abs(soft @ amounts))), 6)
    largest_motion = float(np.linalg.norm(motion_of_points @ amounts, axis=1).max(initial=0.0))
    message = (
        f"only the facets of the mesh hold body '{problem.bodies.names[body]}': on a smooth "
        f"surface it is free to {DIRECTIONS[mode]}; it moved by "
        f"{max(problem.comm.allgather(largest_motion)):.3g} mm, a distance that depends on the mesh"
    )
    return Verdict(message, remedy=HOLD_REMEDY, code=Reason.FLOATING_BODY)


def _resistances(
    problem: Problem, trial: TrialState, R: Floats, smooth: Bools
) -> tuple[Floats, Floats]:
    """Resistance to rigid motions R (p, 3, 6): of contact, and of the spread of normals."""
    contact, points = trial.contact, trial.contact.points
    r = np.where(trial.forces.touching, contact.laws.augmentation * contact.local.weight, 0.0)
    resisted = trial.forces.resisted
    symmetric_part = (resisted + resisted.transpose(0, 2, 1)) / 2
    # Friction holds a touching point, although its stiffness is zero while it slips.
    contact_strength = np.where(smooth[:, None, None], symmetric_part, np.eye(3))
    normal_spread = spread_of_normals(points.surface.x, points.surface.normals, points.triangles)
    normal_spread = normal_spread[contact.local.rows]
    of_contact, of_spread = (
        _summed_resistance(problem, r[:, None, None] * (R.transpose(0, 2, 1) @ at_points @ R))
        for at_points in (contact_strength, normal_spread)
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
        if weight:
            add_relative(of_contact, m, s, count * np.outer(g, g) / weight)
    return of_contact, of_spread


def support_resistance_of_bodies(problem: Problem) -> dict[int, Floats]:
    """Resistance of active supports and foundations to rigid motions, by body (6, 6)."""
    from app.mechanics.stiffness import support_resistance  # imports dolfinx

    assert problem.contact is not None
    return support_resistance(problem.body_forms, problem.stiffness, *problem.contact.motions.frame)
