"""Materials of regions.

A stiffness that is not positive definite is refused. For transverse isotropy that means
E_l, E_t, mu_l > 0, |nu_t| < 1 and 1 - nu_t - 2 nu_l^2 E_t / E_l > 0. That margin is
(1 + nu) (1 - 2 nu) if the material is isotropic; where it is small, linear tetrahedra lock.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator

from app.laws.fibres import Fibre, FibreDirection
from app.laws.thermal import Thermal
from app.laws.values import History, Named
from app.schema.section import ITEMS, Kinds, Section, Text, Word, fail, show
from app.schema.units import Modulus, Number

if TYPE_CHECKING:
    from ufl.core.expr import Expr

Tissue = Annotated[Literal["bone", "cement", "implant", "other"], Word()]
# Poisson's ratio beyond which a material counts as nearly incompressible, and the margin there.
LOCKING_RATIO = 0.45
LOCKING_MARGIN = (1 + LOCKING_RATIO) * (1 - 2 * LOCKING_RATIO)
Strain6 = tuple[Number, Number, Number, Number, Number, Number]


def _six(value: object) -> object:
    """Expand a single number to an isotropic strain."""
    if isinstance(value, list | tuple):
        if len(value) != 6:
            fail(f"has {len(value)} values; expected a number or six: [xx, yy, zz, yz, xz, xy]")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        fail(f"{show(value)} is not a strain; expected a number or six: [xx, yy, zz, yz, xz, xy]")
    return (value, value, value, 0.0, 0.0, 0.0)


class Eigenstrain(Section):
    """Stress-free strain of a region: swelling, shrinkage, press fit."""

    strain: Annotated[Strain6, BeforeValidator(_six)]
    """Tensor components [xx, yy, zz, yz, xz, xy]; a single number is the same in all directions."""
    history: History = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""


class Elastic(Named):
    """Base of the elastic materials."""

    if TYPE_CHECKING:
        eigenstrains: tuple[Eigenstrain, ...]
        # None if isotropic.
        fibre: Fibre | None

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Elastic coefficients of eq. 48 [MPa]: two if isotropic, else five."""
        raise NotImplementedError

    @property
    def modulus(self) -> float:
        """Largest Young's modulus [MPa], which decides the stiffer side of an interface."""
        raise NotImplementedError

    def energy(self, ε: Expr, coefficients: Sequence[Any], fibre: Any) -> Expr:
        """Strain energy density ψ(ε) [MPa]; coefficients are UFL constants."""
        from forms import elasticity

        if self.fibre is None:
            return elasticity.isotropic_energy(ε, *coefficients)
        return elasticity.transversely_isotropic_energy(ε, fibre, *coefficients)


class Isotropic(Elastic):
    """Linear elastic, the same in all directions."""

    fibre: ClassVar[None] = None  # type: ignore[misc]

    kind: Literal["isotropic"] = "isotropic"
    youngs_modulus: Modulus
    """Young's modulus E."""
    poisson_ratio: Number
    """Poisson's ratio nu."""
    eigenstrains: Annotated[tuple[Eigenstrain, ...], ITEMS] = ()
    """Strains without stress; they add up."""
    thermal: Thermal | None = None
    """Conduction of heat; all regions or none."""
    material: Text | None = None
    """Material of the library (`mantle explain materials`); other keys change it."""
    tissue: Tissue | None = None
    """Tissue of the region: bone, cement, implant or other; a `file` has no default."""

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

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Two elastic coefficients [MPa]."""
        from forms import elasticity

        return elasticity.isotropic_coefficients(self.youngs_modulus, self.poisson_ratio)

    @property
    def modulus(self) -> float:
        """Young's modulus [MPa]."""
        return self.youngs_modulus


