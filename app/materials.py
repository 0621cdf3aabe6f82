"""What a region is made of.

A stiffness that is not positive definite is refused. For transverse isotropy that means
E_l, E_t, mu_l > 0, |nu_t| < 1 and 1 - nu_t - 2 nu_l^2 E_t / E_l > 0. That margin is
(1 + nu) (1 - 2 nu) if the material is isotropic; where it is small, linear tetrahedra lock.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BeforeValidator, model_validator

from app.fields import ITEMS, Kinds, Model, fail, show
from app.units import Direction, Modulus, Number

History = Annotated[tuple[Number, ...], ITEMS] | None
# Poisson's ratio beyond which a material counts as nearly incompressible, and the margin there.
LOCKING_RATIO = 0.45
LOCKING_MARGIN = (1 + LOCKING_RATIO) * (1 - 2 * LOCKING_RATIO)
Strain6 = tuple[Number, Number, Number, Number, Number, Number]


def _six(value: object) -> object:
    """A single number is an isotropic strain."""
    if isinstance(value, list | tuple):
        if len(value) != 6:
            fail(f"has {len(value)} values; expected a number or six: [xx, yy, zz, yz, xz, xy]")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        fail(f"{show(value)} is not a strain; expected a number or six: [xx, yy, zz, yz, xz, xy]")
    return (value, value, value, 0.0, 0.0, 0.0)


class Eigenstrain(Model):
    """A strain that the region would take on if nothing held it: swelling, shrinkage, press fit."""

    strain: Annotated[Strain6, BeforeValidator(_six)]
    """Tensor components [xx, yy, zz, yz, xz, xy]; a single number is the same in all directions."""
    history: History = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""


class Isotropic(Model):
    """Linear elastic, the same in all directions."""

    kind: Literal["isotropic"] = "isotropic"
    youngs_modulus: Modulus
    """Young's modulus E."""
    poisson_ratio: Number
    """Poisson's ratio nu."""
    eigenstrains: Annotated[tuple[Eigenstrain, ...], ITEMS] = ()
    """Strains without stress; they add up."""

    @model_validator(mode="after")
    def _admissible(self) -> Isotropic:
        positive_definite(
            (self.youngs_modulus > 0.0, "youngs_modulus", "youngs_modulus > 0"),
            (-1.0 < self.poisson_ratio < 0.5, "poisson_ratio", "-1 < poisson_ratio < 0.5"),
        )
        return self

    @property
    def nearly_incompressible(self) -> bool:
        """Whether linear tetrahedra of it lock."""
        return self.poisson_ratio > LOCKING_RATIO


class TransverselyIsotropic(Model):
    """Linear elastic, with one direction (the fibre, or axis) unlike the two transverse to it."""

    kind: Literal["transversely_isotropic"] = "transversely_isotropic"
    axial_youngs_modulus: Modulus
    """E_l, along the fibre."""
    transverse_youngs_modulus: Modulus
    """E_t, across it."""
    axial_poisson_ratio: Number
    """nu_l = -(transverse strain)/(axial strain) under axial stress."""
    transverse_poisson_ratio: Number
    """nu_t, in the transverse plane."""
    axial_shear_modulus: Modulus
    """mu_l, between the fibre and the transverse plane."""
    fibre: Direction = (0.0, 0.0, 1.0)
    """Fibre direction; any length but zero, normalised."""
    eigenstrains: Annotated[tuple[Eigenstrain, ...], ITEMS] = ()
    """Strains without stress; they add up."""

    @model_validator(mode="before")
    @classmethod
    def _normalise(cls, values: object) -> object:
        if not isinstance(values, dict) or not isinstance(values.get("fibre"), list | tuple):
            return values
        fibre = values["fibre"]
        if not all(isinstance(c, int | float) and not isinstance(c, bool) for c in fibre):
            return values
        # Scaled first, so that neither huge nor tiny entries overflow.
        largest = max((abs(float(c)) for c in fibre), default=0.0)
        if not 0.0 < largest < math.inf:
            return values
        scaled = [c / largest for c in fibre]
        length = math.hypot(*scaled)
        # Left alone once it is of unit length, so that a saved case reads back unchanged.
        if abs(largest * length - 1.0) < 1e-12:
            return values
        return {**values, "fibre": [c / length for c in scaled]}

    @model_validator(mode="after")
    def _admissible(self) -> TransverselyIsotropic:
        if not any(self.fibre):
            fail("is the zero vector; expected a direction", at=("fibre",))
        e_l, e_t = self.axial_youngs_modulus, self.transverse_youngs_modulus
        nu_t = self.transverse_poisson_ratio
        positive_definite(
            (e_l > 0.0, "axial_youngs_modulus", "axial_youngs_modulus > 0"),
            (e_t > 0.0, "transverse_youngs_modulus", "transverse_youngs_modulus > 0"),
            (
                self.axial_shear_modulus > 0.0,
                "axial_shear_modulus",
                "axial_shear_modulus > 0",
            ),
            (-1.0 < nu_t < 1.0, "transverse_poisson_ratio", "-1 < transverse_poisson_ratio < 1"),
        )
        positive_definite(
            (
                self.margin > 0.0,
                "axial_poisson_ratio",
                "1 - transverse_poisson_ratio - 2 axial_poisson_ratio^2 "
                f"transverse_youngs_modulus / axial_youngs_modulus > 0 (it is {self.margin:.3g})",
            )
        )
        return self

    @property
    def margin(self) -> float:
        """1 - nu_t - 2 nu_l^2 E_t / E_l, positive; zero where the stiffness becomes infinite."""
        ratio = self.transverse_youngs_modulus / self.axial_youngs_modulus
        return 1.0 - self.transverse_poisson_ratio - 2.0 * self.axial_poisson_ratio**2 * ratio

    @property
    def nearly_incompressible(self) -> bool:
        """Whether linear tetrahedra of it lock."""
        return self.margin < LOCKING_MARGIN


def _true(value: object) -> object:
    if value is not True:
        fail(f"{show(value)} is not true; an elastic region has moduli and no `rigid`")
    return value


class Rigid(Model):
    """Not deformable: the region moves as one body."""

    rigid: Annotated[Literal[True], BeforeValidator(_true)]
    """Must be true."""


def positive_definite(*conditions: tuple[bool, str, str]) -> None:
    """Report the first violated condition for a positive definite stiffness.

    Args:
        conditions: Whether it holds, the key to blame, the inequality in the words of the file.
    """
    for holds, key, inequality in conditions:
        if not holds:
            fail(f"the stiffness is not positive definite; expected {inequality}", at=(key,))


Region = Annotated[Isotropic | TransverselyIsotropic | Rigid, Kinds(default="isotropic")]
