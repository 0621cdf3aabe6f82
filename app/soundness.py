"""Whether a case on its mesh can be solved at all, and whether it says what was meant.

What is certainly wrong is an error before anything is solved; what is rarely meant is told.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from app import config
from app.errors import InputError
from app.materials import Conductor, Rigid
from app.rigid_motions import describe, modes
from app.scene_heat import field
from app.terms import amplitude
from meshes.parts import Parts, Piece, parts

if TYPE_CHECKING:
    from meshes import MeshData

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A motion is free if what resists it is below this part of what resists any; contact without
# friction hardly resists one that it is sloped against by less than so many degrees in the mean.
FREE, SLOPE = 1e-10, 3.0
# Gaps beyond this part of the interface or of the bodies are no small displacements, an interference
# beyond that part of the bodies cannot be; given displacements may slide a body, but not so far.
SMALL, TOO_MUCH, FAR = 0.05, 1.0, 0.5
# Strains beyond which small-strain elasticity says nothing of any material.
STRAIN = 0.05
# A piece is a shell if its volume over half its surface is below this part of its middle extent; it
# is one cell thick if nearly all of its cells have all their corners on its surface.
THIN, ONE_CELL = 0.3, 0.8
# Part of the points of an interface that supports have to hold on both sides before it is told.
MOSTLY = 0.5
# Diagonals of anything in a human body or at a bench [mm].
SIZES = (1.0, 3000.0)
# Two given displacements differ if they do by this part of the larger.
SAME = 1e-9


def judge(case: config.Case, data: MeshData) -> list[str]:
    """What is suspicious about a case on its mesh.

    Args:
        case: The case.
        data: Its mesh.

    Raises:
        InputError: It cannot be solved: with all the reasons.
    """
    held = {getattr(s, "boundary", "") for s in case.supports.values()}
    found = parts(data, held)
    notes = [*_cracks(case, found), *_size(case, found)]
    if all(isinstance(region, Conductor) for region in case.regions.values()):
        return notes
    groups = _groups(case, found)
    errors = [*_unheld(case, found, groups), *_too_tight(case, found)]
    if errors:
        # A crack is often why.
        raise InputError([*errors, *(f"note: {n}" for n in notes)])
    return [
        *notes,
        *_loosely_held(case, found, groups),
        *_contradictions(case, found),
        *_clamped(case, found),
        *_large(case, found),
        *_one_cell_thick(case, found),
        *_strained(case, found),
    ]


# What holds the bodies


def _law(case: config.Case, found: Parts, pieces: tuple[int, int]) -> tuple[str, Any]:
    """Interface between two pieces and its law; no name where there is none."""
    a, b = (found.pieces[k].region for k in pieces)
    for name, (one, two) in case.geometry.interface_sides.items():
        if (a in one and b in two) or (a in two and b in one):
            return name, case.interfaces[name]
    return "", None


def _groups(case: config.Case, found: Parts) -> list[list[int]]:
    """Pieces that move together: bonded to each other, or of one region and joined."""
    label = list(range(len(found.pieces)))

    def join(a: int, b: int) -> None:
        old, new = label[b], label[a]
        label[:] = [new if k == old else k for k in label]

    for touch in found.touches:
        _, law = _law(case, found, touch.pieces)
        if getattr(law, "friction_coefficient", None) is None:
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
    return f"{text} (the piece of {cells} cells at {_place(largest.centre)})"


def _place(x: Floats) -> str:
    return "({:.4g}, {:.4g}, {:.4g}) mm".format(*x)


def _holding(case: config.Case) -> Iterator[tuple[int, dict[str, Any]]]:
    """Supports that hold in each stage, once where they are those of the stage before."""
    before: dict[str, Any] = {}
    for k, stage in enumerate(case.stages):
        here = {
            name: s
            for name, s in case.supports.items()
            if getattr(s, "stages", None) is None or stage.name in s.stages
        }
        if k == 0 or here != before:
            yield k, here
        before = here


class _Bodies:
    """Rigid motions of groups of pieces: what supports leave, and how contact resists it."""

    def __init__(self, case: config.Case, found: Parts, groups: list[list[int]]) -> None:
        self._case, self._found, self._groups = case, found, groups
        self.names = [_name(found, g) for g in groups]
        self._of = {p: n for n, g in enumerate(groups) for p in g}
        self._origin = found.x.mean(axis=0)
        self._size = float(np.linalg.norm(np.ptp(found.x, axis=0)))

    def _modes(self, x: Floats) -> Floats:
        return modes((x - self._origin) / self._size)

    def left(self, supports: Iterable[Any]) -> Floats:
        """Motions that supports leave (6 n, k), orthonormal."""
        n = len(self._groups)
        held = np.zeros((n, 6, 6))
        for s in supports:
            axes = ["xyz".index(a) for a in s.held_axes]
            for piece, nodes in self._found.boundaries.get(s.boundary, {}).items():
                rows = self._modes(self._found.x[nodes])[:, axes].reshape(-1, 6)
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
        """What contact that is closed resists, and the same if all were bonded (6 n, 6 n) [mm2].

        Args:
            shears: Whether each interface resists sliding; None: all do.
            absent: Interfaces that are open.
        """
        n = 6 * len(self._groups)
        K, M = np.zeros((n, n)), np.zeros((n, n))
        for touch in self._found.touches:
            name, law = _law(self._case, self._found, touch.pieces)
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


def _when(case: config.Case, k: int) -> str:
    """In which stage, where that matters."""
    limited = any(getattr(s, "stages", None) for s in case.supports.values())
    return f" in stage '{case.stages[k].name}'" if limited else ""


def _unheld(case: config.Case, found: Parts, groups: list[list[int]]) -> list[str]:
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


def _gaps(case: config.Case, found: Parts) -> dict[str, Floats]:
    """Gap at full amplitude at the nodes of each contact interface (n,) [mm]."""
    gaps = {}
    for name, law in case.interfaces.items():
        if getattr(law, "friction_coefficient", None) is None:
            continue
        x = found.x[found.interfaces[name]]
        gaps[name] = field(f"interfaces.{name}.gap", law.gap)(x)
    return gaps


def _history(case: config.Case, values: Sequence[float] | None) -> tuple[float, ...]:
    return tuple(values) if values is not None else (1.0,) * len(case.stages)


def _loosely_held(case: config.Case, found: Parts, groups: list[list[int]]) -> list[str]:
    """Motions that only contact without friction resists, and hardly; or contact not yet closed."""
    bodies = _Bodies(case, found, groups)
    gaps = _gaps(case, found)
    frictions = {n: case.interfaces[n].friction_coefficient for n in gaps}
    notes: list[str] = []
    for k, supports in _holding(case):
        left = bodies.left(supports.values())
        K, M = bodies.resistance(frictions)
        free, slopes = bodies.free(left, K, M, math.sin(math.radians(SLOPE)) ** 2)
        if free.shape[1]:
            steepest = math.degrees(math.asin(math.sqrt(float(slopes.max()))))
            smooth = " and ".join(f"'{n}'" for n, μ in frictions.items() if not μ)
            by = (
                f"the surface of {smooth} is sloped against that by {steepest:.2g} degrees in the "
                "mean, which may be no more than its facets"
                if steepest > 1e-3
                else f"{smooth} has no friction"
            )
            notes += [
                f"{text.replace('nothing holds', 'hardly anything holds')}{_when(case, k)}: {by}; "
                "where it ends may be arbitrary: add friction or a support"
                for text in bodies.words(free)
            ]
        begins = {
            n: amplitude(_history(case, case.interfaces[n].gap_history), k + 1e-3) * gap.min()
            for n, gap in gaps.items()
        }
        open_ = {n for n, gap in begins.items() if gap > 0}
        K, M = bodies.resistance(None, open_)
        free, _ = bodies.free(left, K, M, FREE)
        names = " and ".join(f"'{n}'" for n in gaps if n in open_)
        notes += [
            f"{text}{_when(case, k)} until {names} closes, which is open everywhere at first: if "
            "loads alone are to close it there is no equilibrium on the way; hold the body by a "
            "support or a weak foundation, or begin in contact"
            for text in bodies.words(free)
        ]
    return list(dict.fromkeys(notes))


# What contradicts itself


def _given(case: config.Case, support: Any, name: str, axis: str, x: Floats) -> Floats:
    """What a support gives at points, at the end of each stage (stages, n) [mm]."""
    value = getattr(support, axis, None) or 0.0
    factors = np.array(_history(case, getattr(support, "history", None)))
    return np.asarray(factors[:, None] * field(f"supports.{name}.{axis}", value)(x))


def _contradictions(case: config.Case, found: Parts) -> list[str]:
    """Nodes that two supports give different displacements."""
    holding = {
        name: {
            "nodes": np.unique(np.concatenate([*found.boundaries[s.boundary].values()])),
            "stages": [
                getattr(s, "stages", None) is None or t.name in s.stages for t in case.stages
            ],
        }
        for name, s in case.supports.items()
        if s.kind != "foundation" and found.boundaries.get(s.boundary)
    }
    notes = []
    names = list(holding)
    for i, one in enumerate(names):
        for two in names[i + 1 :]:
            a, b = case.supports[one], case.supports[two]
            nodes = np.intersect1d(holding[one]["nodes"], holding[two]["nodes"])
            both = np.logical_and(holding[one]["stages"], holding[two]["stages"])
            for axis in sorted(set(a.held_axes) & set(b.held_axes)) if len(nodes) else ():
                x = found.x[nodes]
                first, second = (_given(case, s, n, axis, x)[both] for s, n in ((a, one), (b, two)))
                size = max(np.abs(first).max(initial=0.0), np.abs(second).max(initial=0.0))
                differ = (np.abs(first - second) > SAME * size).any(axis=0)
                if differ.any():
                    notes.append(
                        f"supports.{one} and supports.{two} give {int(differ.sum())} common nodes "
                        f"different displacements along {axis}, such as the one at "
                        f"{_place(x[int(np.argmax(differ))])}: it follows '{two}', and stresses "
                        "there grow without limit as the mesh is refined"
                    )
    return notes


def _clamped(case: config.Case, found: Parts) -> list[str]:
    """Interfaces whose both sides supports hold along all axes."""
    notes = []
    for name in _gaps(case, found):
        held = []
        for side in case.geometry.interface_sides[name]:
            axes = np.zeros((len(found.x), 3), dtype=bool)
            for s in case.supports.values():
                if s.kind == "foundation":
                    continue
                for piece, nodes in found.boundaries.get(s.boundary, {}).items():
                    if found.pieces[piece].region in side:
                        axes[np.ix_(nodes, ["xyz".index(a) for a in s.held_axes])] = True
            held.append(axes.all(axis=1))
        both = float(np.mean((held[0] & held[1])[found.interfaces[name]]))
        if both > MOSTLY:
            notes.append(
                f"supports hold both sides of interface '{name}' at {100 * both:.0f} % of its "
                "nodes: it can neither open nor slip there"
            )
    return notes


# What is out of proportion


def _sides(case: config.Case, found: Parts, name: str) -> tuple[list[float], float]:
    """Mean thickness behind each elastic side of an interface, and the size of it [mm]."""
    touches = [t for t in found.touches if _law(case, found, t.pieces)[0] == name]
    area = sum(float(t.areas.sum()) for t in touches)
    near = {p for t in touches for p in t.pieces}
    thickness = []
    for side in case.geometry.interface_sides[name]:
        pieces = [found.pieces[p] for p in near if found.pieces[p].region in side]
        if not any(isinstance(case.regions[p.region], Rigid) for p in pieces):
            thickness.append(sum(p.volume for p in pieces) / area)
    x = np.concatenate([t.x for t in touches])
    return thickness, float(np.linalg.norm(np.ptp(x, axis=0)))


def _largest(case: config.Case, law: Any, gap: Floats) -> tuple[float, float]:
    """Largest interference and smallest gap of an interface over all stages [mm]."""
    factors = [0.0, *_history(case, law.gap_history)]
    ends = [f * g for f in factors for g in (float(gap.min()), float(gap.max()))]
    return -min(ends), float(gap.min()) * factors[-1]


def _too_tight(case: config.Case, found: Parts) -> list[str]:
    """Interferences that the bodies have no room for."""
    errors = []
    for name, gap in _gaps(case, found).items():
        interference, _ = _largest(case, case.interfaces[name], gap)
        thickness, _ = _sides(case, found, name)
        if thickness and interference >= TOO_MUCH * sum(thickness):
            errors.append(
                f"interfaces.{name}.gap: an interference of {interference:.3g} mm is more than the "
                f"bodies that have to give way to it are thick ({sum(thickness):.3g} mm): no "
                "contact is admissible; expected a smaller one (in which unit is it?)"
            )
    return errors


def _large(case: config.Case, found: Parts) -> list[str]:
    """Gaps and given displacements that are no small ones."""
    notes = []
    for name, gap in _gaps(case, found).items():
        interference, apart = _largest(case, case.interfaces[name], gap)
        thickness, size = _sides(case, found, name)
        if thickness and interference > SMALL * sum(thickness):
            notes.append(
                f"interfaces.{name}.gap: an interference of {interference:.3g} mm strains bodies "
                f"of {sum(thickness):.3g} mm by more than small strains: a wrong unit?"
            )
        if apart > SMALL * size:
            notes.append(
                f"interfaces.{name}.gap: the sides are {apart:.3g} mm apart everywhere, on an "
                f"interface of {size:.3g} mm: small displacements do not bring them together"
            )
    whole = float(np.linalg.norm(np.ptp(found.x, axis=0)))
    for name, s in case.supports.items():
        if s.kind != "displacement" or not found.boundaries.get(s.boundary):
            continue
        x = found.x[np.concatenate([*found.boundaries[s.boundary].values()])]
        most = max(
            float(np.abs(_given(case, s, name, axis, x)).max(initial=0.0)) for axis in s.held_axes
        )
        if most > FAR * whole:
            notes.append(
                f"supports.{name} moves a model of {whole:.3g} mm by {most:.3g} mm, which is no "
                "small displacement: a wrong unit?"
            )
    return notes


def _strained(case: config.Case, found: Parts) -> list[str]:
    """Loads that the material under them cannot bear, by three decades or so."""
    notes = []
    for name, load in case.loads.items():
        if load.kind not in ("force", "pressure"):
            continue
        area = found.boundary_areas.get(load.boundary, 0.0)
        under = {found.pieces[p].region for p in found.boundaries.get(load.boundary, {})}
        moduli = [m for r in under if (m := modulus(case.regions[r]))]
        if not area or not moduli:
            continue
        factor = max(map(abs, _history(case, load.history)), default=1.0)
        stress = abs(load.pressure) if load.kind == "pressure" else math.hypot(*load.force) / area
        stress *= factor
        if stress > STRAIN * min(moduli):
            notes.append(
                f"loads.{name} is {stress:.3g} MPa on boundary '{load.boundary}', beside a modulus "
                f"of {min(moduli):.3g} MPa: strains are not small; a wrong unit?"
            )
    return notes


def modulus(region: Any) -> float:
    """Smallest Young's modulus of a region, 0 if it has none [MPa]."""
    keys = ("youngs_modulus", "axial_youngs_modulus", "transverse_youngs_modulus")
    return min((getattr(region, k) for k in keys if hasattr(region, k)), default=0.0)


