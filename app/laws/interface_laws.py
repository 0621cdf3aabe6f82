"""Constitutive laws of interfaces, and their keys in a case.

A law is a section of the case. Its class has the keys, the properties (for example `can_open`), the
stiffness of the trial force and the formula in UFL. The way of `friction_coefficient` from the YAML
file to the residual is `Frictional.friction` -> `Unilateral.values` -> `Unilateral.response` ->
`forms.contact.contact_law`, evaluated by `mechanics.contact_law.PointLaw.evaluate`.

To add a law, derive from `Traction` (a force that is a function of the gap) or from `InterfaceLaw`.
`app/README.md` has an example.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
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
    "is limited to small sliding; for finite sliding use `kind: contact` without `compliance`"
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
        gap: Vector whose normal components are the initial gap of each face (3,) [mm].
        jump_old: Jump of the last converged state (3,) [mm].
        S_star: Coefficient that replaces the trial force where it is frozen (3,) [MPa].
        normals: Unit normals of one to three faces, from master to slave, each (3,), with duals.
        r: Stiffness of the trial force [MPa/mm].
        values: Constants of the law, by name.
        internal_variables: Internal variables of the last converged state, by name.
        live: 1, or 0 while the internal variables are frozen. They are frozen in the first solve of
            a step, so that no early iterate damages a point.
    """

    F: Expr
    jump: Expr
    gap: Expr
    jump_old: Expr
    S_star: Coefficient
    normals: Faces
    r: Expr
    values: Mapping[str, Expr]
    internal_variables: Mapping[str, Expr]
    live: Expr

    def updated(self, internal_variables: Mapping[str, Expr]) -> dict[str, Expr]:
        """Internal variables after the step; the old ones while they are frozen."""
        from ufl import as_vector, conditional, gt

        def selected(new: Expr, old: Expr) -> Expr:
            if not old.ufl_shape:
                return conditional(gt(self.live, 0.5), new, old)
            return as_vector([selected(new[i], old[i]) for i in range(len(old))])

        return {
            name: selected(internal_variables[name], old)
            for name, old in self.internal_variables.items()
        }


class InternalVariables(dict[str, "Expr"]):
    """Internal variables of a point at a gap, by name.

    Attributes:
        old: Internal variables of the last converged state, by name.
        live: 1, or 0 while the internal variables are frozen.
    """

    def __init__(self, new: Mapping[str, Expr], old: Mapping[str, Expr], live: Expr) -> None:
        super().__init__(new)
        self.old = old
        self.live = live


