"""Materials of regions.

A stiffness that is not positive definite is refused. A transversely isotropic material needs
E_l, E_t, mu_l > 0, |nu_t| < 1 and the margin 1 - nu_t - 2 nu_l^2 E_t / E_l > 0. For an isotropic
material the margin is (1 + nu) (1 - 2 nu). If the margin is small, linear tetrahedra lock.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from app.laws.creep import Creep
from app.laws.densities import ChangingDensity, ModulusField
from app.laws.fibres import Fibre, FibreDirection
from app.laws.thermal import Thermal
from app.laws.values import LoadHistory, OfRegion, Source, Status, Table, rising
from app.schema.section import ITEMS, UNION_TAG, Kinds, Pair, Section, Text, fail, show
from app.schema.units import Length, Modulus, Number, Plain

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from app.foundation.arrays import Floats

Tissue = Literal["bone", "cement", "implant", "other"]
# Poisson's ratio beyond which a material counts as nearly incompressible, and the margin there.
LOCKING_RATIO = 0.45
LOCKING_MARGIN = (1 + LOCKING_RATIO) * (1 - 2 * LOCKING_RATIO)
Strain6 = tuple[Number, Number, Number, Number, Number, Number]


def _six(value: object) -> object:
    """Expand a single number to an isotropic strain."""
    expected_text = "expected a number or six: [xx, yy, zz, yz, xz, xy]"
    if isinstance(value, list | tuple):
        return value if len(value) == 6 else fail(f"has {len(value)} values; {expected_text}")
    if isinstance(value, bool) or not isinstance(value, int | float):
        fail(f"{show(value)} is not a strain; {expected_text}")
    return (value, value, value, 0.0, 0.0, 0.0)


def _sloped(table: Table) -> Table:
    return (
        table if len(table) > 1 else fail("has one pair; expected at least two pairs, or one value")
    )


def _form(E: object) -> str:
    """Form of a modulus: a value, pairs, or a section."""
    pairs = "graded" if isinstance(E, list | tuple) else "constant"
    return UNION_TAG + ("field" if isinstance(E, dict | ModulusField) else pairs)


# A modulus, pairs of height and modulus, or a field that another package reads.
YoungsModulus = Annotated[
    Annotated[Modulus, Tag(UNION_TAG + "constant")]
    | Annotated[
        tuple[Annotated[tuple[Length, Modulus], Pair("[-118 mm, 0.1 GPa]")], ...],
        AfterValidator(rising("height")),
        AfterValidator(_sloped),
        Tag(UNION_TAG + "graded"),
    ]
    | Annotated[ModulusField, Kinds("."), Tag(UNION_TAG + "field")],
    Discriminator(_form),
]


class Eigenstrain(Section):
    """Strain of a region without stress: swelling, shrinkage, press fit."""

    strain: Annotated[Strain6, BeforeValidator(_six)]
    """Tensor components [xx, yy, zz, yz, xz, xy]; a single number is the same in all directions."""
    history: LoadHistory = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""


class Material(OfRegion):
    """Base of the materials of regions.

    Attributes:
        deforms: True if it is elastic.
        moves_rigidly: True if the region moves as a rigid body.
        only_conducts: True if it conducts heat but does not move.
        has_fibre: True if it has a fibre direction.
    """

    deforms: ClassVar[bool] = False
    moves_rigidly: ClassVar[bool] = False
    only_conducts: ClassVar[bool] = False
    has_fibre: ClassVar[bool] = False
    # Keys of `thermal` that need an elastic region and are refused here.
    refused: ClassVar[tuple[str, ...]] = ()
    # The field that gives the stiffness, if one does.
    modulus_field: ClassVar[ModulusField | None] = None
    if TYPE_CHECKING:
        # Fibre direction; None without one.
        fibre: Fibre | None
        # None without creep.
        creep: Creep | None
        eigenstrains: tuple[Eigenstrain, ...]

    material: Text | None = None
    """Material of the library (`mantle explain materials`); other keys change it."""
    tissue: Tissue | None = None
    """Tissue of the region: bone, cement, implant or other; by default that of the geometry, of a
    `file` that of the library's material."""
    thermal: Thermal | None = None
    """Heat conduction. Give it for all regions or for none."""
    status: Status = None
    """Origin of the values: measured, assumed, or unverified if their source was not read."""
    source: Source = None
    """Source of the values. If a file changes a value, status and source are removed."""

    @property
    def moduli(self) -> tuple[float, ...]:
        """Young's moduli, the axial one first [MPa]; none unless it deforms.

        If the stiffness varies in space, these are the largest values. The largest modulus decides
        which side of an interface is stiffer.
        """
        return ()

    @property
    def axial_moduli(self) -> tuple[float, ...]:
        """Axial Young's moduli [MPa]: the values of a table over the height, otherwise the largest.

        None unless it deforms.
        """
        return self.moduli[:1]

    @property
    def nearly_incompressible(self) -> bool:
        """True if linear tetrahedra of this material lock."""
        return False

    @model_validator(mode="after")
    def _deforms(self) -> Self:
        if self.thermal is None:
            return self
        if self.modulus_field and self.thermal.cure:
            fail("a modulus that changes with cure must be a single value", at=("youngs_modulus",))
        for key in self.refused:
            if getattr(self.thermal, key) is not None:
                fail(
                    "a rigid region has no strain; expected an elastic region", at=("thermal", key)
                )
        return self


