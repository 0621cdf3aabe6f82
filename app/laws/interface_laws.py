"""Constitutive laws of interfaces, and their keys in a case.

A law is a section of the case. Its class has the keys, the properties (for example `can_open`), the
augmentation and the formula in UFL.

The path of `friction_coefficient` from the YAML file to the residual. To change the number or where
it varies, edit the first two steps, here; to change the formula, edit `forms.contact`. The steps
between pass every constant of a law on by its name:

    Frictional.friction_coefficient, SurfaceZone   the key, also of a zone: a number
    Unilateral.constants_at_points                 {"μ": f}, f: points (n, 3) -> numbers (n,)
    scene.scene.Interface.constants                this mapping, kept with the interface
    mechanics.contact.ContactInterfaces.begin      {"μ": f(x)} at the contact points x of a rank
    mechanics.point_laws.PointLaws.begin           sets it as the input "μ" of the compiled law
    Unilateral.response                            `AtPoint.constants["μ"]`, a UFL constant
    forms.contact.contact_law                      force of a point: friction at most μ p, in UFL
    mechanics.point_laws.PointLaws.evaluate        runs the compiled law: forces (n, 3) [MPa]
    mechanics.contact.ContactInterfaces.residual   e + W P: forces of the bodies and of the law [N]

The debonded area of a cohesive interface has a contact law, `Traction.debonded_contact`, whose
coefficient takes the same path; `PointLaws` multiplies it by the debonded share.

To add a law, derive from `Traction` (a force that is a function of the gap) or from `InterfaceLaw`.
`Traction` says what its methods return and what becomes of it. `app/README.md` has an example.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import model_validator

from app.laws.thermal import Conductance, FrictionHeating, PressureConductance
from app.laws.values import (
    INTERFERENCE,
    FractureEnergyField,
    InterferenceField,
    LengthField,
    LoadHistory,
    Patches,
    ShareField,
    Source,
    StemPlaces,
    StiffnessField,
    StrengthField,
    Table,
    field,
    gap_settled,
    in_zone,
)
from app.schema.expressions import Varying
from app.schema.section import MAPPING, Extensible, Kinds, Name, Pair, Section, Text, fail
from app.schema.units import (
    Length,
    MixingExponent,
    NonNegativeNumber,
    PositiveStiffness,
    PositiveStress,
)

if TYPE_CHECKING:
    from ufl import Coefficient
    from ufl.core.expr import Expr

    from app.foundation.arrays import Field, Floats
    from forms.cohesion import CohesiveState
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
        F: Multiplier: the interface force per area (3,) [MPa].
        jump: Displacement of the slave minus that of the master (3,) [mm].
        initial_gap: Vector whose normal components are the initial gaps of the faces (3,) [mm].
        jump_old: Jump of the last converged state (3,) [mm].
        S_star: Coefficient that replaces the trial force where it is frozen (3,) [MPa].
        normals: Unit normals of one to three faces, from master to slave, each (3,), with duals.
        r: Augmentation: stiffness of the trial force, at most that of a layer [MPa/mm].
        constants: Constants of the law, by name.
        internal_variables: Internal variables of the last converged state, by name.
        frozen: 1 while the internal variables are frozen, else 0. They are frozen in the first
            solve of a step, so that no early iterate damages a point.
    """

    F: Expr
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