class InterfaceLaw(Extensible):
    """Base of the interface laws. Each subclass with a `kind` is a law.

    Attributes:
        can_part: True if the sides can move relative to each other. The interface then has unknown
            jumps.
        can_open: True if the sides can separate without resistance.
        augmented: True if the multiplier is exact and does not depend on the augmentation.
        is_contact: True for contact alone, whose slip follows from its state.
        internal_variables: Shapes of the internal variables at a point, by name: () for a scalar,
            (3,) for a vector. For a law with `damage` and `spent` (the dissipated part of its
            fracture energy), the summary has the numbers of damaged interfaces.
    """

    # A `Literal` in each subclass.
    kind: Any
    can_part: ClassVar[bool] = True
    can_open: ClassVar[bool] = False
    augmented: ClassVar[bool] = False
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
        match self.conductance:
            case PressureConductance(open=least, per_pressure=slope, cap=cap):
                return least, slope, math.inf if cap is None else cap
            case constant:
                return math.inf if constant is None else constant, 0.0, math.inf

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
        """Points per facet that hand forces from one side to the other in finite sliding."""
        return MORTAR_POINTS

    @property
    def sliding_boundaries(self) -> tuple[str, str] | None:
        """Boundaries that slide on each other; None for those of the geometry."""
        return None

    @property
    def friction(self) -> float:
        """Coulomb's friction coefficient [-]. If it is 0, no tangential term is compiled."""
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
    def gap_multipliers(self) -> tuple[float, ...] | None:
        """Multipliers of the initial gap at the ends of the stages (`values.gap_at`)."""
        return None

    def gap_field(self, interface: str, stem: StemPlaces) -> Field:
        """Initial gap at points (n, 3), negative for an interference: shape (n,) [mm]."""
        return field(f"interfaces.{interface}.gap", 0.0)

    @property
    def without_effect(self) -> dict[tuple[str, ...], str]:
        """Keys that have no effect with the others, by path, and the reason."""
        return {}

    @property
    def zone_heights(self) -> Mapping[str, tuple[float, float]]:
        """Heights on the stem between which parts of the interface have other numbers, by name."""
        return {}

    @property
    def layer(self) -> tuple[float, float] | None:
        """Normal and tangential stiffness of an elastic layer in series [MPa/mm]; None without.

        The normal one is infinite where only the tangential one is given.
        """
        return None

    @property
    def debonded_contact(self) -> Coulomb | None:
        """Contact law of the debonded area; None if the law has none."""
        return None

    @property
    def dissipates(self) -> bool:
        """True if the response has `dissipated_by_jump`, so that `fracture_step` can control it."""
        return False

    @property
    def values(self) -> Mapping[str, float | str | Patches]:
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
        inner = (m for kind in get_args(model_field.annotation) for m in get_args(kind))
        return next((m for m in (*model_field.metadata, *inner) if isinstance(m, Varying)), None)

    def fields(self, interface: str, stem: StemPlaces) -> dict[str, Field]:
        """Functions of points (n, 3) that return the values (n,), by name."""
        key = f"interfaces.{interface}."
        return {n: field(key + n, v, self._mark(n)) for n, v in self.values.items()}

    def check(self, at: Mapping[str, Floats]) -> None:
        """Check values at points (n,); raise PydanticCustomError if they contradict each other."""

    def response(self, at: AtPoint) -> Response:
        """Force and derivatives of the law, in UFL."""
        raise NotImplementedError

    def trial_stiffness(self, local_stiffness: Floats, factor: float) -> Floats | float:
        """Stiffness r of the trial force (n,) [MPa/mm].

        Args:
            local_stiffness: Stiffness per area against the jump of each point (n,) [MPa/mm].
            factor: Default ratio of the augmentation to the local stiffness [-].
        """
        return factor * local_stiffness


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
    """Part of a stem's surface between two heights, with separate numbers."""

    NUMBERS: ClassVar[tuple[str, ...]] = ("friction_coefficient", "gap", "interference")

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

    def replaces(self, other: SurfaceZone, key: str) -> bool:
        """True if this zone, which comes later, covers another one and has a separate number."""
        (lower_height, upper_height), (other_lower, other_upper) = self.heights, other.heights
        covers = lower_height <= other_lower and other_upper <= upper_height
        if key == "friction_coefficient":
            return covers and self.friction_coefficient is not None
        return covers and (self.gap is not None or self.interference is not None)

    @property
    def heights(self) -> tuple[float, float]:
        """Heights at which it begins and ends [mm]; infinite where none is given."""
        lower_height = -math.inf if self.above is None else self.above
        return lower_height, math.inf if self.below is None else self.below


def _interference(key: str, value: float | str | Table, stem: StemPlaces, x: Floats) -> Floats:
    """Interference of a key at points (n, 3): shape (n,) [mm]; 0 beside the flanks of a stem."""
    if isinstance(value, tuple):
        heights, lengths = zip(*value, strict=True)
        interference = np.interp(stem.height_on_stem(x), heights, lengths)
    else:
        interference = field(key, value, INTERFERENCE)(x)
    return np.where(stem.on_flanks(x), interference, 0.0)