class Elastic(Material):
    """Base of the elastic materials."""

    deforms: ClassVar[Literal[True]] = True
    moves_rigidly: ClassVar[Literal[False]] = False

    eigenstrains: Annotated[tuple[Eigenstrain, ...], ITEMS] = ()
    """Strains without stress; their sum acts."""
    _geometry: Any = None
    _changing_density: ChangingDensity | None = None

    @property
    def changing_density(self) -> ChangingDensity | None:
        """Density that gives the stiffness, if it changes in a run."""
        return self._changing_density

    def complete(self, geometry: Any, changing_density: ChangingDensity | None) -> None:
        """Set what other sections of the case give.

        Args:
            geometry: The geometry, for a field that gives the stiffness.
            changing_density: Density that gives the stiffness, if it changes in a run.
        """
        self._geometry, self._changing_density = geometry, changing_density

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Elastic coefficients of eq. 48 [MPa]: two if isotropic, else five.

        If the stiffness varies in space, these are the largest values.
        """
        raise NotImplementedError

    @property
    def engineering_constants(self) -> tuple[float, ...]:
        """E and ν if isotropic; else E_l, E_t, ν_l, ν_t and μ_l."""
        raise NotImplementedError

    @property
    def varies(self) -> bool:
        """True if the stiffness varies in space."""
        return self._changing_density is not None

    def relative_stiffness(self, x: Floats) -> Floats:
        """Stiffness at points (n, 3) [mm] over the stiffness of `coefficients` (n,) [-]."""
        return np.ones(len(x))

    def energy(self, ε: Expr, coefficients: Sequence[Expr], fibre: Expr | None) -> Expr:
        """Strain energy density ψ(ε) [MPa], in UFL.

        Args:
            ε: Elastic strain (3, 3).
            coefficients: Elastic coefficients of eq. 48 [MPa].
            fibre: Unit fibre direction (3,); None if isotropic.
        """
        from forms import elasticity

        if self.fibre is None:
            return elasticity.isotropic_energy(ε, *coefficients)
        return elasticity.transversely_isotropic_energy(ε, fibre, *coefficients)


class Isotropic(Elastic):
    """Isotropic linear elasticity."""

    fibre: ClassVar[None] = None  # type: ignore[misc]

    kind: Literal["isotropic"] = "isotropic"
    youngs_modulus: YoungsModulus
    """Young's modulus E; pairs of height z and E, linear in between and constant beyond; or an
    image of computed tomography whose density gives E."""
    poisson_ratio: Annotated[float, Plain(above=-1.0, below=0.5)]
    """Poisson's ratio nu."""
    creep: Creep | None = None
    """Creep in the stages with `creep_cycles` or `creep_time`; elastic in the others."""

    @model_validator(mode="after")
    def _creeps(self) -> Self:
        if self.creep and self.varies:
            fail(
                "the modulus of a region that creeps must be a single value", at=("youngs_modulus",)
            )
        if self.creep and self.eigenstrains:
            fail("a region that creeps cannot have it; leave one out", at=("eigenstrains",))
        return self

    @property
    def nearly_incompressible(self) -> bool:
        """True if linear tetrahedra of this material lock."""
        return self.poisson_ratio > LOCKING_RATIO

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Two elastic coefficients [MPa]."""
        from forms import elasticity

        return elasticity.isotropic_coefficients(self.moduli[0], self.poisson_ratio)

    @property
    def engineering_constants(self) -> tuple[float, ...]:
        """Young's modulus [MPa] and Poisson's ratio."""
        return self.moduli[0], self.poisson_ratio

    @property
    def moduli(self) -> tuple[float, ...]:
        """Young's modulus [MPa]."""
        E = self.youngs_modulus
        if isinstance(E, tuple):
            return (max(value for _, value in E),)
        return (E.largest if isinstance(E, ModulusField) else E,)

    @property
    def axial_moduli(self) -> tuple[float, ...]:
        """The values of the key `youngs_modulus` if it is a table, otherwise the largest [MPa]."""
        E = self.youngs_modulus
        return tuple(value for _, value in E) if isinstance(E, tuple) else self.moduli

    @property
    def modulus_field(self) -> ModulusField | None:  # type: ignore[override]
        """The field that gives Young's modulus, if one does."""
        E = self.youngs_modulus
        return E if isinstance(E, ModulusField) else None

    @property
    def varies(self) -> bool:
        """True if Young's modulus is a table or a field."""
        return not isinstance(self.youngs_modulus, float) or self._changing_density is not None

    def relative_stiffness(self, x: Floats) -> Floats:
        """E(x) over the largest E."""
        if self.modulus_field:
            return np.asarray(self.modulus_field.modulus_at(x, self._geometry) / self.moduli[0])
        if isinstance(self.youngs_modulus, float):
            return super().relative_stiffness(x)
        heights, moduli = np.transpose(np.asarray(self.youngs_modulus))
        return np.asarray(np.interp(x[:, 2], heights, moduli) / self.moduli[0])