class InterfaceLaw(Extensible):
    """Base of the interface laws. Each subclass with a `kind` is a law.

    ==================  ========  ========  ==========  ================
    law                 can_part  can_open  is_contact  has_augmentation
    ==================  ========  ========  ==========  ================
    Bonded              no        no        no          no
    Coulomb, Penalty    yes       yes       yes         yes
    Cohesive            yes       yes       no          yes
    Traction (base)     yes       no        no          no
    ==================  ========  ========  ==========  ================

    Attributes:
        can_part: True if the sides can move relative to each other. The interface then has unknown
            jumps.
        can_open: True if the sides can separate without resistance.
        has_augmentation: True if contact acts on the interface, also on its debonded area alone.
            The remedies of Newton's method change the augmentation of such laws.
        is_contact: True for contact alone, whose slip follows from its state.
        internal_variables: Shapes of the internal variables at a point, by name: () for a scalar,
            (3,) for a vector. For a law with `damage` and `spent` (the dissipated part of its
            fracture energy), the summary has the numbers of damaged interfaces.
    """

    # A `Literal` in each subclass.
    kind: Any
    can_part: ClassVar[bool] = True
    can_open: ClassVar[bool] = False
    has_augmentation: ClassVar[bool] = False
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
    def friction(self) -> float:
        """Largest friction coefficient on the interface [-]; 0: no tangential term is compiled."""
        return 0.0

    @property
    def heated_by_friction(self) -> FrictionHeating | None:
        """Heating of the sides by friction; None if friction heats no side."""
        return None

    @property
    def has_gap(self) -> bool:
        """True if the law gives an initial gap or an interference."""
        return False

    @property
    def is_press_fit(self) -> bool:
        """True if a key gives an interference: micromotion is then reported."""
        return False

    @property
    def interferes(self) -> bool:
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
    def compresses(self) -> bool:
        """True if the sides overlap under pressure by the compression of a layer between them.

        By default of each law whose force follows from the gap.
        """
        return not self.is_contact

    @property
    def debonded_contact(self) -> Coulomb | None:
        """Contact law of the debonded area; None if the law has none."""
        return None

    @property
    def dissipates(self) -> bool:
        """True if the response has `dissipated_by_jump`, so that `fracture_step` can control it."""
        return False

    # `constants` are the inputs of the compiled law, by name. `constants_at_points` gives their
    # values. `form` has everything else that the formula depends on: laws of equal form share
    # compiled code.

    @property
    def constants(self) -> Mapping[str, float | str | Patches]:
        """Constants of the law, by name. They may differ between laws of one form."""
        return {name: v for name, v in self._added_fields().items() if self._varies(name, v)}

    @property
    def form(self) -> Hashable:
        """Key of the compiled code that laws share: class and fields that are not numbers."""
        return type(self), *(
            (n, v) for n, v in self._added_fields().items() if not self._varies(n, v)
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

    def check(self, values: Mapping[str, Floats]) -> None:
        """Check constants at points (n,), by name.

        Raises:
            PydanticCustomError: They contradict each other.
        """

    def response(self, point: AtPoint) -> Response:
        """Force and derivatives of the law, in UFL."""
        raise NotImplementedError

    def augmentation_of(self, local_stiffness: Floats, factor: float) -> Floats | float:
        """Augmentation r, the stiffness of the trial force, without a layer (n,) [MPa/mm].

        Args:
            local_stiffness: Stiffness per area against the jump of each point (n,) [MPa/mm].
            factor: Default ratio of the augmentation to the local stiffness [-].
        """
        return factor * local_stiffness


def insertion_stages(laws: Mapping[str, InterfaceLaw], press_fits: Collection[str]) -> int:
    """Number of stages after which all press fits have grown; 0 without press fits.

    Args:
        laws: Laws of the interfaces, by name.
        press_fits: Interfaces of which a negative gap is a press fit, too.
    """
    pressed = [
        law
        for name, law in laws.items()
        if law.is_press_fit or (law.interferes and name in press_fits)
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
    def friction(self) -> float:
        """The key `friction_coefficient`."""
        return self.friction_coefficient


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
    gap: LengthField | None = None
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


def _interference(key: str, value: float | str | Table, stem: StemPlaces, x: Floats) -> Floats:
    """Interference of a key at points (n, 3): shape (n,) [mm]; 0 outside the flanks of a stem."""
    if isinstance(value, tuple):
        heights, lengths = zip(*value, strict=True)
        interference = np.interp(stem.height_on_stem(x), heights, lengths)
    else:
        interference = field(key, value, INTERFERENCE)(x)
    return np.where(stem.on_flanks(x), interference, 0.0)


class Unilateral(Frictional):
    """Unilateral contact with Coulomb friction: exact, or with a penalty (`forms.contact`)."""

    can_open: ClassVar[bool] = True
    has_augmentation: ClassVar[bool] = True
    is_contact: ClassVar[bool] = True

    gap: LengthField = 0.0
    """Initial gap: a clearance if positive, an interference (press fit) if negative."""
    interference: InterferenceField | None = None
    """Radial interference of a press fit: half of the diametral one. A length, an expression, or
    pairs of height above the stem's tip and length, linear in between. It acts on the flanks of a
    stem, not on its end, and grows during the first stage. In place of `gap`."""
    zones: Annotated[dict[Name, SurfaceZone], MAPPING] | None = None
    """Parts of a stem's surface with different friction or interference, such as a coating. Where
    two overlap, the later one counts."""
    gap_history: LoadHistory = None
    """Multiplier of the gap at the end of each stage, from 0. By default a clearance is constant,
    and an interference grows during the first stage."""
    friction_heating: FrictionHeating | None = None
    """Part of the friction heat that enters the first side; by default friction heats no side."""

    @model_validator(mode="after")
    def _check_one_gap(self) -> Unilateral:
        if self.interference is not None and self.gap != 0.0:
            fail("is the opposite of `gap`; expected only one of them", at=("interference",))
        return self

    @model_validator(mode="after")
    def _check_friction_heating(self) -> Unilateral:
        if self.friction_heating is not None and self.friction == 0.0:
            fail(
                "needs friction; expected a friction_coefficient above 0", at=("friction_heating",)
            )
        return self

    @property
    def surface_zones(self) -> Mapping[str, SurfaceZone]:
        """The key `zones`."""
        return self.zones or {}

    @property
    def heated_by_friction(self) -> FrictionHeating | None:
        """The key `friction_heating`."""
        return self.friction_heating

    @property
    def friction(self) -> float:
        """The largest `friction_coefficient` of the interface and its zones."""
        zones = [zone.friction_coefficient for zone in self.surface_zones.values()]
        return max([self.friction_coefficient, *(μ for μ in zones if μ is not None)])

    @property
    def has_gap(self) -> bool:
        """True if a key gives a gap or an interference."""
        surfaces: list[Unilateral | SurfaceZone] = [self, *self.surface_zones.values()]
        return any(surface.gap or surface.interference for surface in surfaces)

    @property
    def is_press_fit(self) -> bool:
        """True if `interference` is given, of the interface or of a zone."""
        surfaces: list[Unilateral | SurfaceZone] = [self, *self.surface_zones.values()]
        return any(surface.interference is not None for surface in surfaces)

    @property
    def interferes(self) -> bool:
        """True if an interference or a negative gap is given, of the interface or of a zone."""
        surfaces: list[Unilateral | SurfaceZone] = [self, *self.surface_zones.values()]
        return self.is_press_fit or any(
            isinstance(surface.gap, float) and surface.gap < 0.0 for surface in surfaces
        )

    @property
    def gap_multipliers(self) -> tuple[float, ...] | None:
        """The key `gap_history`."""
        return self.gap_history

    @property
    def without_effect(self) -> dict[tuple[str, ...], str]:
        """Reasons why given keys have no effect, by path."""
        reasons = super().without_effect
        if not self.has_gap:
            reasons[("gap_history",)] = "there is no gap and no interference"
        zones = list(self.surface_zones.items())

        def later_zone_that_hides(number: int, key: str) -> str | None:
            for later_name, later_zone in zones[number + 1 :]:
                if later_zone.hides(zones[number][1], key):
                    return later_name
            return None

        for number, (name, _) in enumerate(zones):
            for key in SurfaceZone.KEYS:
                later_name = later_zone_that_hides(number, key)
                if later_name is not None:
                    reasons["zones", name, key] = (
                        f"zone {later_name} counts there, as the later one"
                    )
        return reasons

    @property
    def zone_heights(self) -> Mapping[str, tuple[float, float]]:
        """Heights of the zones on the stem [mm]."""
        return {name: zone.heights for name, zone in self.surface_zones.items()}

    @property
    def table_heights(self) -> Mapping[tuple[str, ...], tuple[float, ...]]:
        """Heights in the tables of the interface and of its zones [mm]."""
        surfaces: dict[tuple[str, ...], Unilateral | SurfaceZone] = {(): self}
        surfaces |= {("zones", name): zone for name, zone in self.surface_zones.items()}
        return {
            (*path, "interference"): tuple(height for height, _ in surface.interference)
            for path, surface in surfaces.items()
            if isinstance(surface.interference, tuple)
        }

    def gap_field(self, interface: str, stem: StemPlaces) -> Field:
        """Initial gap at points (n, 3), negative for an interference: shape (n,) [mm]."""
        key = f"interfaces.{interface}"

        def gap_of(part: Unilateral | SurfaceZone, key: str, x: Floats) -> Floats | None:
            """The gap of a part; None if none is given for it."""
            if part.interference is not None:
                return -_interference(f"{key}.interference", part.interference, stem, x)
            return None if part.gap is None else field(f"{key}.gap", part.gap)(x)

        def gap(x: Floats) -> Floats:
            gaps = gap_of(self, key, x)
            assert gaps is not None  # its default is 0
            for name, zone in self.surface_zones.items():
                inside = in_zone(*zone.heights, stem.height_on_stem(x))
                zone_gap = gap_of(zone, f"{key}.zones.{name}", x[inside])
                if zone_gap is not None:
                    gaps[inside] = zone_gap
            return gaps

        return gap

    def constants_at_points(self, interface: str, stem: StemPlaces) -> dict[str, Field]:
        """Friction coefficient as function of points, under the name μ of the form; none if 0."""
        if self.friction == 0.0:
            return {}

        def friction(x: Floats) -> Floats:
            coefficients = np.full(len(x), self.friction_coefficient)
            for zone in self.surface_zones.values():
                if zone.friction_coefficient is not None:
                    inside = in_zone(*zone.heights, stem.height_on_stem(x))
                    coefficients[inside] = zone.friction_coefficient
            return coefficients

        return {"μ": friction}

    @property
    def form(self) -> Hashable:
        """Contact, with or without friction."""
        return "contact", self.friction > 0

    @property
    def constants(self) -> Mapping[str, float | str]:
        """The friction coefficient, under the name μ of the form; none if it is 0."""
        return {"μ": self.friction} if self.friction > 0 else {}

    def response(self, point: AtPoint) -> Response:
        """Law of the augmented Lagrangian at a point (eq. 65)."""
        from forms.contact import contact_law

        return contact_law(
            F=point.F,
            jump=point.jump,
            gap=point.initial_gap,
            jump_old=point.jump_old,
            S_star=point.S_star,
            normals=point.normals,
            μ=point.constants.get("μ"),
            r=point.r,
        )


class ElasticLayer(Section):
    """An elastic layer in series with contact, by its stiffnesses."""

    normal: PositiveStiffness | None = None
    """Pressure per compression of the layer; rigid by default."""
    tangential: PositiveStiffness
    """Shear stress per shear displacement of the layer."""


class Coulomb(Unilateral):
    """Unilateral contact with Coulomb friction, exactly: augmented Lagrangian."""

    kind: Literal["contact"] = "contact"
    elastic_layer: ElasticLayer | None = None
    """Elastic layer in series with contact; none by default. Slip excludes its elastic part."""
    sliding: Literal["small", "finite"] = "small"
    """Small sliding: less than a facet. Finite sliding: any distance, for bodies with separate
    meshes."""
    between: Annotated[tuple[Name, Name], Pair("[head_surface, liner_inner]")] | None = None
    """Boundaries of the first and the second side that slide on each other, if `sliding` is finite;
    by default those of the geometry."""
    quadrature: Literal[12, 48, 192] | None = None
    """Points per facet that transfer forces from an elastic side to the other, if `sliding` is
    finite. The default 12 is enough if the softer side has the finer mesh."""
    augmentation: PositiveStiffness | None = None
    """Augmentation parameter r; by default it is chosen. Results do not depend on it."""

    @model_validator(mode="after")
    def _check_sliding_keys(self) -> Coulomb:
        finite = self.sliding == "finite"
        for key in FINITE_SLIDING_KEYS:
            if getattr(self, key) is not None and not finite:
                fail("needs `sliding: finite` in the same interface", at=(key,))
        if self.elastic_layer is not None and finite:
            fail(f"contact with an elastic layer {SMALL_SLIDING_ONLY}", at=("elastic_layer",))
        return self

    @property
    def finite_sliding(self) -> bool:
        """True if the key `sliding` is finite."""
        return self.sliding == "finite"

    @property
    def mortar_points(self) -> int:
        """The key `quadrature`, or its default."""
        return self.quadrature or MORTAR_POINTS

    @property
    def sliding_boundaries(self) -> tuple[str, str] | None:
        """The key `between`."""
        return self.between

    @property
    def layer(self) -> tuple[float, float] | None:
        """The stiffnesses of `elastic_layer`."""
        if self.elastic_layer is None:
            return None
        normal = self.elastic_layer.normal
        return math.inf if normal is None else normal, self.elastic_layer.tangential

    @property
    def compresses(self) -> bool:
        """True if `elastic_layer` has a normal stiffness."""
        return self.elastic_layer is not None and self.elastic_layer.normal is not None

    def augmentation_of(self, local_stiffness: Floats, factor: float) -> Floats | float:
        """The given augmentation, or the default."""
        if self.augmentation is not None:
            return self.augmentation
        return factor * local_stiffness


class Penalty(Unilateral):
    """Contact through an elastic layer of equal normal and tangential stiffness; it penetrates."""

    kind: Literal["penalty"] = "penalty"
    penalty: PositiveStiffness
    """Pressure per penetration."""

    @property
    def layer(self) -> tuple[float, float]:
        """Normal and tangential stiffness: both the penalty [MPa/mm]."""
        return self.penalty, self.penalty


class Traction(InterfaceLaw):
    """Base of laws whose force is an explicit function of the gap, such as layers and cohesion.

    A subclass declares its keys. In its methods the keys are UFL scalars, and the argument is the
    state of the point at a gap. `traction` is required. Inside the program a subclass is in this
    module and its formula in a module of `forms`; no other file changes.

    `response` calls the methods once for each compiled form and differentiates their results. With
    the traction T and the debonded share s, the force of a point with multiplier F and jump D is T
    where s is 0 or None, else

    .. math:: T + P(F - T + r D),

    with P the response of contact without cohesion and the friction coefficient s μ, its work
    counted as friction (`mechanics.point_laws.PointLaws.evaluate`). `new_internal_variables` are
    committed with a converged step. The other results are numbers and fields of the run alone, but
    `dissipated` also sets the steps of a stage with `fracture_step`.
    """

    def traction(self, point: GapState) -> Expr:
        """Force per area that resists a gap (3,) [MPa]."""
        raise NotImplementedError

    def new_internal_variables(self, point: GapState) -> Mapping[str, Expr]:
        """Internal variables at a gap, by name, from those of the last converged state."""
        return {}

    def debonded_share(self, point: GapState) -> Expr | None:
        """Debonded share of the area, on which contact also acts [-]; none by default.

        The friction coefficient is multiplied by this share. The law then also derives from
        `Frictional`.
        """
        return None

    def stored(self, point: GapState) -> Expr | None:
        """Stored energy per area [N/mm]; none by default."""
        return None

    def dissipated(self, point: GapState) -> Expr | None:
        """Energy per area that a step dissipates, without friction [N/mm]; none by default.

        If the case gives `fracture_step`, load steps control this energy.
        """
        return None

    def slip(self, point: GapState) -> Expr | None:
        """Slip (3,) [mm], as in `forms.contact.Response`; none by default."""
        return None

    def status(self, point: GapState) -> Expr:
        """State of a point: OPEN, STICK or SLIP of `forms.contact`, or another number from 3 on.

        The default is STICK.
        """
        from ufl import as_ufl

        from forms.contact import STICK

        return STICK * as_ufl(1.0)

    @property
    def debonded_contact(self) -> Coulomb | None:
        """Contact law of the debonded area, if the subclass defines `debonded_share`."""
        if type(self).debonded_share is Traction.debonded_share:
            return None
        return Coulomb(friction_coefficient=self.friction)

    def constants_at_points(self, interface: str, stem: StemPlaces) -> dict[str, Field]:
        """Functions of points (n, 3) that return the constants there (n,), by name.

        Those of the debonded contact are among them.
        """
        constants = super().constants_at_points(interface, stem)
        if self.debonded_contact is not None:
            constants |= self.debonded_contact.constants_at_points(interface, stem)
        return constants

    @property
    def dissipates(self) -> bool:
        """True if the subclass defines `dissipated`."""
        return type(self).dissipated is not Traction.dissipated

    def response(self, point: AtPoint) -> Response:
        """Force, stored and dissipated energy, and their derivatives, in UFL."""
        from ufl import as_ufl, as_vector, variable

        from forms.contact import Response, derivative

        # A copy of the law in which each key is its UFL constant.
        law = self.model_copy(update=dict(point.constants))
        jump = variable(point.jump)
        committed = GapState(
            gap_vector=jump + point.initial_gap,
            normals=point.normals,
            internal_variables=point.internal_variables,
            committed=point.internal_variables,
            frozen=point.frozen,
        )
        internal_variables = point.updated(law.new_internal_variables(committed))
        state = replace(committed, internal_variables=internal_variables)
        force = law.traction(state)
        dissipated = law.dissipated(state)
        debonded_share = law.debonded_share(state)
        return Response(
            force=force,
            by_multiplier=None,
            by_jump=derivative(force, jump),
            pressures=as_vector([-p for p in point.normals.components(force)]),
            status=as_ufl(law.status(state)),
            internal_variables=internal_variables,
            slip=law.slip(state),
            stored=law.stored(state),
            dissipated=dissipated,
            dissipated_by_jump=None if dissipated is None else derivative(dissipated, jump),
            debonded_share=debonded_share,
            debonded_share_by_jump=(
                None if debonded_share is None else derivative(debonded_share, jump)
            ),
        )


class Cohesive(Frictional, Traction):
    """Cohesive interface: it debonds in tension, shear or mixed mode, then slides with friction."""

    can_open: ClassVar[bool] = True
    has_augmentation: ClassVar[bool] = True
    internal_variables: ClassVar[Mapping[str, tuple[int, ...]]] = {"damage": (), "spent": ()}

    kind: Literal["cohesive"] = "cohesive"
    friction_coefficient: NonNegativeNumber
    """Coulomb's coefficient of the debonded interface; 0 for none."""
    stiffness: StiffnessField
    """Cohesive traction per displacement, in tension and shear."""
    tensile_strength: StrengthField
    """Strength in tension. No value by finish is known for stem and cement: give it."""
    shear_strength: StrengthField
    """Strength in shear."""
    tensile_energy: FractureEnergyField
    """Fracture energy per area in tension. No value is known for stem and cement: give it."""
    shear_energy: FractureEnergyField
    """Fracture energy per area in shear. No value is known for stem and cement: give it."""
    mixing_exponent: MixingExponent = 2.0
    """Exponent of Benzeggagh and Kenane for mixed modes."""
    softening: Literal["linear", "exponential"] = "linear"
    """Decrease of the traction with the jump."""
    unbonded: ShareField = 0.0
    """Share of the area that is debonded from the start."""
    finish: Text | None = None
    """Surface finish of the library (`mantle explain finishes`); other keys override its values."""
    source: Source = None
    """Source of the strength."""

    @property
    def form(self) -> Hashable:
        """Cohesion by its softening, with or without friction."""
        return "cohesive", self.softening, self.friction > 0

    def cohesive_state(self, point: GapState) -> CohesiveState:
        """Cohesive response of a point at a gap.

        Each method below builds it again: UFL finds the common terms, which are compiled once.
        """
        from forms.cohesion import Cohesion, cohesive_state

        constants = Cohesion(
            K=self.stiffness,
            N=self.tensile_strength,
            S=self.shear_strength,
            G_I=self.tensile_energy,
            G_II=self.shear_energy,
            η=self.mixing_exponent,
            unbonded=self.unbonded,
            exponential=self.softening == "exponential",
        )
        return cohesive_state(
            constants, point.gap_vector, point.normals, point.committed, point.frozen
        )

    def traction(self, point: GapState) -> Expr:
        """Cohesive traction (3,) [MPa]."""
        return self.cohesive_state(point).traction

    def new_internal_variables(self, point: GapState) -> Mapping[str, Expr]:
        """Damage and dissipated part of the fracture energy [-]."""
        state = self.cohesive_state(point)
        return {"damage": state.damage, "spent": state.spent}

    def debonded_share(self, point: GapState) -> Expr:
        """Debonded share of the area [-]; 0 until the point is damaged."""
        return self.cohesive_state(point).debonded_share

    def stored(self, point: GapState) -> Expr:
        """Elastic energy of the cohesion per area [N/mm]."""
        return self.cohesive_state(point).stored

    def dissipated(self, point: GapState) -> Expr:
        """Fracture energy per area that the step dissipates [N/mm]."""
        return self.cohesive_state(point).dissipated_in_step

    @model_validator(mode="after")
    def _check_softening(self) -> Cohesive:
        # The same check as at points, for keys that are numbers.
        numbers = {n: v for n, v in self.constants.items() if not isinstance(v, str)}
        self.check({name: np.array([v]) for name, v in numbers.items()})
        return self

    def check(self, values: Mapping[str, Floats]) -> None:
        """Refuse a stiffness that is too small for softening: K < strength^2 / energy."""
        for mode in ("tensile", "shear"):
            names = ("stiffness", f"{mode}_strength", f"{mode}_energy")
            if not values.keys() >= set(names):
                continue
            K, strength, G = (values[name] for name in names)
            least_stiffness = strength**2 / G
            too_soft = K < least_stiffness
            if too_soft.any():
                k = int(too_soft.argmax())
                fail(
                    f"{K[k]:g} MPa/mm is too soft for {mode} strength and energy: "
                    f"expected at least strength^2 / energy = {least_stiffness[k]:g} MPa/mm",
                    at=("stiffness",),
                )


Interface = Annotated[InterfaceLaw, Kinds()]