class Unilateral(Frictional):
    """Unilateral contact with Coulomb friction: exact, or with a penalty (`forms.contact`)."""

    can_open: ClassVar[bool] = True
    augmented: ClassVar[bool] = True
    is_contact: ClassVar[bool] = True

    gap: LengthField = 0.0
    """Initial gap: a clearance if positive, an interference (press fit) if negative."""
    interference: InterferenceField | None = None
    """Radial interference of a press fit: half of the diametral one. A length, an expression, or
    pairs of height above the stem's tip and length, linear in between. It acts on the flanks of a
    stem, not on its end, and grows during the first stage. In place of `gap`."""
    zones: Annotated[dict[Name, SurfaceZone], MAPPING] | None = None
    """Parts of a stem's surface with separate numbers, such as a coating. Where two overlap, the
    later one counts."""
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
    def heated_by_friction(self) -> FrictionHeating | None:
        """The key `friction_heating`."""
        return self.friction_heating

    @property
    def friction(self) -> float:
        """The largest `friction_coefficient` of the interface and its zones."""
        zones = [zone.friction_coefficient for zone in (self.zones or {}).values()]
        return max([self.friction_coefficient, *(μ for μ in zones if μ is not None)])

    @property
    def has_gap(self) -> bool:
        """True if a key gives a gap or an interference."""
        surfaces: list[Unilateral | SurfaceZone] = [self, *(self.zones or {}).values()]
        return any(surface.gap or surface.interference for surface in surfaces)

    @property
    def is_press_fit(self) -> bool:
        """True if `interference` is given, of the interface or of a zone."""
        surfaces: list[Unilateral | SurfaceZone] = [self, *(self.zones or {}).values()]
        return any(surface.interference is not None for surface in surfaces)

    @property
    def gap_multipliers(self) -> tuple[float, ...] | None:
        """The key `gap_history`."""
        return self.gap_history

    @property
    def without_effect(self) -> dict[tuple[str, ...], str]:
        """Keys that have no effect with the others, by path, and the reason."""
        keys = super().without_effect
        if not self.has_gap:
            keys["gap_history",] = "there is no gap and no interference"
        zones = list((self.zones or {}).items())
        for k, (name, zone) in enumerate(zones):
            for key in SurfaceZone.NUMBERS:
                covering = next((n for n, z in zones[k + 1 :] if z.replaces(zone, key)), None)
                if covering is not None:
                    keys["zones", name, key] = f"zone {covering} counts there, as the later one"
        return keys

    @property
    def zone_heights(self) -> Mapping[str, tuple[float, float]]:
        """Heights of the zones on the stem [mm]."""
        return {name: zone.heights for name, zone in (self.zones or {}).items()}

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
            for name, zone in (self.zones or {}).items():
                inside = in_zone(*zone.heights, stem.height_on_stem(x))
                zone_gap = gap_of(zone, f"{key}.zones.{name}", x[inside])
                if zone_gap is not None:
                    gaps[inside] = zone_gap
            return gaps

        return gap

    def fields(self, interface: str, stem: StemPlaces) -> dict[str, Field]:
        """The friction coefficient at points (n, 3): shape (n,)."""
        if self.friction == 0.0:
            return {}

        def friction(x: Floats) -> Floats:
            coefficients = np.full(len(x), self.friction_coefficient)
            for zone in (self.zones or {}).values():
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
    def values(self) -> Mapping[str, float | str]:
        """The friction coefficient."""
        return {"μ": self.friction} if self.friction > 0 else {}

    def response(self, at: AtPoint) -> Response:
        """Law of the augmented Lagrangian at a point (eq. 65)."""
        from forms.contact import contact_law

        state = (at.F, at.jump, at.gap, at.jump_old, at.S_star)
        return contact_law(*state, at.normals, at.values.get("μ"), at.r)


class Compliance(Section):
    """An elastic layer in series with contact."""

    normal: PositiveStiffness | None = None
    """Pressure per approach; rigid by default."""
    tangential: PositiveStiffness
    """Shear per elastic shift."""


