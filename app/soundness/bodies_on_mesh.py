"""Bodies on a mesh, before solving: pieces that move together, and bodies that nothing holds.

`BodiesOnMesh` refuses a case in which a body floats. The pieces of the mesh are joined to bodies.
Each support removes the directions that it holds from the rigid motions of its body. A motion that
is left, and that contact with no other body resists, is free.

Facets of a mesh may hide a floating body. `app.soundness.loose_bodies` detects such bodies on the
contact points of a state, after solving.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from app.case.case import Case
from app.foundation.arrays import Floats, Ints
from app.foundation.verdict import Reason, Verdict, note
from app.laws.interface_laws import InterfaceLaw
from app.laws.supports import AnySupport
from app.laws.values import gap_at
from app.numerics.rigid_motions import add_relative, describe, rigid_modes
from app.soundness.loose_bodies import FREE
from app.system.layout import point_text
from meshes.pieces import Parts, Piece

# Contact without friction barely resists a motion if its mean slope against it is below this [deg].
SLOPE = 3.0
# The same for slopes of changing sign, as part of the angle between flat facets.
FACETS = 0.4


def law_between(
    case: Case, parts: Parts, pieces: tuple[int, int]
) -> tuple[str, InterfaceLaw | None]:
    """Interface between two pieces and its law; no name where there is none."""
    a, b = (parts.pieces[k].region for k in pieces)
    for name, (one, two) in case.geometry.interface_sides.items():
        if (a in one and b in two) or (a in two and b in one):
            return name, case.interfaces[name]
    return "", None


def groups_of(case: Case, parts: Parts) -> list[list[int]]:
    """Pieces that move together: bonded to each other, or of one region and joined."""
    laws = [(t.pieces, law_between(case, parts, t.pieces)[1]) for t in parts.touches]
    return _groups(parts, [pieces for pieces, law in laws if law is None or not law.can_open])


def bodies_of(case: Case, parts: Parts) -> list[list[int]]:
    """Return the pieces of each body; pieces that can move apart belong to different bodies."""
    laws = [(t.pieces, law_between(case, parts, t.pieces)[1]) for t in parts.touches]
    return _groups(parts, [pieces for pieces, law in laws if law is None or not law.can_part])


def _groups(parts: Parts, joined: list[tuple[int, int]]) -> list[list[int]]:
    label = list(range(len(parts.pieces)))
    for a, b in (*joined, *parts.joined):
        label = [label[a] if k == label[b] else k for k in label]
    return [[p for p, k in enumerate(label) if k == n] for n in sorted(set(label))]


def load_history_of(case: Case, values: Sequence[float] | None) -> tuple[float, ...]:
    """Load history of each stage, all ones by default."""
    return tuple(values) if values is not None else (1.0,) * len(case.stages)


def holds(support: AnySupport, stage: str) -> bool:
    """Return True if a support holds in a stage."""
    return support.stages is None or stage in support.stages


def directions(support: AnySupport, parts: Parts, nodes: Ints) -> Floats:
    """Directions that a support holds at nodes of its boundary, as rows (n, k, 3)."""
    normal = support.normal
    if normal == "face":
        return parts.normals[support.boundary][nodes][:, None]
    rows = np.eye(3)[["xyz".index(a) for a in support.held_axes]] if normal is None else [normal]
    return np.broadcast_to(rows, (len(nodes), len(rows), 3))


def gaps_of(case: Case, parts: Parts) -> dict[str, Floats]:
    """Gap at full amplitude at the nodes of each contact interface (n,) [mm]."""
    return {
        name: law.gap_field(name, case.geometry)(parts.x[parts.on_interface(name)])
        for name, law in case.interfaces.items()
        if law.can_open
    }


class BodiesOnMesh:
    """Rigid motions of groups of pieces that supports leave, and their resistance by contact."""

    def __init__(self, case: Case, parts: Parts) -> None:
        self._case, self._parts, self._groups = case, parts, groups_of(case, parts)
        self._of = {p: n for n, group in enumerate(self._groups) for p in group}
        self._origin = parts.x.mean(axis=0)
        self._size = float(np.linalg.norm(np.ptp(parts.x, axis=0)))
        self._laws: Mapping[str, InterfaceLaw] = case.interfaces
        # Touching pieces: name of the interface, and its two bodies.
        self._touches = [
            (t, law_between(case, parts, (a, b))[0], self._of[a], self._of[b])
            for t, (a, b) in ((t, t.pieces) for t in parts.touches)
        ]

    def unheld(self) -> list[Verdict]:
        """Errors for motions that nothing would resist if all touching bodies were bonded."""
        K, M = self._resistance(None)
        errors = []
        for k, left in self._left_by_supports():
            free, _ = self._free(left, K, M, FREE)
            cure = "expected a support, or contact with a body that is held"
            for text in self._words(free):
                what = f"{text}{self._when(k)}, by a support or by another body"
                errors.append(Verdict(what, "supports", cure, code=Reason.LOOSE_BODY))
        return errors

    def loosely_held(self) -> list[Verdict]:
        """Notes on motions barely resisted by contact, without friction or not yet closed."""
        gaps = gaps_of(self._case, self._parts)
        frictions = {n: self._laws[n].friction for n in gaps}
        notes: list[Verdict] = []
        for k, left in self._left_by_supports():
            free, steepest = self._sloped(left, frictions)
            slippery = [f"'{n}'" for n, μ in frictions.items() if not μ]
            by = f"contact on {' and '.join(slippery)} has no friction"
            if steepest > 1e-2:
                by += (
                    f" and resists only because the surface slopes by {steepest:.2g} degrees on "
                    "average, which may come from the facets of the mesh"
                )
            cure = "the displacement may be arbitrary; add friction or a support"
            for text in self._words(free):
                hardly = text.replace("nothing holds", "friction hardly holds")
                notes.append(note(f"{hardly}{self._when(k)}: {by}", cure=cure))
            start = {n: (gap, self._laws[n].gap_multipliers or ()) for n, gap in gaps.items()}
            apart = [n for n, gap in start.items() if gap_at(*gap, k + 1e-3).min() > 0]
            free, _ = self._free(left, *self._resistance(None, apart), FREE)
            names = " and ".join(f"'{n}'" for n in apart)
            cure = "hold the body by a support or a weak foundation, or start in contact"
            for text in self._words(free):
                what = (
                    f"{text}{self._when(k)} until {names} closes; an equilibrium exists only under "
                    "loads that close it"
                )
                notes.append(note(what, cure=cure))
        return list(dict.fromkeys(notes))

    def _modes(self, x: Floats) -> Floats:
        return rigid_modes((x - self._origin) / self._size)

    def _left_by_supports(self) -> Iterator[tuple[int, Floats]]:
        """Stages with changed supports, with the motions they leave free (6 n, k), orthonormal."""
        before, n = None, len(self._groups)
        for k, stage in enumerate(self._case.stages):
            here = [s for s in self._case.supports.values() if holds(s, stage.name)]
            if here == before:
                continue
            before, held = here, np.zeros((n, 6, 6))
            for s in here:
                for piece, nodes in self._parts.boundaries.get(s.boundary, {}).items():
                    modes = self._modes(self._parts.x[nodes])
                    rows = (directions(s, self._parts, nodes) @ modes).reshape(-1, 6)
                    held[self._of[piece]] += rows.T @ rows
            for m in self._case.motions.values():
                rotations = np.eye(6)[3:]
                given = rotations.T @ rotations
                if m.translation == "held":
                    shifts = self._modes(np.array([m.about]))[0]
                    given = given + shifts.T @ shifts
                for i, moved in enumerate(self._parts.pieces):
                    if moved.region == m.region:
                        held[self._of[i]] += given
            values, vectors = np.linalg.eigh(held)
            free = values <= FREE * np.maximum(values[:, -1:], np.finfo(float).tiny)
            left = [np.kron(np.eye(n)[:, [b]], vectors[b][:, free[b]]) for b in range(n)]
            yield k, np.hstack(left)

    def _resistance(
        self, shears: Mapping[str, float] | None, absent: Sequence[str] = ()
    ) -> tuple[Floats, Floats]:
        """Resistance of contact, and of each body where all is bonded (6 n, 6 n) [mm2].

        All interfaces resist sliding, or those of ``shears``; ``absent`` ones are open.
        """
        n = 6 * len(self._groups)
        K, M = np.zeros((n, n)), np.zeros((n, n))
        for touch, name, a, b in self._touches:
            if a == b or not name:
                continue
            R = self._modes(touch.x)
            every = np.einsum("f,fik,fil->kl", touch.areas, R, R)
            along = np.einsum("fik,fi->fk", R, touch.normals)
            normal = np.einsum("f,fk,fl->kl", touch.areas, along, along)
            if name not in absent:
                add_relative(K, a, b, every if shears is None or shears[name] else normal)
            for i in (a, b):
                M[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] += every
        return K, M

    @staticmethod
    def _free(left: Floats, K: Floats, M: Floats, below: float) -> tuple[Floats, Floats]:
        """Motions (6 n, k) that contact resists less than a part of bonded contact; parts (k,)."""
        if not left.shape[1]:
            return left, np.zeros(0)
        scale = max(float(np.trace(M)), 1.0) / len(M)
        metric = left.T @ M @ left + 1e-9 * scale * np.eye(left.shape[1])
        root = left @ np.linalg.inv(np.linalg.cholesky(metric)).T
        values, vectors = np.linalg.eigh(root.T @ K @ root)
        pick = values < below
        return root @ vectors[:, pick], np.maximum(values[pick], 0.0)

    def _sloped(self, left: Floats, frictions: Mapping[str, float]) -> tuple[Floats, float]:
        """Motions (6 n, k) that only smooth contact resists, and its steepest slope [degrees]."""
        smooth = [(t, a, b) for t, name, a, b in self._touches if frictions.get(name) == 0]
        bend = FACETS * max((t.bend for t, _, _ in smooth), default=0.0)
        K, M = self._resistance(frictions)
        least = math.radians(SLOPE)
        free, slopes = self._free(left, K, M, math.sin(max(least, bend)) ** 2)
        mean = np.zeros(free.shape[1])
        for t, a, b in smooth:
            v = free.reshape(len(self._groups), 6, free.shape[1])
            along = np.einsum("fik,fi->fk", self._modes(t.x), t.normals) @ (v[a] - v[b])
            mean += (t.areas @ along) ** 2 / t.areas.sum()
        resisted = np.einsum("ik,ij,jk->k", free, K, free)
        pick = (slopes < math.sin(least) ** 2) | (mean < 0.5 * resisted)
        steepest = math.asin(math.sqrt(float(slopes[pick].max(initial=0.0))))
        return free[:, pick], math.degrees(steepest)

    def _words(self, free: Floats) -> list[str]:
        pieces = [[self._parts.pieces[p] for p in group] for group in self._groups]
        moments = np.array([sum(p.volume * p.centre for p in group) for group in pieces])
        volumes = np.array([sum(p.volume for p in group) for group in pieces])
        names = [self._name(group) for group in pieces]
        return describe(free, names, moments / volumes[:, None], self._origin, self._size)

    def _name(self, group: list[Piece]) -> str:
        """Regions of a body, and its place if it is only part of them."""
        names = list(dict.fromkeys(p.region for p in group))
        text = f"'{' + '.join(names)}'"
        if sum(p.region in names for p in self._parts.pieces) == len(group):
            return text
        centre = max(group, key=lambda p: p.volume).centre
        cells = sum(p.cells for p in group)
        return f"{text} (the piece of {cells} cells at {point_text(centre)})"

    def _when(self, k: int) -> str:
        limited = any(s.stages for s in self._case.supports.values())
        return f" in stage '{self._case.stages[k].name}'" if limited else ""