def doubts(case: config.Case, numbers: Mapping[str, Any]) -> list[str]:
    """What is suspicious about results: strains that are not small.

    Args:
        case: The case.
        numbers: Of its regions, by name.
    """
    notes = []
    for name, found in numbers.items():
        E = modulus(case.regions[name])
        strain = found["von_mises_p99"] / E if E else 0.0
        if strain > STRAIN:
            notes.append(
                f"region '{name}' is strained by {100 * strain:.2g} % (stress over modulus): small "
                "strains no longer describe it; is a modulus or a load in a wrong unit?"
            )
    return notes


# What is wrong with the mesh


def _cracks(case: config.Case, found: Parts) -> list[str]:
    """Nodes that coincide without being one."""
    notes = []
    for (a, b), x in found.doubled.items():
        where = f"regions '{a}' and '{b}'" if a != b else f"region '{a}'"
        notes.append(
            f"{where}: {len(x)} pairs of nodes coincide but are not one, such as those at "
            f"{_place(x[0])}: a crack that nothing closes or holds together; if it is not meant, "
            "merge them (in gmsh BooleanFragments before meshing, or Coherence Mesh after it)"
        )
    return notes


def _size(case: config.Case, found: Parts) -> list[str]:
    """A mesh file in another unit."""
    size = float(np.linalg.norm(np.ptp(found.x, axis=0)))
    if case.geometry.kind != "file" or SIZES[0] <= size <= SIZES[1]:
        return []
    return [
        f"geometry: the mesh is {size:.3g} mm from corner to corner: is its unit "
        f"{case.geometry.unit}?"
    ]


def _one_cell_thick(case: config.Case, found: Parts) -> list[str]:
    """Thin regions with one linear cell through them."""
    if case.mesh.order != 1:
        return []
    thin = {
        p.region: None
        for p in found.pieces
        if p.flat > ONE_CELL
        and 2 * p.volume / p.surface < THIN * float(np.median(p.box))
        and modulus(case.regions[p.region])
    }
    return [
        f"region '{name}' is thin and one cell thick: linear tetrahedra are far too stiff where it "
        "bends; use mesh.order: 2, or a mesh.size of less than half its thickness"
        for name in thin
    ]