class TransverselyIsotropic(Elastic):
    """Linear elastic, with one direction (the fibre, or axis) unlike the two transverse to it."""

    kind: Literal["transversely_isotropic"] = "transversely_isotropic"
    axial_youngs_modulus: Modulus
    """Young's modulus E_l along the fibre."""
    transverse_youngs_modulus: Modulus
    """Young's modulus E_t across the fibre."""
    axial_poisson_ratio: Number
    """Poisson's ratio nu_l = -(transverse strain) / (axial strain) under axial stress."""
    transverse_poisson_ratio: Number
    """Poisson's ratio nu_t in the transverse plane."""
    axial_shear_modulus: Modulus
    """Shear modulus mu_l between the fibre and the transverse plane."""
    fibre: FibreDirection = Field((0.0, 0.0, 1.0), validate_default=True)  # type: ignore[assignment]
    """Fibre direction, of any length but zero, normalised; or those that an axis gives."""
    eigenstrains: Annotated[tuple[Eigenstrain, ...], ITEMS] = ()
    """Strains without stress; they add up."""
    thermal: Thermal | None = None
    """Conduction of heat; all regions or none."""
    material: Text | None = None
    """Material of the library (`mantle explain materials`); other keys change it."""
    tissue: Tissue | None = None
    """Tissue of the region: bone, cement, implant or other; a `file` has no default."""

    @model_validator(mode="after")
    def _admissible(self) -> TransverselyIsotropic:
        if self.thermal is not None and self.thermal.fibre is not None:
            fail("the region has a fibre of its own", at=("thermal", "fibre"))
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
        """1 - nu_t - 2 nu_l^2 E_t / E_l, positive; the stiffness is infinite at zero."""
        ratio = self.transverse_youngs_modulus / self.axial_youngs_modulus
        return 1.0 - self.transverse_poisson_ratio - 2.0 * self.axial_poisson_ratio**2 * ratio

    @property
    def nearly_incompressible(self) -> bool:
        """Whether linear tetrahedra of it lock."""
        return self.margin < LOCKING_MARGIN

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Five elastic coefficients [MPa]."""
        from forms import elasticity

        return elasticity.transversely_isotropic_coefficients(
            self.axial_youngs_modulus,
            self.transverse_youngs_modulus,
            self.axial_poisson_ratio,
            self.transverse_poisson_ratio,
            self.axial_shear_modulus,
        )

    @property
    def modulus(self) -> float:
        """Larger of its Young's moduli [MPa]."""
        return max(self.axial_youngs_modulus, self.transverse_youngs_modulus)


def _true(value: object) -> object:
    if value is not True:
        fail(f"{show(value)} is not true; an elastic region has moduli and no `rigid`")
    return value


class Rigid(Named):
    """Rigid: the region moves as one body."""

    rigid: Annotated[Literal[True], BeforeValidator(_true)]
    """Says that the region moves as one body; must be true."""
    thermal: Thermal | None = None
    """Conduction of heat; all regions or none."""
    material: Text | None = None
    """Material of the library (`mantle explain materials`); other keys change it."""
    tissue: Tissue | None = None
    """Tissue of the region: bone, cement, implant or other; a `file` has no default."""

    @model_validator(mode="after")
    def _strainless(self) -> Rigid:
        if self.thermal is not None:
            _does_not(self.thermal, "a rigid region", "thermal_expansion", "cure")
        return self


class Conductor(Named):
    """Conducts heat without deforming; all regions or none."""

    kind: Literal["conductor"] = "conductor"
    thermal: Thermal
    """Conduction of heat."""
    material: Text | None = None
    """Material of the library (`mantle explain materials`); other keys change it."""
    tissue: Tissue | None = None
    """Tissue of the region: bone, cement, implant or other; a `file` has no default."""

    @model_validator(mode="after")
    def _strainless(self) -> Conductor:
        _does_not(self.thermal, "a conductor", "thermal_expansion")
        return self


def _does_not(thermal: Thermal, what: str, *keys: str) -> None:
    """Refuse keys of deformation in a region that does not deform."""
    for key in keys:
        if getattr(thermal, key) is not None:
            fail(f"{what} does not deform; expected an elastic region", at=("thermal", key))


def positive_definite(*conditions: tuple[bool, str, str]) -> None:
    """Report the first violated condition for a positive definite stiffness.

    Args:
        conditions: Whether it holds, the key to report, the inequality in keys of the file.
    """
    for holds, key, inequality in conditions:
        if not holds:
            fail(f"the stiffness is not positive definite; expected {inequality}", at=(key,))


Region = Annotated[
    Isotropic | TransverselyIsotropic | Rigid | Conductor, Kinds(default="isotropic")
]
