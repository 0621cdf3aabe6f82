"""Base of the constitutive laws of interfaces, bonded interfaces, and friction.

A law is a section of the case. Its class has the keys, the properties (for example `can_open`), the
augmentation and the formula in UFL. `contact_laws` has the laws of contact, `traction_laws` those
whose force is a function of the gap.

The path of `friction_coefficient` from the YAML file to the residual. To change the number, edit
the first step, here; to change where it varies, the second, in `contact_laws`; to change the
formula, edit `forms.contact`. The steps between pass every constant of a law on by its name:

    Frictional.friction_coefficient                the key, also of a `SurfaceZone`: a number
    Unilateral.constants_at_points                 {"μ": f}, f: points (n, 3) -> numbers (n,)
    scene.scene.Interface.constants                this mapping, kept with the interface
    mechanics.contact.ContactInterfaces.begin      {"μ": f(x)} at all contact points x
    mechanics.point_laws.PointLaws.begin           sets it as the input "μ" of the compiled law
    Unilateral.response                            `AtPoint.constants["μ"]`, a UFL constant
    forms.contact.contact_law                      force of a point: friction at most μ p, in UFL
    mechanics.point_laws.PointLaws.evaluate        runs the compiled law: forces (n, 3) [MPa]
    mechanics.contact.ContactInterfaces.residual   e + W P: forces of the bodies and of the law [N]

The debonded area of a cohesive interface has a law of contact, `Traction.debonded_contact`.
`PointLaws.evaluate`, not `begin`, passes μ to its compiled law, and `mechanics.debonded_contact`
multiplies it by the debonded share.

To add a law, derive from `Traction` (a force that is a function of the gap) or from `InterfaceLaw`.
`Traction` says what its methods return and what becomes of it. `app/README.md` has an example.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol, get_args

import numpy as np
from pydantic import model_validator

from app.laws.thermal import Conductance, FrictionHeating, PressureConductance
from app.laws.values import (
    GapField,
    InterferenceField,
    Patches,
    StemPlaces,
    field,
    gap_settled,
)
from app.schema.expressions import Varying
from app.schema.section import Extensible, Kinds, Section, fail
from app.schema.units import (
    Length,
    NonNegativeNumber,
    PositiveStress,
)

if TYPE_CHECKING:
    from ufl import Coefficient
    from ufl.core.expr import Expr

    from app.foundation.arrays import Bools, Field, Floats
    from forms.contact import Faces, Response

# Points per facet of mortar rows where `quadrature` is not given.
MORTAR_POINTS = 12
# Keys of contact with finite sliding.
FINITE_SLIDING_KEYS = ("between", "quadrature")
# Message for these keys in other laws.
SMALL_SLIDING_ONLY = (
    "is limited to small sliding; for finite sliding use `kind: contact` without `elastic_layer`"
)
# Default ratio of the augmentation to the stiffness against a jump.
DEFAULT_AUGMENTATION = 0.2


class InterfaceStrength(Section):
    """Strength of an interface in tension and in shear."""

    tension: PositiveStress
    """Strength in pure tension."""
    shear: PositiveStress
    """Strength in pure shear."""

    def index(self, pressure: Floats, shear: Floats) -> Floats:
        r"""Failure index :math:`\sqrt{(σ/N)^2 + (τ/S)^2}` (n,) [-]; it fails at 1.

        Args:
            pressure: Contact pressure (n,) [MPa], negative in tension.
            shear: Shear traction (n,) [MPa].
        """
        tension = -pressure * (pressure < 0)
        return ((tension / self.tension) ** 2 + (shear / self.shear) ** 2) ** 0.5


@dataclass(frozen=True)
class AtPoint:
    """Input of a law at a point, as UFL expressions.

    Attributes:
        λ: Multiplier: the interface force per area, if no layer is in series (3,) [MPa].
        jump: Displacement of the slave minus that of the master (3,) [mm].
        initial_gap: Vector whose normal components are the initial gaps of the faces (3,) [mm].
        jump_old: Jump of the last converged state (3,) [mm].
        S_star: Coefficient that replaces the trial force where it is frozen (3,) [MPa].
        normals: Unit normals of one to three faces, from master to slave, each (3,), with duals.
        r: Augmentation: stiffness of the trial force [MPa/mm]. It is at most that of a layer.
        constants: Constants of the law, by name.
        internal_variables: Internal variables of the last converged state, by name.
        frozen: 1 while the internal variables are frozen, else 0. They are frozen in the first
            solve of a step, so that no early iterate damages a point.
    """

    λ: Expr
    jump: Expr
    initial_gap: Expr
    jump_old: Expr
    S_star: Coefficient
    normals: Faces
    r: Expr
    constants: Mapping[str, Expr]
    internal_variables: Mapping[str, Expr]
    frozen: Expr

    def updated(self, internal_variables: Mapping[str, Expr]) -> dict[str, Expr]:
        """Internal variables after the step; the committed ones while they are frozen."""
        from ufl import as_vector, conditional, lt

        def selected(new: Expr, committed: Expr) -> Expr:
            if not committed.ufl_shape:
                return conditional(lt(self.frozen, 0.5), new, committed)
            return as_vector([selected(new[i], committed[i]) for i in range(len(committed))])

        return {
            name: selected(internal_variables[name], committed)
            for name, committed in self.internal_variables.items()
        }


@dataclass(frozen=True)
class GapState:
    """State of a point at a gap, for the methods of `Traction`, as UFL expressions.

    Attributes:
        gap_vector: Jump (displacement of the slave minus that of the master) plus initial gap
            (3,) [mm].
        normals: Unit normals of the point's one to three faces, from master to slave, each (3,).
            `normals.components(v)` returns the normal components of a vector, one for each face
            (of the gap vector: positive if open). `normals.span(a)` returns the vector (3,) with
            these components. The rest, ``v - span(components(v))``, is tangential.
        internal_variables: Internal variables at the gap by name, as `new_internal_variables`
            returns them. In that method they are those of the last converged state.
        committed: Internal variables of the last converged state, by name.
        frozen: 1 while the internal variables are frozen, else 0.
    """

    gap_vector: Expr
    normals: Faces
    internal_variables: Mapping[str, Expr]
    committed: Mapping[str, Expr]
    frozen: Expr


class GapKeys(Protocol):
    """A surface with a gap or an interference: an interface or a zone of it."""

    @property
    def gap(self) -> float | str | None:
        """Initial gap [mm], or an expression; None for that of the interface."""

    @property
    def interference(self) -> float | str | tuple[tuple[float, float], ...] | None:
        """Radial interference [mm], an expression, or pairs of height and length [mm]."""


def most_interference(surface: GapKeys) -> tuple[str, float]:
    """Key and largest number of an interference, also of a negative gap [mm]; 0 of expressions."""
    interference, gap = surface.interference, surface.gap
    if isinstance(interference, tuple):
        return "interference", max(length for _, length in interference)
    if isinstance(interference, float):
        return "interference", interference
    return "gap", -gap if isinstance(gap, float) else 0.0


class InterfaceLaw(Extensible):
    """Base of the interface laws. Each subclass with a `kind` is a law.

    =======================  ========  ========  ==========
    law                      can_part  can_open  is_contact
    =======================  ========  ========  ==========
    Bonded                   no        no        no
    Unilateral (base)        yes       yes       yes
    - Contact, Penalty       yes       yes       yes
    Traction (base)          yes       no        no
    - Cohesive               yes       yes       no
    Frictional (base)        yes       no        no
    =======================  ========  ========  ==========

    A law after a dash derives from the base above it. `Frictional` adds the friction coefficient
    to `Unilateral`, to `Cohesive`, and to laws from outside.

    Attributes:
        can_part: True if the sides can move relative to each other. The interface then has unknown
            jumps.
        can_open: True if the sides can separate without resistance.
        is_contact: True for contact alone, whose slip follows from its state.
        internal_variables: Shapes of the internal variables at a point, by name: () for a scalar,
            (3,) for a vector. For a law with `damage` and `spent` (the dissipated part of its
            fracture energy), the summary has the numbers of damaged interfaces.
    """

    # A `Literal` in each subclass.
    kind: Any
    can_part: ClassVar[bool] = True
    can_open: ClassVar[bool] = False
    is_contact: ClassVar[bool] = False
    internal_variables: ClassVar[Mapping[str, tuple[int, ...]]] = {}

    conductance: Conductance | None = None
    """Power per area and temperature jump; perfect (no jump) by default."""
    strength: InterfaceStrength | None = None
    """Strengths in tension and shear, for the failure index. They do not change the law."""

    @model_validator(mode="before")
    @classmethod
    def _check_small_sliding(cls, value: object) -> object:
        if not isinstance(value, dict):
            return value
        for key in ("sliding", *FINITE_SLIDING_KEYS):
            if key in value and key not in cls.model_fields:
                fail(f"kind: {value.get('kind')} {SMALL_SLIDING_ONLY}", at=(key,))
        return value

    @property
    def conductances(self) -> tuple[float, float, float]:
        """Conductance at zero pressure, its increase with pressure, largest value [N, mm, s, K]."""
        conductance = self.conductance
        if conductance is None:
            return math.inf, 0.0, math.inf
        if isinstance(conductance, PressureConductance):
            largest = math.inf if conductance.cap is None else conductance.cap
            return conductance.open, conductance.per_pressure, largest
        return conductance, 0.0, math.inf

    @property
    def conducts_by_pressure(self) -> bool:
        """True if the conductance grows with the contact pressure."""
        return isinstance(self.conductance, PressureConductance)

    # Some laws have keys for these properties. A key cannot have the name of a property of its
    # base class, so the names differ:
    #   key                 property
    #   `sliding`           `finite_sliding`
    #   `quadrature`        `mortar_points`
    #   `between`           `sliding_boundaries`
    #   `friction_heating`  `heated_by_friction`
    #   `gap_history`       `gap_multipliers`
    #   `zones`             `surface_zones`

    @property
    def finite_sliding(self) -> bool:
        """True if the sides may slide any distance."""
        return False

    @property
    def mortar_points(self) -> int:
        """Quadrature points per facet of the mortar coupling in finite sliding."""
        return MORTAR_POINTS

    @property
    def sliding_boundaries(self) -> tuple[str, str] | None:
        """Boundaries that slide on each other; None for those of the geometry."""
        return None

    @property
    def frictions(self) -> Mapping[tuple[str, ...], float]:
        """Friction coefficients of the interface, then of its zones, by the path of their keys."""
        return {}

    @property
    def largest_friction(self) -> float:
        """Largest friction coefficient on the interface [-]; 0: no tangential term is compiled."""
        return max(self.frictions.values(), default=0.0)

    @property
    def heated_by_friction(self) -> FrictionHeating | None:
        """Heating of the sides by friction; None if friction heats no side."""
        return None

    @property
    def has_initial_gap(self) -> bool:
        """True if the law gives an initial gap or an interference."""
        return False

    @property
    def is_press_fit(self) -> bool:
        """True if a key gives an interference: micromotion is then reported."""
        return False

    @property
    def overlaps_initially(self) -> bool:
        """True if a key gives an interference, or a negative number as gap."""
        return False

    @property
    def gap_multipliers(self) -> tuple[float, ...] | None:
        """Multipliers of the initial gap at the ends of the stages (`values.gap_at`)."""
        return None

    def gap_field(self, interface: str, stem: StemPlaces) -> Field:
        """Initial gap at points (n, 3), negative for an interference: shape (n,) [mm]."""
        return field(f"interfaces.{interface}.gap", 0.0)

    @property
    def without_effect(self) -> dict[tuple[str, ...], str]:
        """Reasons why given keys have no effect, by path."""
        return {}

    @property
    def zone_heights(self) -> Mapping[str, tuple[float, float]]:
        """Lower and upper height of each zone on the stem [mm], by name."""
        return {}

    @property
    def surface_zones(self) -> Mapping[str, SurfaceZone]:
        """Zones of a stem's surface, by name; none by default."""
        return {}

    @property
    def gaps(self) -> Mapping[tuple[str, ...], GapKeys]:
        """The interface and its zones with their gaps, by the path of their keys below the law.

        A law without gap has none.
        """
        return {}

    @property
    def table_heights(self) -> Mapping[tuple[str, ...], tuple[float, ...]]:
        """Heights on the stem in tables of interferences [mm], by the path of the key."""
        return {}

    @property
    def layer(self) -> tuple[float, float] | None:
        """Normal and tangential stiffness of an elastic layer in series [MPa/mm]; None without.

        The normal stiffness is infinite if only the tangential one is given.
        """
        return None

    @property
    def spring_stiffness(self) -> tuple[float, float] | None:
        """Normal and tangential stiffness of a law of springs [MPa/mm]; None for other laws.

        Soft springs have the traction of the jump at their point. Other tractions are means, from
        which maxima and percentiles recover point values (theory, "Tractions as point values").
        """
        return self.layer

    @property
    def compresses(self) -> bool:
        """True if the sides overlap under pressure by the compression of a layer between them.

        True by default for laws whose force is a function of the gap.
        """
        return not self.is_contact

    @property
    def debonded_contact(self) -> InterfaceLaw | None:
        """Contact law of the debonded area; None if the law has none."""
        return None

    @property
    def dissipates(self) -> bool:
        """True if the response has `dissipated_by_jump`, so that `fracture_step` can control it."""
        return False

    # The names of `constants` are the inputs of the compiled law. `constants_at_points` gives their
    # values at points. `form` has everything else that the formula depends on: laws of equal form
    # share compiled code.

    @property
    def constants(self) -> Mapping[str, float | str | Patches]:
        """Constants of the law by name, as the keys give them.

        They may differ between laws of one form. A value may be an expression of the place.
        """
        return {name: v for name, v in self._added_fields().items() if self._varies(name, v)}

    @property
    def form(self) -> Hashable:
        """Key of the compiled code that laws share: class, friction, fields without numbers."""
        return (
            type(self),
            self.largest_friction > 0,
            *((n, v) for n, v in self._added_fields().items() if not self._varies(n, v)),
        )

    def _added_fields(self) -> dict[str, float | str | Patches]:
        """Fields added by the subclass."""
        added_names = type(self).model_fields.keys() - InterfaceLaw.model_fields
        return {name: getattr(self, name) for name in sorted(added_names)}

    def _varies(self, name: str, value: object) -> bool:
        return isinstance(value, float | Patches) or self._mark(name) is not None

    def _mark(self, name: str) -> Varying | None:
        model_field = type(self).model_fields.get(name)
        if model_field is None:
            return None
        marks = list(model_field.metadata)
        for member in get_args(model_field.annotation):  # members of an optional key
            marks += get_args(member)
        for mark in marks:
            if isinstance(mark, Varying):
                return mark
        return None

    def constants_at_points(self, interface: str, stem: StemPlaces) -> dict[str, Field]:
        """Functions of points (n, 3) that return the constants there (n,), by name."""
        key = f"interfaces.{interface}."
        return {n: field(key + n, v, self._mark(n)) for n, v in self.constants.items()}

    def resists_sliding(self, interface: str, stem: StemPlaces) -> Callable[[Floats], Bools]:
        """Function of points (n, 3) that is True where touching sides resist sliding (n,)."""
        return lambda x: np.ones(len(x), dtype=bool)

    def check(self, values: Mapping[str, Floats]) -> None:
        """Check constants at points (n,), by name.

        Raises:
            PydanticCustomError: They contradict each other.
        """

    def response(self, point: AtPoint) -> Response:
        """Force and derivatives of the law, in UFL."""
        raise NotImplementedError

    def augmentation_of(self, softest_stiffness: Floats, factor: float) -> Floats | float:
        """Augmentation r, the stiffness of the trial force, without a layer (n,) [MPa/mm].

        Args:
            softest_stiffness: Stiffness per area against the jump of each point, in its softest
                direction (n,) [MPa/mm].
            factor: Default ratio of the augmentation to this stiffness [-].
        """
        return factor * softest_stiffness


