"""Laws of unilateral contact, with Coulomb friction, an elastic layer or a penalty; zones."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from app.laws.interface_laws import (
    FINITE_SLIDING_KEYS,
    MORTAR_POINTS,
    SMALL_SLIDING_ONLY,
    AtPoint,
    Frictional,
    GapKeys,
    SurfaceZone,
)
from app.laws.thermal import FrictionHeating
from app.laws.values import (
    GAP,
    INTERFERENCE,
    GapField,
    InterferenceField,
    LoadHistory,
    StemPlaces,
    Table,
    field,
    in_zone,
)
from app.schema.section import MAPPING, Name, Pair, Section, fail
from app.schema.units import (
    PositiveStiffness,
)

if TYPE_CHECKING:
    from app.foundation.arrays import Bools, Field, Floats
    from forms.contact import Response


# Gap where bone never touches the stem: more than any motion [mm].
OFF_BONE = 100.0


def _interference(key: str, value: float | str | Table, stem: StemPlaces, x: Floats) -> Floats:
    """Interference of a key at points (n, 3): shape (n,) [mm]; 0 outside the flanks of a stem."""
    if isinstance(value, tuple):
        heights, lengths = zip(*value, strict=True)
        interference = np.interp(stem.height_on_stem(x), heights, lengths)
    else:
        interference = field(key, value, INTERFERENCE)(x)
    return np.where(stem.on_flanks(x), interference, 0.0)


class Unilateral(Frictional):
    """Unilateral contact with Coulomb friction: exact, or in series with a layer or a penalty."""

    can_open: ClassVar[bool] = True
    is_contact: ClassVar[bool] = True

    gap: GapField = 0.0
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
        if self.friction_heating is not None and self.largest_friction == 0.0:
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
    def frictions(self) -> Mapping[tuple[str, ...], float]:
        """The keys `friction_coefficient` of the interface and its zones."""
        zones: dict[tuple[str, ...], float] = {
            ("zones", name, "friction_coefficient"): zone.friction_coefficient
            for name, zone in self.surface_zones.items()
            if zone.friction_coefficient is not None
        }
        return {**super().frictions, **zones}

    @property
    def gaps(self) -> Mapping[tuple[str, ...], GapKeys]:
        """The interface and its zones, by the path of their keys below the law."""
        gaps: dict[tuple[str, ...], GapKeys] = {(): self}
        gaps |= {("zones", name): zone for name, zone in self.surface_zones.items()}
        return gaps

    @property
    def has_initial_gap(self) -> bool:
        """True if a key gives a gap or an interference, of the interface or of a zone."""
        return any(surface.gap or surface.interference for surface in self.gaps.values())

    @property
    def is_press_fit(self) -> bool:
        """True if `interference` is given, of the interface or of a zone."""
        return any(surface.interference is not None for surface in self.gaps.values())

    @property
    def overlaps_initially(self) -> bool:
        """True if an interference or a negative gap is given, of the interface or of a zone."""
        return self.is_press_fit or any(
            isinstance(surface.gap, float) and surface.gap < 0.0 for surface in self.gaps.values()
        )

    @property
    def gap_multipliers(self) -> tuple[float, ...] | None:
        """The key `gap_history`."""
        return self.gap_history

    @property
    def without_effect(self) -> dict[tuple[str, ...], str]:
        """Reasons why given keys have no effect, by path."""
        reasons = super().without_effect
        if not self.has_initial_gap:
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
        return {
            (*path, "interference"): tuple(height for height, _ in surface.interference)
            for path, surface in self.gaps.items()
            if isinstance(surface.interference, tuple)
        }

    def gap_field(self, interface: str, stem: StemPlaces) -> Field:
        """Initial gap at points (n, 3), negative for an interference: shape (n,) [mm]."""
        key = f"interfaces.{interface}"

        def gap_of(part: Unilateral | SurfaceZone, key: str, x: Floats) -> Floats | None:
            """The gap of a part; None if none is given for it."""
            if part.interference is not None:
                return -_interference(f"{key}.interference", part.interference, stem, x)
            return None if part.gap is None else field(f"{key}.gap", part.gap, GAP)(x)

        def gap(x: Floats) -> Floats:
            gaps = gap_of(self, key, x)
            assert gaps is not None  # its default is 0
            for name, zone in self.surface_zones.items():
                inside = in_zone(*zone.heights, stem.height_on_stem(x))
                zone_gap = gap_of(zone, f"{key}.zones.{name}", x[inside])
                if zone_gap is not None:
                    gaps[inside] = zone_gap
            is_off_bone = stem.off_bone(interface, x)
            gaps[is_off_bone] = np.maximum(gaps[is_off_bone], OFF_BONE)
            return gaps

        return gap

    def constants_at_points(self, interface: str, stem: StemPlaces) -> dict[str, Field]:
        """Friction coefficient as function of points, under the name μ of the form; none if 0."""
        if self.largest_friction == 0.0:
            return {}

        def friction(x: Floats) -> Floats:
            coefficients = np.full(len(x), self.friction_coefficient)
            for zone in self.surface_zones.values():
                if zone.friction_coefficient is not None:
                    inside = in_zone(*zone.heights, stem.height_on_stem(x))
                    coefficients[inside] = zone.friction_coefficient
            return coefficients

        return {"μ": friction}

    def resists_sliding(self, interface: str, stem: StemPlaces) -> Callable[[Floats], Bools]:
        """Function of points (n, 3) that is True where there is friction (n,)."""
        friction = self.constants_at_points(interface, stem).get("μ")
        return lambda x: friction(x) > 0 if friction else np.zeros(len(x), dtype=bool)

    @property
    def form(self) -> Hashable:
        """Contact, with or without friction."""
        return "contact", self.largest_friction > 0

    @property
    def constants(self) -> Mapping[str, float | str]:
        """The largest friction coefficient, under the name μ of the form; none if it is 0.

        `constants_at_points` gives the coefficient of each point.
        """
        return {"μ": self.largest_friction} if self.largest_friction > 0 else {}

    def response(self, point: AtPoint) -> Response:
        """Law of the augmented Lagrangian at a point (eq. 65)."""
        from forms.contact import contact_law

        return contact_law(
            λ=point.λ,
            jump=point.jump,
            initial_gap=point.initial_gap,
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


class Contact(Unilateral):
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
    def _check_sliding_keys(self) -> Contact:
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

    def augmentation_of(self, softest_stiffness: Floats, factor: float) -> Floats | float:
        """The given augmentation, or the default."""
        if self.augmentation is not None:
            return self.augmentation
        return factor * softest_stiffness


class Penalty(Unilateral):
    """Contact through an elastic layer of equal normal and tangential stiffness; it penetrates."""

    kind: Literal["penalty"] = "penalty"
    penalty: PositiveStiffness
    """Pressure per penetration."""

    @property
    def layer(self) -> tuple[float, float]:
        """Normal and tangential stiffness: both the penalty [MPa/mm]."""
        return self.penalty, self.penalty