class TransverselyIsotropic(Elastic):
    """Transversely isotropic linear elasticity, with one fibre direction."""

    has_fibre: ClassVar[bool] = True
    creep: ClassVar[None] = None  # type: ignore[misc]

    kind: Literal["transversely_isotropic"] = "transversely_isotropic"
    axial_youngs_modulus: Modulus
    """Young's modulus E_l along the fibre."""
    transverse_youngs_modulus: Modulus
    """Young's modulus E_t across the fibre."""
    axial_poisson_ratio: Number
    """Poisson's ratio nu_l = -(transverse strain) / (axial strain) under axial stress."""
    transverse_poisson_ratio: Annotated[float, Plain(above=-1.0, below=1.0)]
    """Poisson's ratio nu_t in the transverse plane."""
    axial_shear_modulus: Modulus
    """Shear modulus mu_l between the fibre and the transverse plane."""
    fibre: FibreDirection = Field((0.0, 0.0, 1.0), validate_default=True)  # type: ignore[assignment]
    """Fibre direction, a vector of any length except zero; or directions around or away from an
    axis."""

    @model_validator(mode="after")
    def _admissible(self) -> TransverselyIsotropic:
        if self.thermal is not None and self.thermal.fibre is not None:
            fail("the region already has a fibre; leave one out", at=("thermal", "fibre"))
        if self.margin <= 0.0:
            fail(
                "the stiffness is not positive definite; expected 1 - transverse_poisson_ratio - "
                "2 axial_poisson_ratio^2 transverse_youngs_modulus / axial_youngs_modulus > 0 "
                f"(it is {self.margin:.3g})",
                at=("axial_poisson_ratio",),
            )
        return self

    @property
    def margin(self) -> float:
        """Margin 1 - nu_t - 2 nu_l^2 E_t / E_l > 0; at 0 the stiffness is infinite."""
        ratio = self.transverse_youngs_modulus / self.axial_youngs_modulus
        return 1.0 - self.transverse_poisson_ratio - 2.0 * self.axial_poisson_ratio**2 * ratio

    @property
    def nearly_incompressible(self) -> bool:
        """True if linear tetrahedra of this material lock."""
        return self.margin < LOCKING_MARGIN

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Five elastic coefficients [MPa]."""
        from forms import elasticity

        return elasticity.transversely_isotropic_coefficients(*self.engineering_constants)

    @property
    def engineering_constants(self) -> tuple[float, ...]:
        """Young's moduli [MPa], Poisson's ratios and shear modulus [MPa], by the keys."""
        return (
            self.axial_youngs_modulus,
            self.transverse_youngs_modulus,
            self.axial_poisson_ratio,
            self.transverse_poisson_ratio,
            self.axial_shear_modulus,
        )

    @property
    def moduli(self) -> tuple[float, ...]:
        """Young's moduli along and across the fibre [MPa]."""
        return self.axial_youngs_modulus, self.transverse_youngs_modulus


def _true(value: object) -> object:
    if value is not True:
        fail(f"{show(value)} is not true; leave `rigid` out of an elastic region")
    return value


class Rigid(Material):
    """Rigid region: it moves as one body."""

    deforms: ClassVar[Literal[False]] = False
    moves_rigidly: ClassVar[Literal[True]] = True
    refused: ClassVar[tuple[str, ...]] = ("thermal_expansion", "cure")
    fibre: ClassVar[None] = None  # type: ignore[misc]
    creep: ClassVar[None] = None  # type: ignore[misc]
    eigenstrains: ClassVar[tuple[Eigenstrain, ...]] = ()  # type: ignore[misc]

    rigid: Annotated[Literal[True], BeforeValidator(_true)]
    """Marks the region as rigid; must be true."""


class Conductor(Material):
    """Conductor of heat without deformation. Either all regions are conductors or none."""

    deforms: ClassVar[Literal[False]] = False
    moves_rigidly: ClassVar[Literal[False]] = False
    only_conducts: ClassVar[bool] = True
    refused: ClassVar[tuple[str, ...]] = ("thermal_expansion",)
    fibre: ClassVar[None] = None  # type: ignore[misc]
    creep: ClassVar[None] = None  # type: ignore[misc]
    eigenstrains: ClassVar[tuple[Eigenstrain, ...]] = ()  # type: ignore[misc]

    kind: Literal["conductor"] = "conductor"
    thermal: Thermal
    """Conduction of heat."""


Region = Annotated[
    Isotropic | TransverselyIsotropic | Rigid | Conductor, Kinds(default="isotropic")
]
