"""Parts of a mesh as its case sees them: laws between pieces, supported directions, gaps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.laws.interface_laws import InterfaceLaw
from app.laws.supports import AnySupport
from app.laws.values import field
from meshes.pieces import Parts

if TYPE_CHECKING:
    from app.case.case import Case


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
    stages = getattr(support, "stages", None)
    return stages is None or stage in stages


def directions(support: AnySupport, parts: Parts, nodes: Ints) -> Floats:
    """Directions that a support holds at nodes of its boundary, as rows (n, k, 3)."""
    normal = getattr(support, "normal", None)
    if normal == "face":
        return parts.normals[support.boundary][nodes][:, None]
    rows = np.eye(3)[["xyz".index(a) for a in support.held_axes]] if normal is None else [normal]
    return np.broadcast_to(rows, (len(nodes), len(rows), 3))


def gaps_of(case: Case, parts: Parts) -> dict[str, Floats]:
    """Gap at full amplitude at the nodes of each contact interface (n,) [mm]."""
    return {
        name: field(f"interfaces.{name}.gap", law.initial_gap[0])(parts.x[parts.on_interface(name)])
        for name, law in case.interfaces.items()
        if law.can_open
    }
