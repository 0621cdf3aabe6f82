"""Interface laws of a scene: what the two sides of an interface do to each other at a point.

A law is a frozen record that answers for itself: whether its sides can open or rub, how stiff its
trial force is, and its formula, in UFL. Nobody asks what kind it is. To add one, derive from
`Traction` (an explicit function of the gap) or from `InterfaceLaw`; `app/README.md` tells the rest.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np
from ufl import as_ufl, as_vector, diff, variable
from ufl.algorithms import expand_derivatives, strip_variables
from ufl.core.expr import Expr

from app.arrays import Floats
from app.case.run_options import USUAL_AUGMENTATION
from forms.contact import STICK, components, contact_law

Shapes = Mapping[str, tuple[int, ...]]


@dataclass(frozen=True)
class AtPoint:
    """Input of a law at a point, as UFL expressions.

    Attributes:
        F: Multiplier: the interface force per area (3,) [MPa].
        jump: Displacement of the slave minus that of the master (3,) [mm].
        gap: Vector whose normal components are the initial gap of each face (3,) [mm].
        jump_old: Jump of the last converged state (3,) [mm].
        S_star: Stand-in for a frozen trial force (3,) [MPa].
        normals: Unit normals of one to three faces, from master to slave, each (3,).
        r: Stiffness of the trial force [MPa/mm].
        values: The constants of the law, by name.
        history: What it remembers of the last converged state, by name.
    """

    F: Expr
    jump: Expr
    gap: Expr
    jump_old: Expr
    S_star: Any
    normals: Sequence[Expr]
    r: Expr
    values: Mapping[str, Expr]
    history: Mapping[str, Expr]


@dataclass(frozen=True)
class Response:
    """Output of a law at a point, as UFL expressions.

    Attributes:
        force: Interface force per area (3,) [MPa].
        slope: Its generalized derivative (3, 3): by the trial force [-], or by the gap [MPa/mm].
        pressures: Pressure of each face, positive in compression [MPa].
        status: OPEN, STICK or SLIP (`forms.contact`).
        history: What it will remember, by name.
    """

    force: Expr
    slope: Expr
    pressures: Expr
    status: Expr
    history: Mapping[str, Expr] = field(default_factory=dict)


class InterfaceLaw(ABC):
    """The law of an interface whose sides can move apart.

    Attributes:
        can_open: Whether the sides can part without resistance.
        frictional: Whether they rub; without, no tangential term is compiled.
        friction: Friction coefficient [-].
        augmented: Whether its multiplier is found exactly, whatever the augmentation.
        by_trial_force: Whether its slope is by the trial force F + r (jump + gap), else by the gap.
        history: Shapes of what it remembers at a point, by name: () a scalar, (3,) a vector.
    """

    can_open: ClassVar[bool] = True
    augmented: ClassVar[bool] = False
    by_trial_force: ClassVar[bool] = True
    history: ClassVar[Shapes] = {}

    @property
    def frictional(self) -> bool:
        """Whether the sides rub."""
        return self.friction > 0

    @property
    def friction(self) -> float:
        """Friction coefficient [-]."""
        return 0.0

    @property
    @abstractmethod
    def form(self) -> Hashable:
        """Laws of the same form share compiled code."""

    @property
    @abstractmethod
    def values(self) -> Mapping[str, float]:
        """Constants that laws of the same form may have different values of."""

    @abstractmethod
    def response(self, at: AtPoint) -> Response:
        """The formula."""

    def trial_stiffness(self, met: Floats, factor: float) -> Floats:
        """Stiffness of the trial force (n,) [MPa/mm].

        Args:
            met: Stiffness per area that the jump of each point meets (n,) [MPa/mm].
            factor: Augmentation over that, by default.
        """
        return factor * met

    def softened_stiffness(self, stiffness: Floats, met: Floats, share: float) -> Floats:
        """The same while the solver asks for a share of it (n,) [MPa/mm]."""
        return share * stiffness

    def multiplier_share(self, softened: Floats, stiffness: Floats) -> Floats:
        """Part of the multiplier in the trial force (n,) [-]."""
        return np.ones_like(stiffness)


@dataclass(frozen=True)
class Coulomb(InterfaceLaw):
    """Unilateral contact with Coulomb friction, exactly (`forms.contact`, eq. 65).

    Attributes:
        coefficient: Friction coefficient [-].
        augmentation: Augmentation [MPa/mm]; 0 asks for the default.
    """

    coefficient: float
    augmentation: float = 0.0
    augmented: ClassVar[bool] = True

    @property
    def friction(self) -> float:
        """Friction coefficient [-]."""
        return self.coefficient

    @property
    def form(self) -> Hashable:
        """With friction or without."""
        return "contact", self.frictional

    @property
    def values(self) -> Mapping[str, float]:
        """The friction coefficient."""
        return {"μ": self.coefficient} if self.frictional else {}

    def response(self, at: AtPoint) -> Response:
        """The law that the augmented Lagrangian of a point gives."""
        state = (at.F, at.jump, at.gap, at.jump_old, at.S_star)
        found = contact_law(*state, at.normals, at.values.get("μ"), at.r)
        return Response(found.force, found.jacobian, found.pressures, found.status)

    def trial_stiffness(self, met: Floats, factor: float) -> Floats:
        """The augmentation asked for, or the default (n,) [MPa/mm]."""
        return np.full_like(met, self.augmentation) if self.augmentation > 0 else factor * met


@dataclass(frozen=True)
class CoulombByPenalty(Coulomb):
    """The same by penalty (eq. 57): `augmentation` is the penalty.

    A penalty ε is exact contact of D - (F - F_old) / ε: with S = F + r (D - (F - F_old) / ε) it is
    found with any r, and r = ε is the usual way, where S has nothing of F. Softer, it is as easily
    solved as without penalty, and the answer is the same.
    """

    augmented: ClassVar[bool] = False

    def softened_stiffness(self, stiffness: Floats, met: Floats, share: float) -> Floats:
        """At most the penalty: with more, S would count F with a negative sign (n,) [MPa/mm]."""
        if share == 1.0:
            return stiffness
        return np.minimum(share * USUAL_AUGMENTATION * met, stiffness)

    def multiplier_share(self, softened: Floats, stiffness: Floats) -> Floats:
        """None the usual way (n,) [-]."""
        return 1.0 - softened / stiffness


class Traction(InterfaceLaw):
    """A law whose force is an explicit function of the gap: layers, cohesion.

    A subclass is a frozen dataclass whose fields are numbers; `traction` is its formula, in which
    these fields stand for UFL scalars.
    """

    can_open: ClassVar[bool] = False
    by_trial_force: ClassVar[bool] = False

    @abstractmethod
    def traction(self, gap: Expr, normals: Sequence[Expr], history: Mapping[str, Expr]) -> Expr:
        """Force per area that resists a gap (3,) [MPa].

        Args:
            gap: Displacement of the slave minus that of the master, with the initial gap (3,) [mm].
            normals: Unit normals of the point's faces, from master to slave, each (3,).
            history: What the law remembers of the last converged state, by name.
        """

    def remembered(
        self, gap: Expr, normals: Sequence[Expr], history: Mapping[str, Expr]
    ) -> Mapping[str, Expr]:
        """History variables after a converged step, by name (see `history`)."""
        return {}

    @property
    def form(self) -> Hashable:
        """The formula."""
        return type(self)

    @property
    def values(self) -> Mapping[str, float]:
        """Its fields."""
        return {f.name: float(getattr(self, f.name)) for f in fields(self)}  # type: ignore[arg-type]

    def response(self, at: AtPoint) -> Response:
        """Force and its derivative by the gap."""
        law = replace(self, **at.values)  # type: ignore[type-var]
        gap = variable(at.jump + at.gap)
        force = law.traction(gap, at.normals, at.history)
        slope = expand_derivatives(diff(force, gap))
        pressures = as_vector([-p for p in components(force, at.normals)])
        history = law.remembered(gap, at.normals, at.history)
        stripped = {name: strip_variables(e) for name, e in history.items()}
        force, slope, pressures = map(strip_variables, (force, slope, pressures))
        return Response(force, slope, pressures, STICK * as_ufl(1.0), stripped)

    def multiplier_share(self, softened: Floats, stiffness: Floats) -> Floats:
        """None (n,) [-]."""
        return np.zeros_like(stiffness)


@dataclass(frozen=True)
class BondTerm:
    """An interface without a law: its sides cannot part.

    Attributes:
        name: Name in the case file.
        master: Regions on the stiffer side.
        slave: Regions on the softer side, which is elastic.
    """

    name: str
    master: tuple[str, ...]
    slave: tuple[str, ...]
