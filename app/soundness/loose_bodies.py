"""Rigid motions that neither supports nor contact hold, found before solving."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from app.arrays import Floats, Ints
from app.case.case import Case
from app.laws.values import field, gap_at
from app.numerics.rigid_motions import describe, rigid_modes
from meshes.pieces import Parts, Piece

# A motion is free if what resists it is below this part of what resists any; contact without
# friction hardly resists one that it is sloped against by less than so many degrees in the mean, or
# now this way and now that by less than this part of the angle between its flat facets.
FREE, SLOPE, FACETS = 1e-10, 3.0, 0.4


def law_between(case: Case, found: Parts, pieces: tuple[int, int]) -> tuple[str, Any]:
    """Interface between two pieces and its law; no name where there is none."""
    a, b = (found.pieces[k].region for k in pieces)
    for name, (one, two) in case.geometry.interface_sides.items():
        if (a in one and b in two) or (a in two and b in one):
            return name, case.interfaces[name]
    return "", None


def groups_of(case: Case, found: Parts) -> list[list[int]]:
    """Pieces that move together: bonded to each other, or of one region and joined."""
    label = list(range(len(found.pieces)))

    def join(a: int, b: int) -> None:
        old, new = label[b], label[a]
        label[:] = [new if k == old else k for k in label]

    for touch in found.touches:
        _, law = law_between(case, found, touch.pieces)
        if law is None or not law.can_open:
            join(*touch.pieces)
    for a, b in found.joined:
        join(a, b)
    return [[p for p, k in enumerate(label) if k == n] for n in sorted(set(label))]


def _name(found: Parts, group: list[int]) -> str:
    """Of a body: its regions, and where it is if it is not all there is of them."""
    names = list(dict.fromkeys(found.pieces[p].region for p in group))
    text = f"'{' + '.join(names)}'"
    others = {p.region for k, p in enumerate(found.pieces) if k not in group}
    if others.isdisjoint(names):
        return text
    largest: Piece = max((found.pieces[p] for p in group), key=lambda p: p.volume)
    cells = sum(found.pieces[p].cells for p in group)
    return f"{text} (the piece of {cells} cells at {place(largest.centre)})"


def place(x: Floats) -> str:
    """A point in words."""
    return "({:.4g}, {:.4g}, {:.4g}) mm".format(*x)


def holds(support: Any, stage: str) -> bool:
    """Whether a support holds in a stage."""
    stages = getattr(support, "stages", None)
    return stages is None or stage in stages


def directions(support: Any, found: Parts, nodes: Ints) -> Floats:
    """Directions that a support holds at nodes of its boundary, as rows (n, k, 3)."""
    normal = getattr(support, "normal", None)
    if normal == "face":
        return found.normals[support.boundary][nodes][:, None]
    rows = np.eye(3)[["xyz".index(a) for a in support.held_axes]] if normal is None else [normal]
    return np.broadcast_to(rows, (len(nodes), len(rows), 3))


def _holding(case: Case) -> Iterator[tuple[int, dict[str, Any]]]:
    """Supports that hold in each stage, once where they are those of the stage before."""
    before: dict[str, Any] = {}
    for k, stage in enumerate(case.stages):
        here = {name: s for name, s in case.supports.items() if holds(s, stage.name)}
        if k == 0 or here != before:
            yield k, here
        before = here


class _Bodies:
    """Rigid motions of groups of pieces: what supports leave, and how contact resists it."""

    def __init__(self, case: Case, found: Parts, groups: list[list[int]]) -> None:
        self._case, self._found, self._groups = case, found, groups
        self.names = [_name(found, g) for g in groups]
        self._of = {p: n for n, g in enumerate(groups) for p in g}
        self._origin = found.x.mean(axis=0)
        self._size = float(np.linalg.norm(np.ptp(found.x, axis=0)))

    def _modes(self, x: Floats) -> Floats:
        return rigid_modes((x - self._origin) / self._size)

    def left(self, supports: Iterable[Any]) -> Floats:
        """Motions that supports leave (6 n, k), orthonormal."""
        n = len(self._groups)
        held = np.zeros((n, 6, 6))
        for s in supports:
            for piece, nodes in self._found.boundaries.get(s.boundary, {}).items():
                modes = self._modes(self._found.x[nodes])
                rows = (directions(s, self._found, nodes) @ modes).reshape(-1, 6)
                held[self._of[piece]] += rows.T @ rows
        blocks = []
        for b in range(n):
            values, vectors = np.linalg.eigh(held[b])
            free = vectors[:, values <= FREE * max(values[-1], np.finfo(float).tiny)]
            block = np.zeros((6 * n, free.shape[1]))
            block[6 * b : 6 * b + 6] = free
            blocks.append(block)
        return np.hstack(blocks)

    def resistance(
        self, shears: Mapping[str, float] | None, absent: Iterable[str] = ()
    ) -> tuple[Floats, Floats]:
        """Resistance of closed contact, and of contact that is all bonded (6 n, 6 n) [mm2].

        Args:
            shears: Whether each interface resists sliding; None: all do.
            absent: Interfaces that are open.
        """
        n = 6 * len(self._groups)
        K, M = np.zeros((n, n)), np.zeros((n, n))
        for touch in self._found.touches:
            name, law = law_between(self._case, self._found, touch.pieces)
            a, b = (self._of[p] for p in touch.pieces)
            if a == b or law is None:
                continue
            R = self._modes(touch.x)
            every = np.einsum("f,fik,fil->kl", touch.areas, R, R)
            along = np.einsum("fik,fi->fk", R, touch.normals)
            normal = np.einsum("f,fk,fl->kl", touch.areas, along, along)
            part = every if shears is None or shears[name] else normal
            for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
                at = np.s_[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
                if name not in absent:
                    K[at] += sign * part
                if i == j:
                    M[at] += every
        return K, M

    def free(self, left: Floats, K: Floats, M: Floats, below: float) -> tuple[Floats, Floats]:
        """Motions that supports leave and contact resists less than that, and how much.

        Returns:
            Motions (6 n, k), and their resistance over that of bonded contact (k,).
        """
        if not left.shape[1]:
            return left, np.zeros(0)
        scale = max(float(np.trace(M)), 1.0) / len(M)
        metric = left.T @ M @ left + 1e-9 * scale * np.eye(left.shape[1])
        root = np.linalg.inv(np.linalg.cholesky(metric))
        values, vectors = np.linalg.eigh(root @ left.T @ K @ left @ root.T)
        pick = values < below
        return left @ root.T @ vectors[:, pick], np.maximum(values[pick], 0.0)

    def sloped(self, left: Floats, frictions: Mapping[str, float]) -> tuple[Floats, float]:
        """Motions that only contact without friction resists, and hardly.

        Returns:
            Motions (6 n, k), and the steepest mean slope against them [degrees].
        """
        smooth = [
            t
            for t in self._found.touches
            if frictions.get(law_between(self._case, self._found, t.pieces)[0]) == 0
        ]
        bend = FACETS * max((t.bend for t in smooth), default=0.0)
        K, M = self.resistance(frictions)
        least = math.radians(SLOPE)
        free, slopes = self.free(left, K, M, math.sin(max(least, bend)) ** 2)
        mean = np.zeros(free.shape[1])
        for t in smooth:
            a, b = (self._of[p] for p in t.pieces)
            v = free.reshape(len(self._groups), 6, free.shape[1])
            along = np.einsum("fik,fi->fk", self._modes(t.x), t.normals) @ (v[a] - v[b])
            mean += (t.areas @ along) ** 2 / t.areas.sum()
        resisted = np.einsum("ik,ij,jk->k", free, K, free)
        pick = (slopes < math.sin(least) ** 2) | (mean < 0.5 * resisted)
        steepest = math.asin(math.sqrt(float(slopes[pick].max(initial=0.0))))
        return free[:, pick], math.degrees(steepest)

    def words(self, free: Floats) -> list[str]:
        """Sentences on them."""
        centres = np.array(
            [
                np.average(
                    [self._found.pieces[p].centre for p in g],
                    axis=0,
                    weights=[self._found.pieces[p].volume for p in g],
                )
                for g in self._groups
            ]
        )
        return describe(free, self.names, centres, self._origin, self._size)


def _when(case: Case, k: int) -> str:
    """In which stage, where that matters."""
    limited = any(getattr(s, "stages", None) for s in case.supports.values())
    return f" in stage '{case.stages[k].name}'" if limited else ""


def unheld(case: Case, found: Parts, groups: list[list[int]]) -> list[str]:
    """Motions that nothing would resist if all that touches were bonded."""
    bodies = _Bodies(case, found, groups)
    K, M = bodies.resistance(None)
    errors = []
    for k, supports in _holding(case):
        free, _ = bodies.free(bodies.left(supports.values()), K, M, FREE)
        errors += [
            f"supports: {text}{_when(case, k)}, by a support or by another body; expected a "
            "support, or contact with a body that is held"
            for text in bodies.words(free)
        ]
    return errors


def gaps_of(case: Case, found: Parts) -> dict[str, Floats]:
    """Gap at full amplitude at the nodes of each contact interface (n,) [mm]."""
    laws: Mapping[str, Any] = case.interfaces
    return {
        name: field(f"interfaces.{name}.gap", law.initial_gap[0])(found.x[found.interfaces[name]])
        for name, law in laws.items()
        if law.can_open
    }


def history_of(case: Case, values: Sequence[float] | None) -> tuple[float, ...]:
    """A history, all ones by default."""
    return tuple(values) if values is not None else (1.0,) * len(case.stages)


def loosely_held(case: Case, found: Parts, groups: list[list[int]]) -> list[str]:
    """Motions that only contact without friction resists, and hardly; or contact not yet closed."""
    bodies = _Bodies(case, found, groups)
    gaps = gaps_of(case, found)
    laws: Mapping[str, Any] = case.interfaces
    frictions = {n: laws[n].friction for n in gaps}
    notes: list[str] = []
    for k, supports in _holding(case):
        left = bodies.left(supports.values())
        free, steepest = bodies.sloped(left, frictions)
        if free.shape[1]:
            slippery = [f"'{n}'" for n, μ in frictions.items() if not μ]
            smooth = f"contact on {' and '.join(slippery)}"
            by = (
                f"{smooth} has no friction and resists only by a mean slope of {steepest:.2g} "
                "degrees, which may come from the facets of the mesh"
                if steepest > 1e-2
                else f"{smooth} has no friction"
            )
            notes += [
                f"{text.replace('nothing holds', 'hardly anything holds')}{_when(case, k)}: {by}; "
                "the displacement may be arbitrary; add friction or a support"
                for text in bodies.words(free)
            ]
        begins = {
            n: gap_at(gap, laws[n].initial_gap[1] or (), k + 1e-3).min() for n, gap in gaps.items()
        }
        open_ = {n for n, gap in begins.items() if gap > 0}
        K, M = bodies.resistance(None, open_)
        free, _ = bodies.free(left, K, M, FREE)
        names = " and ".join(f"'{n}'" for n in gaps if n in open_)
        notes += [
            f"{text}{_when(case, k)} until {names} closes, which starts open: only loads that "
            "close it find an equilibrium; hold the body by a support or a weak foundation, or "
            "start in contact"
            for text in bodies.words(free)
        ]
    return list(dict.fromkeys(notes))
