"""What a scene is made of: small frozen records, each calling one function of `forms`.

A term knows the regions or boundaries it acts on, its constants and how it changes over the stages
(``history``); it does not know the mesh, the other terms or the solver. What a scene does not
contain is an empty tuple of terms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ufl.core.expr import Expr

from forms import elasticity, loads

Floats = NDArray[np.float64]
# Values at points (n, 3) [mm].
Field = Callable[[Floats], Floats]


def amplitude(history: Sequence[float], time: float) -> float:
    """Multiplier at a time: stage k runs from k to k + 1, its end value is ``history[k]``."""
    return float(np.interp(time, np.arange(len(history) + 1), [0.0, *history]))


@dataclass(frozen=True)
class Eigenstrain:
    """A stress-free strain of a region: components xx, yy, zz, yz, xz, xy at full amplitude."""

    components: tuple[float, float, float, float, float, float]
    history: tuple[float, ...]


@dataclass(frozen=True)
class Elastic:
    """An elastic region.

    Attributes:
        region: Its name.
        coefficients: Elastic coefficients of eq. 48 [MPa]: two if isotropic, else five.
        fibre: Fibre direction; empty if isotropic.
        modulus: Largest Young's modulus [MPa]: what "softer" and "stiffer" compare.
        eigenstrains: Stress-free strains.
    """

    region: str
    coefficients: tuple[float, ...]
    fibre: tuple[float, ...]
    modulus: float
    eigenstrains: tuple[Eigenstrain, ...]

    def energy(self, ε: Expr, coefficients: Sequence[Any], fibre: Any) -> Expr:
        """Strain energy density ψ(ε) [MPa], its constants handed in as UFL constants."""
        if self.fibre:
            return elasticity.transversely_isotropic_energy(ε, fibre, *coefficients)
        return elasticity.isotropic_energy(ε, *coefficients)


@dataclass(frozen=True)
class RigidBody:
    """A region that moves without deforming."""

    region: str


@dataclass(frozen=True)
class Foundation:
    """A bed of springs on a boundary, stiffness (3,) [MPa/mm]."""

    boundary: str
    stiffness: tuple[float, float, float]

    def energy(self, v: Expr, k: Any) -> Expr:
        """Energy per area [N/mm]."""
        return loads.foundation_energy(k, v)


@dataclass(frozen=True)
class Support:
    """Given displacement components on a boundary.

    Attributes:
        name: Name in the case file.
        boundary: Boundary name.
        components: Which of x, y, z are given.
        values: Their values (n, 3) at points at full amplitude [mm].
        history: Amplitudes at the ends of the stages.
    """

    name: str
    boundary: str
    components: tuple[bool, bool, bool]
    values: Field
    history: tuple[float, ...]


@dataclass(frozen=True)
class Force:
    """A resultant force [N] on a patch, through a point [mm] or spread evenly (no point)."""

    name: str
    boundary: str
    force: tuple[float, float, float]
    at: tuple[float, ...]
    history: tuple[float, ...]


@dataclass(frozen=True)
class Pressure:
    """A pressure [MPa] on a boundary, positive when it compresses."""

    name: str
    boundary: str
    pressure: float
    history: tuple[float, ...]


@dataclass(frozen=True)
class BodyForce:
    """A force density (n, 3) [N/mm3] at points in regions."""

    name: str
    regions: tuple[str, ...]
    density: Field
    history: tuple[float, ...]


Load = Force | Pressure | BodyForce


@dataclass(frozen=True)
class Contact:
    """An interface that can open and slip.

    Attributes:
        name: Name in the case file.
        master: Regions on the stiffer side.
        slave: Regions on the softer side, which carries the jump.
        frictional: Whether it has friction at all; without, no tangential term is compiled.
        friction: Friction coefficient [-].
        augmented: Augmented Lagrangian (eq. 65), else penalty (eq. 57).
        stiffness: Augmentation or penalty [MPa/mm]; 0 asks for the default augmentation.
        modulus: Modulus of the softer side [MPa], which scales the default augmentation.
        gap: Initial gap (n,) at points [mm], negative where the bodies interfere.
        history: Amplitudes of the gap at the ends of the stages.
    """

    name: str
    master: tuple[str, ...]
    slave: tuple[str, ...]
    frictional: bool
    friction: float
    augmented: bool
    stiffness: float
    modulus: float
    gap: Field
    history: tuple[float, ...]


@dataclass(frozen=True)
class Stage:
    """A part of the loading: from time k to k + 1, in a number of increments."""

    name: str
    increments: int
    adaptive: bool
    max_cut_backs: int


@dataclass(frozen=True)
class Scene:
    """Everything that is solved, and nothing else."""

    order: int
    elastic: tuple[Elastic, ...]
    rigid: tuple[RigidBody, ...]
    foundations: tuple[Foundation, ...]
    supports: tuple[Support, ...]
    loads: tuple[Load, ...]
    contacts: tuple[Contact, ...]
    stages: tuple[Stage, ...]
