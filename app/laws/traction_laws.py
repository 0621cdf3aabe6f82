"""Laws whose force is an explicit function of the gap: the base for other laws, and cohesion."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from app.laws.contact_laws import Contact
from app.laws.interface_laws import AtPoint, Frictional, GapState, InterfaceLaw
from app.laws.values import (
    FractureEnergyField,
    ShareField,
    Source,
    StemPlaces,
    StiffnessField,
    StrengthField,
)
from app.schema.section import Text, fail
from app.schema.units import (
    MixingExponent,
    NonNegativeNumber,
)

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from app.foundation.arrays import Bools, Field, Floats
    from forms.cohesion import CohesiveState
    from forms.contact import Response

# Shares of shear at which a cohesive law is checked for softening [-].
SHEAR_SHARES = np.linspace(0.0, 1.0, 101)


class Traction(InterfaceLaw):
    """Base of laws whose force is an explicit function of the gap, such as layers and cohesion.

    A subclass declares its keys. In its methods the keys are UFL scalars, and the argument is the
    state of the point at a gap. `traction` is required. A law whose sides can separate without
    resistance sets `can_open`. Inside the program a subclass is in this module and its formula in a
    module of `forms`; no other file changes.

    `response` calls the methods once for each compiled form and differentiates their results. With
    the traction T and the debonded share s, the force of a point with multiplier λ is T where s is
    0 or None, else

    .. math:: T + P(λ - T + r ΔG),

    with P and ΔG those of contact without cohesion and the friction coefficient s μ, its work
    counted as friction (`mechanics.debonded_contact`). `new_internal_variables` are
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
    def debonded_contact(self) -> Contact | None:
        """Contact law of the debonded area, if the subclass defines `debonded_share`."""
        if type(self).debonded_share is Traction.debonded_share:
            return None
        return Contact(friction_coefficient=self.largest_friction)

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
        return "cohesive", self.softening, self.largest_friction > 0

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

    def resists_sliding(self, interface: str, stem: StemPlaces) -> Callable[[Floats], Bools]:
        """Function of points (n, 3) that is True where there is a bond or friction (n,)."""
        unbonded = self.constants_at_points(interface, stem)["unbonded"]
        return lambda x: (unbonded(x) < 1) | (self.largest_friction > 0)

    @model_validator(mode="after")
    def _check_softening(self) -> Cohesive:
        # The same check as at points, for keys that are numbers.
        numbers = {n: v for n, v in self.constants.items() if not isinstance(v, str)}
        self.check({name: np.array([v]) for name, v in numbers.items()})
        return self

    def check(self, values: Mapping[str, Floats]) -> None:
        """Refuse a stiffness that is too small for softening: K < strength^2 / energy.

        In mixed modes strength and energy depend on the share B of shear (`forms.cohesion`). With a
        large η the energy may be too small there: softening would end at a jump below its onset,
        2 K energy <= strength^2.
        """
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
        strengths = ("tensile_strength", "shear_strength")
        energies = ("tensile_energy", "shear_energy")
        all_names = ("stiffness", *strengths, *energies, "mixing_exponent")
        if values.keys() >= set(all_names):
            K, N, S, G_I, G_II, η = (values[name] for name in all_names)
            B = SHEAR_SHARES[:, None]
            energy = G_I + (G_II - G_I) * B**η
            least_stiffness = 1 / (2 * energy * ((1 - B) / N**2 + B / S**2))
            if (K <= least_stiffness).any():
                b, point = np.unravel_index((least_stiffness / K).argmax(), least_stiffness.shape)
                fail(
                    f"{K[point]:g} MPa/mm is too soft for a mixed mode with "
                    f"{SHEAR_SHARES[b]:.0%} of shear: expected above "
                    f"{least_stiffness[b, point]:.4g} MPa/mm, or a smaller mixing_exponent",
                    at=("stiffness",),
                )