def insertion_stages(laws: Mapping[str, InterfaceLaw], press_fits: Collection[str]) -> int:
    """Number of stages after which all press fits have grown; 0 without press fits.

    Args:
        laws: Laws of the interfaces, by name.
        press_fits: Interfaces of which a negative gap is a press fit, too.
    """
    pressed = [
        law
        for name, law in laws.items()
        if law.is_press_fit or (law.overlaps_initially and name in press_fits)
    ]
    ends = [gap_settled(np.array([-1.0]), law.gap_multipliers or ()) for law in pressed]
    return round(max(ends, default=0.0))


class Bonded(InterfaceLaw):
    """The two sides form one continuum."""

    can_part: ClassVar[bool] = False

    kind: Literal["bonded"] = "bonded"

    @model_validator(mode="after")
    def _no_pressure(self) -> Bonded:
        if self.conducts_by_pressure:
            fail(
                "a bonded interface has no contact pressure; expected kind: contact or penalty",
                at=("conductance",),
            )
        return self


class Frictional(InterfaceLaw):
    """Base of the laws with Coulomb friction."""

    friction_coefficient: NonNegativeNumber
    """Coulomb's coefficient; 0 for none."""

    @property
    def frictions(self) -> Mapping[tuple[str, ...], float]:
        """The key `friction_coefficient`."""
        return {("friction_coefficient",): self.friction_coefficient}


