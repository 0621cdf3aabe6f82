"""Bodies on a mesh, before solving: pieces that move together, and bodies that nothing holds.

`well_posedness.check_on_mesh` refuses a case with `verdicts_on_held_bodies`. The pieces of the
mesh are joined to bodies. A rigid motion is free if no support of its body holds it, and no contact
with another body would resist it even if it were bonded.

Facets of a mesh may hide a floating body. `app.soundness.floating_bodies_of_state` detects such
bodies on the contact points of a state, after solving.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from app.case.case import Case
from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.layout import point_text
from app.foundation.verdict import Reason, Verdict, note
from app.laws.interface_laws import InterfaceLaw
from app.laws.supports import AnySupport
from app.laws.values import gap_at
from app.numerics.rigid_motions import (
    FREE_RESISTANCE,
    add_relative,
    motions_in_words,
    rigid_modes,
)
from meshes.data import connected
from meshes.pieces import MeshPieces, Piece, Touch

# Contact without friction barely resists a motion if its mean slope against it is below this [deg].
SLOPE = 3.0
# The same limit for slopes that cancel in the mean, as a fraction of the angle between facets.
FACETS = 0.4
# Time after the start of a stage at which gaps are judged, as a fraction of the stage.
JUST_AFTER = 1e-3


def law_between(
    case: Case, parts: MeshPieces, pieces: tuple[int, int]
) -> tuple[str, InterfaceLaw | None]:
    """Name of the interface between two pieces, empty if there is none, and its law."""
    a, b = (parts.pieces[k].region for k in pieces)
    for name, (first_side, second_side) in case.geometry.interface_sides.items():
        if (a in first_side and b in second_side) or (a in second_side and b in first_side):
            return name, case.interfaces[name]
    return "", None


def pieces_of_groups(case: Case, parts: MeshPieces) -> list[list[int]]:
    """Pieces that move together: bonded to each other, or of one region and joined."""
    laws = [(t.pieces, law_between(case, parts, t.pieces)[1]) for t in parts.touches]
    return _groups(parts, [pieces for pieces, law in laws if law is None or not law.can_open])


def pieces_of_bodies(case: Case, parts: MeshPieces) -> list[list[int]]:
    """Return the pieces of each body; pieces that can move apart belong to different bodies."""
    laws = [(t.pieces, law_between(case, parts, t.pieces)[1]) for t in parts.touches]
    return _groups(parts, [pieces for pieces, law in laws if law is None or not law.can_part])


def _groups(parts: MeshPieces, joined_pairs: list[tuple[int, int]]) -> list[list[int]]:
    """Pieces of each group. Pairs join pieces; pieces that share nodes are joined, too."""
    pairs = np.array([*joined_pairs, *parts.joined], dtype=np.int64).reshape(-1, 2)
    group_of_piece = connected(len(parts.pieces), pairs[:, 0], pairs[:, 1])
    groups: list[list[int]] = [[] for _ in range(int(group_of_piece.max(initial=-1)) + 1)]
    for piece, group in enumerate(group_of_piece):
        groups[group].append(piece)
    return groups


def load_history_of(case: Case, values: Sequence[float] | None) -> tuple[float, ...]:
    """Load history of each stage, all ones by default."""
    return tuple(values) if values is not None else (1.0,) * len(case.stages)


def holds(support: AnySupport, stage: str) -> bool:
    """Return True if a support holds in a stage."""
    return support.stages is None or stage in support.stages


def directions(support: AnySupport, parts: MeshPieces, nodes: Ints) -> Floats:
    """Directions that a support holds at nodes of its boundary, as rows (n, k, 3)."""
    normal = support.normal
    if normal == "face":
        return parts.normals[support.boundary][nodes][:, None]
    rows = np.eye(3)[["xyz".index(a) for a in support.held_axes]] if normal is None else [normal]
    return np.broadcast_to(rows, (len(nodes), len(rows), 3))


def gaps_of(case: Case, parts: MeshPieces) -> dict[str, Floats]:
    """Gap at full amplitude at the nodes of each interface that can open (n,) [mm]."""
    return {
        name: law.gap_field(name, case.geometry)(parts.x[parts.on_interface(name)])
        for name, law in case.interfaces.items()
        if law.can_open
    }


def verdicts_on_held_bodies(case: Case, parts: MeshPieces) -> list[Verdict]:
    """Errors on bodies that nothing holds; if there are none, notes on those barely held."""
    groups = GroupsOnMesh(case, parts)
    return groups.errors_of_floating() or groups.notes_on_loosely_held()


class GroupsOnMesh:
    """Rigid motions of groups of pieces that supports leave, and their resistance by contact."""

    def __init__(self, case: Case, parts: MeshPieces) -> None:
        self._case, self._parts, self._groups = case, parts, pieces_of_groups(case, parts)
        self._group_of_piece = {p: n for n, group in enumerate(self._groups) for p in group}
        self._origin = parts.x.mean(axis=0)
        self._size = float(np.linalg.norm(np.ptp(parts.x, axis=0)))
        self._laws: Mapping[str, InterfaceLaw] = case.interfaces
        # Touching pieces: name of the interface, facets that slide freely, and the two groups.
        self._touches: list[tuple[Touch, str, Bools, int, int]] = []
        for touch in parts.touches:
            group_a, group_b = (self._group_of_piece[piece] for piece in touch.pieces)
            interface = law_between(case, parts, touch.pieces)[0]
            if group_a != group_b and interface:
                resists = self._laws[interface].resists_sliding(interface, case.geometry)(touch.x)
                self._touches.append((touch, interface, ~resists, group_a, group_b))

    def errors_of_floating(self) -> list[Verdict]:
        """Errors for motions that nothing would resist if all touching bodies were bonded."""
        contact_resistance, bonded_resistance = self._resistance()
        errors = []
        for k, left_by_supports in self._left_by_supports():
            free_motions, _ = self._free_motions(
                left_by_supports, contact_resistance, bonded_resistance, FREE_RESISTANCE
            )
            remedy = "add a support, or contact with a body that is held"
            for motion_text in self._motion_texts(free_motions):
                verdict_text = f"{motion_text}{self._when(k)}, by a support or by another body"
                errors.append(Verdict(verdict_text, "supports", remedy, code=Reason.FLOATING_BODY))
        return errors

    def notes_on_loosely_held(self) -> list[Verdict]:
        """Notes on motions barely resisted by contact, without friction or not yet closed."""
        gaps = gaps_of(self._case, self._parts)
        smooth = self._smooth_interfaces()
        notes: list[Verdict] = []
        for k, left_by_supports in self._left_by_supports():
            free_motions, steepest = self._weakly_held_motions(left_by_supports)
            reason = f"contact on {' and '.join(smooth)} has no friction"
            if steepest > 1e-2:
                reason += (
                    f" and resists only because the surface slopes by {steepest:.2g} degrees on "
                    "average, which may come from the facets of the mesh"
                )
            reason += ". The displacement may be arbitrary"
            remedy = "add friction or a support"
            for motion_text in self._motion_texts(free_motions, "friction hardly holds"):
                notes.append(note(f"{motion_text}{self._when(k)}: {reason}", remedy=remedy))
            gaps_in_time = {
                n: (gap, self._laws[n].gap_multipliers or ()) for n, gap in gaps.items()
            }
            open_interfaces = [
                n for n, gap in gaps_in_time.items() if gap_at(*gap, k + JUST_AFTER).min() > 0
            ]
            free_motions, _ = self._free_motions(
                left_by_supports, *self._resistance(absent=open_interfaces), FREE_RESISTANCE
            )
            interface_names = " and ".join(f"'{n}'" for n in open_interfaces)
            remedy = "hold the body by a support or a weak foundation, or start in contact"
            for motion_text in self._motion_texts(free_motions):
                verdict_text = (
                    f"{motion_text}{self._when(k)} until {interface_names} closes; an equilibrium "
                    "exists only under loads that close it"
                )
                notes.append(note(verdict_text, remedy=remedy))
        return list(dict.fromkeys(notes))

    def _modes(self, x: Floats) -> Floats:
        return rigid_modes((x - self._origin) / self._size)

    def _left_by_supports(self) -> Iterator[tuple[int, Floats]]:
        """Stages in which supports change, and the motions that they leave free (6 n, k).

        The motions are orthonormal.
        """
        previous_supports, n = None, len(self._groups)
        for k, stage in enumerate(self._case.stages):
            active_supports = [s for s in self._case.supports.values() if holds(s, stage.name)]
            if active_supports == previous_supports:
                continue
            previous_supports, resistance = active_supports, np.zeros((n, 6, 6))
            for s in active_supports:
                for number, nodes in self._parts.boundaries.get(s.boundary, {}).items():
                    modes = self._modes(self._parts.x[nodes])
                    rows = (directions(s, self._parts, nodes) @ modes).reshape(-1, 6)
                    resistance[self._group_of_piece[number]] += rows.T @ rows
            for m in self._case.motions.values():
                rotations = np.eye(6)[3:]
                guided_rotations = rotations.T @ rotations
                if m.translation == "held":
                    shifts = self._modes(np.array([m.about]))[0]
                    guided_rotations = guided_rotations + shifts.T @ shifts
                for number, piece in enumerate(self._parts.pieces):
                    if piece.region == m.region:
                        resistance[self._group_of_piece[number]] += guided_rotations
            values, vectors = np.linalg.eigh(resistance)
            is_free = values <= FREE_RESISTANCE * np.maximum(values[:, -1:], np.finfo(float).tiny)
            free_vectors = [np.kron(np.eye(n)[:, [b]], vectors[b][:, is_free[b]]) for b in range(n)]
            yield k, np.hstack(free_vectors)

    def _smooth_interfaces(self) -> list[str]:
        """Interfaces that slide freely, or whose parts do, as text."""
        slides: dict[str, list[Bools]] = {}
        for _, name, slides_freely, *_ in self._touches:
            slides.setdefault(name, []).append(slides_freely)
        facets_of_interface = {name: np.concatenate(masks) for name, masks in slides.items()}
        return [
            f"'{name}'" if mask.all() else f"parts of '{name}'"
            for name, mask in facets_of_interface.items()
            if mask.any()
        ]

    def _resistance(
        self, *, all_stick: bool = True, absent: Sequence[str] = ()
    ) -> tuple[Floats, Floats]:
        """Resistance of contact, and of each body bonded to its surroundings (6 n, 6 n) [mm2].

        Args:
            all_stick: True if all facets resist sliding, also those that slide freely.
            absent: Interfaces that are open and resist nothing.
        """
        n = 6 * len(self._groups)
        contact_resistance, bonded_resistance = np.zeros((n, n)), np.zeros((n, n))
        for touch, name, slides_freely, a, b in self._touches:
            R = self._modes(touch.x)
            shared_resistance = np.einsum("f,fik,fil->kl", touch.areas, R, R)
            if name not in absent:
                sticks = np.full(len(R), True) if all_stick else ~slides_freely
                slides = ~sticks
                normal_motions = np.einsum("fik,fi->fk", R[slides], touch.normals[slides])
                resistance = np.einsum("f,fik,fil->kl", touch.areas[sticks], R[sticks], R[sticks])
                resistance += np.einsum(
                    "f,fk,fl->kl", touch.areas[slides], normal_motions, normal_motions
                )
                add_relative(contact_resistance, a, b, resistance)
            for i in (a, b):
                bonded_resistance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] += shared_resistance
        return contact_resistance, bonded_resistance

    @staticmethod
    def _free_motions(
        left_by_supports: Floats,
        contact_resistance: Floats,
        bonded_resistance: Floats,
        below: float,
    ) -> tuple[Floats, Floats]:
        """Motions with less than a part of the bonded resistance (6 n, k), and their parts (k,)."""
        if not left_by_supports.shape[1]:
            return left_by_supports, np.zeros(0)
        scale = max(float(np.trace(bonded_resistance)), 1.0) / len(bonded_resistance)
        metric = left_by_supports.T @ bonded_resistance @ left_by_supports + 1e-9 * scale * np.eye(
            left_by_supports.shape[1]
        )
        root = left_by_supports @ np.linalg.inv(np.linalg.cholesky(metric)).T
        # Generalized eigenproblem K v = λ M v in the space that supports leave, with the resistance
        # K of contact and the bonded resistance M.
        values, vectors = np.linalg.eigh(root.T @ contact_resistance @ root)
        is_free = values < below
        return root @ vectors[:, is_free], np.maximum(values[is_free], 0.0)

    def _weakly_held_motions(self, left_by_supports: Floats) -> tuple[Floats, float]:
        """Motions that only the slope of smooth contact resists (6 n, k); largest slope [deg]."""
        smooth = [(t, slides, a, b) for t, _, slides, a, b in self._touches if slides.any()]
        bend = FACETS * max((t.bend for t, *_ in smooth), default=0.0)
        contact_resistance, bonded_resistance = self._resistance(all_stick=False)
        smallest_slope = math.radians(SLOPE)
        free_motions, slopes = self._free_motions(
            left_by_supports,
            contact_resistance,
            bonded_resistance,
            math.sin(max(smallest_slope, bend)) ** 2,
        )
        mean = np.zeros(free_motions.shape[1])
        for t, slides, a, b in smooth:
            v = free_motions.reshape(len(self._groups), 6, free_motions.shape[1])
            of_facets = np.einsum("fik,fi->fk", self._modes(t.x), t.normals)
            areas = t.areas * slides
            mean += (areas @ of_facets @ (v[a] - v[b])) ** 2 / areas.sum()
        resisted = np.einsum("ik,ij,jk->k", free_motions, contact_resistance, free_motions)
        is_weak = (slopes < math.sin(smallest_slope) ** 2) | (mean < 0.5 * resisted)
        steepest = math.asin(math.sqrt(float(slopes[is_weak].max(initial=0.0))))
        return free_motions[:, is_weak], math.degrees(steepest)

    def _motion_texts(self, free_motions: Floats, verb: str = "nothing holds") -> list[str]:
        pieces = [[self._parts.pieces[p] for p in group] for group in self._groups]
        moments = np.array([sum(p.volume * p.centre for p in group) for group in pieces])
        volumes = np.array([sum(p.volume for p in group) for group in pieces])
        body_names = [self._name(group) for group in pieces]
        return motions_in_words(
            free_motions, body_names, moments / volumes[:, None], self._origin, self._size, verb
        )

    def _name(self, group: list[Piece]) -> str:
        """Regions of a group, and its place if it is only part of them."""
        region_names = list(dict.fromkeys(p.region for p in group))
        body_name = f"'{' + '.join(region_names)}'"
        if sum(p.region in region_names for p in self._parts.pieces) == len(group):
            return body_name
        centre = max(group, key=lambda p: p.volume).centre
        cells = sum(p.cells for p in group)
        return f"{body_name} (the piece of {cells} cells at {point_text(centre)})"

    def _when(self, k: int) -> str:
        limited = any(s.stages for s in self._case.supports.values())
        return f" in stage '{self._case.stages[k].name}'" if limited else ""