class Coulomb(Unilateral):
    """Unilateral contact with Coulomb friction, exactly: augmented Lagrangian."""

    kind: Literal["contact"] = "contact"
    compliance: Compliance | None = None
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
        if self.compliance is not None and finite:
            fail(f"contact with compliance {SMALL_SLIDING_ONLY}", at=("compliance",))
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
        """The stiffnesses of `compliance`."""
        if self.compliance is None:
            return None
        normal = self.compliance.normal
        return math.inf if normal is None else normal, self.compliance.tangential

    def trial_stiffness(self, local_stiffness: Floats, factor: float) -> Floats | float:
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

    A subclass declares its keys. In its methods the keys are UFL scalars. All methods have the same
    arguments:

        gap: Displacement of the slave minus that of the master, with the initial gap (3,) [mm].
        normals: Unit normals of the point's faces, from master to slave, each (3,).
        internal_variables: Internal variables at the gap by name, as `remembered` returns them.
            Its attribute `old` has the values of the last converged state.
    """

    def traction(self, gap: Expr, normals: Faces, internal_variables: InternalVariables) -> Expr:
        """Force per area that resists a gap (3,) [MPa]."""
        raise NotImplementedError

    def remembered(
        self, gap: Expr, normals: Faces, internal_variables: InternalVariables
    ) -> Mapping[str, Expr]:
        """Internal variables at a gap, by name, from their values in the last converged state."""
        return {}

    def broken(self, gap: Expr, normals: Faces, internal_variables: InternalVariables) -> Expr:
        """Debonded share of the area, on which contact also acts [-]; none by default.

        The friction coefficient is multiplied by this share. The law then also derives from
        `Frictional`.
        """
        return None

    def stored(self, gap: Expr, normals: Faces, internal_variables: InternalVariables) -> Expr:
        """Stored energy per area [N/mm]; none by default."""
        return None

    def dissipated(self, gap: Expr, normals: Faces, internal_variables: InternalVariables) -> Expr:
        """Energy per area that a step dissipates, without friction [N/mm]; none by default.

        If the case gives `fracture_step`, load steps control this energy.
        """
        return None

    def slip(self, gap: Expr, normals: Faces, internal_variables: InternalVariables) -> Expr:
        """Irreversible tangential motion (3,) [mm]; none by default."""
        return None

    def status(self, gap: Expr, normals: Faces, internal_variables: InternalVariables) -> Expr:
        """State of a point: OPEN, STICK or SLIP of `forms.contact`, or another number from 3 on.

        The default is STICK.
        """
        from ufl import as_ufl

        from forms.contact import STICK

        return STICK * as_ufl(1.0)

    @property
    def debonded_contact(self) -> Coulomb | None:
        """Contact law of the debonded area, if the subclass defines `broken`."""
        if type(self).broken is Traction.broken:
            return None
        return Coulomb(friction_coefficient=self.friction)

    @property
    def dissipates(self) -> bool:
        """True if the subclass defines `dissipated`."""
        return type(self).dissipated is not Traction.dissipated

    def response(self, at: AtPoint) -> Response:
        """Force, stored and dissipated energy, and their derivatives, in UFL."""
        from ufl import as_ufl, as_vector, variable

        from forms.contact import Response, derivative

        law = self.model_copy(update=dict(at.values))
        jump = variable(at.jump)
        gap = jump + at.gap
        old_variables = InternalVariables(at.internal_variables, at.internal_variables, at.live)
        internal_variables = at.updated(law.remembered(gap, at.normals, old_variables))
        point_state = (
            gap,
            at.normals,
            InternalVariables(internal_variables, at.internal_variables, at.live),
        )
        force = law.traction(*point_state)
        dissipated, broken = law.dissipated(*point_state), law.broken(*point_state)
        return Response(
            force=force,
            by_multiplier=None,
            by_jump=derivative(force, jump),
            pressures=as_vector([-p for p in at.normals.components(force)]),
            status=as_ufl(law.status(*point_state)),
            internal_variables=internal_variables,
            slip=law.slip(*point_state),
            stored=law.stored(*point_state),
            dissipated=dissipated,
            dissipated_by_jump=None if dissipated is None else derivative(dissipated, jump),
            broken=broken,
            broken_by_jump=None if broken is None else derivative(broken, jump),
        )


class Cohesive(Frictional, Traction):
    """Cohesive interface: it debonds in tension, shear or mixed mode, then slides with friction."""

    can_open: ClassVar[bool] = True
    augmented: ClassVar[bool] = True
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

    def cohesive_state(
        self, gap: Expr, normals: Faces, internal_variables: InternalVariables
    ) -> CohesiveState:
        """Cohesive response of a point at a gap; see `Traction` for the arguments."""
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
            constants, gap, normals, internal_variables.old, internal_variables.live
        )

    def traction(self, gap: Expr, normals: Faces, internal_variables: InternalVariables) -> Expr:
        """Cohesive traction (3,) [MPa]."""
        return self.cohesive_state(gap, normals, internal_variables).traction

    def remembered(
        self, gap: Expr, normals: Faces, internal_variables: InternalVariables
    ) -> Mapping[str, Expr]:
        """Damage and dissipated part of the fracture energy [-]."""
        state = self.cohesive_state(gap, normals, internal_variables)
        return {"damage": state.damage, "spent": state.spent}

    def broken(self, gap: Expr, normals: Faces, internal_variables: InternalVariables) -> Expr:
        """Debonded share of the area [-]; 0 until the point is damaged."""
        return self.cohesive_state(gap, normals, internal_variables).broken

    def stored(self, gap: Expr, normals: Faces, internal_variables: InternalVariables) -> Expr:
        """Elastic energy of the cohesion per area [N/mm]."""
        return self.cohesive_state(gap, normals, internal_variables).stored

    def dissipated(self, gap: Expr, normals: Faces, internal_variables: InternalVariables) -> Expr:
        """Fracture energy per area that the step dissipates [N/mm]."""
        return self.cohesive_state(gap, normals, internal_variables).dissipated_in_step

    @model_validator(mode="after")
    def _check_softening(self) -> Cohesive:
        numbers = {n: v for n, v in self.values.items() if not isinstance(v, str)}
        self.check({name: np.array([v]) for name, v in numbers.items()})
        return self

    def check(self, at: Mapping[str, Floats]) -> None:
        """Refuse a stiffness that is too small for softening: K < strength^2 / energy."""
        for mode in ("tensile", "shear"):
            key_names = ("stiffness", f"{mode}_strength", f"{mode}_energy")
            if not at.keys() >= set(key_names):
                continue
            K, strength, G = (at[name] for name in key_names)
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