class SurfaceZone(Section):
    """Part of a stem's surface between two heights, with its friction and interference."""

    KEYS: ClassVar[tuple[str, ...]] = ("friction_coefficient", "gap", "interference")

    above: Length | None = None
    """Height above the stem's tip, along the stem, at which the part begins; by default its end. In
    geometries without a stem it is z."""
    below: Length | None = None
    """Height at which it ends; by default the neck cut."""
    friction_coefficient: NonNegativeNumber | None = None
    """Coulomb's coefficient there; by default that of the interface."""
    gap: GapField | None = None
    """Initial gap there, in place of the interface's gap or interference."""
    interference: InterferenceField | None = None
    """Radial interference there, in place of the interface's gap or interference."""

    @model_validator(mode="after")
    def _check_gap_and_heights(self) -> SurfaceZone:
        if self.gap is not None and self.interference is not None:
            fail("is the opposite of `gap`; expected only one of them", at=("interference",))
        lower_height, upper_height = self.heights
        if not lower_height < upper_height:
            fail(f"is not above {lower_height:g} mm, where the zone begins", at=("below",))
        return self

    def hides(self, earlier: SurfaceZone, key: str) -> bool:
        """Return True if this later zone hides an earlier one for a key."""
        low, high = self.heights
        earlier_low, earlier_high = earlier.heights
        covers = low <= earlier_low and earlier_high <= high
        if key == "friction_coefficient":
            return covers and self.friction_coefficient is not None
        return covers and (self.gap is not None or self.interference is not None)

    @property
    def heights(self) -> tuple[float, float]:
        """Heights at which it begins and ends [mm]; infinite where none is given."""
        lower_height = -math.inf if self.above is None else self.above
        return lower_height, math.inf if self.below is None else self.below


Interface = Annotated[InterfaceLaw, Kinds()]
