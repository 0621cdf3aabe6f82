"""From the configuration to the scene: the only place that chooses what is solved.

One choice per function, which returns a tuple of terms; what a case does not contain is an empty
tuple.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import singledispatch

import numpy as np

from app.case.case import Case
from app.case.run_options import Stage
from app.case.shapes import Sides
from app.laws import loads as sections
from app.laws.interface_laws import Bonded, Contact, InterfaceSection, Penalty
from app.laws.loads import (
    BodyForce,
    Displacement,
    Fixed,
    Force,
    Foundation,
    LoadSection,
    Pressure,
    Roller,
)
from app.laws.materials import Eigenstrain, Isotropic, Region, Rigid, TransverselyIsotropic
from app.scene.build_heat import fibre_of, field, heat
from app.scene.laws import BondTerm, Coulomb, CoulombByPenalty, InterfaceLaw
from app.scene.loads import BodyForceTerm, Field, ForceTerm, LoadTerm, PressureTerm
from app.scene.terms import (
    ContactTerm,
    EigenstrainTerm,
    Elastic,
    FoundationTerm,
    RigidBody,
    Scene,
    SceneStage,
    Support,
)
from forms.elasticity import isotropic_coefficients, transversely_isotropic_coefficients


def build_scene(case: Case) -> Scene:
    """Choose the terms of a case."""
    stages = len(case.stages)
    elastic = tuple(term for name, r in case.regions.items() for term in _elastic(name, r, stages))
    moduli = {e.region: e.modulus for e in elastic}
    sides = {
        name: _stiffer_first(pair, moduli) for name, pair in case.geometry.interface_sides.items()
    }
    return Scene(
        order=case.mesh.order,
        elastic=elastic,
        rigid=tuple(RigidBody(name) for name, r in case.regions.items() if isinstance(r, Rigid)),
        foundations=tuple(f for s in case.supports.values() for f in _foundation(s)),
        supports=tuple(
            term for name, s in case.supports.items() for term in _support(name, s, case.stages)
        ),
        loads=tuple(
            load_of(load, name, tuple(moduli), _history(load.history, stages))
            for name, load in case.loads.items()
        ),
        contacts=tuple(
            term
            for name, law in case.interfaces.items()
            for term in _contact(name, law, case.geometry.interface_sides[name], moduli)
        ),
        bonds=tuple(
            term
            for name, law in case.interfaces.items()
            for term in _bond(name, law, sides[name], moduli)
        ),
        stages=tuple(
            SceneStage(
                s.name, s.increments, s.adaptive, s.max_cut_backs, s.duration or 0.0, s.steady
            )
            for s in case.stages
        ),
        **heat(case, sides),
    )


def _history(values: tuple[float, ...] | None, stages: int) -> tuple[float, ...]:
    return values if values is not None else (1.0,) * stages


def _elastic(name: str, region: Region, stages: int) -> tuple[Elastic, ...]:
    match region:
        case Isotropic():
            return (
                Elastic(
                    name,
                    isotropic_coefficients(region.youngs_modulus, region.poisson_ratio),
                    None,
                    region.youngs_modulus,
                    _eigenstrains(region.eigenstrains, stages),
                ),
            )
        case TransverselyIsotropic():
            return (
                Elastic(
                    name,
                    transversely_isotropic_coefficients(
                        region.axial_youngs_modulus,
                        region.transverse_youngs_modulus,
                        region.axial_poisson_ratio,
                        region.transverse_poisson_ratio,
                        region.axial_shear_modulus,
                    ),
                    fibre_of(region.fibre),
                    max(region.axial_youngs_modulus, region.transverse_youngs_modulus),
                    _eigenstrains(region.eigenstrains, stages),
                ),
            )
        case _:
            return ()


def _eigenstrains(strains: tuple[Eigenstrain, ...], stages: int) -> tuple[EigenstrainTerm, ...]:
    return tuple(EigenstrainTerm(s.strain, _history(s.history, stages)) for s in strains)


def _foundation(support: sections.Support) -> tuple[FoundationTerm, ...]:
    match support:
        case Foundation():
            return (FoundationTerm(support.boundary, support.stiffness),)
        case _:
            return ()


def _support(
    name: str, support: sections.Support, stages: tuple[Stage, ...]
) -> tuple[Support, ...]:
    normal: tuple[float, ...] | str = ()
    match support:
        case Fixed():
            given: tuple[float | str | None, ...] = (0.0, 0.0, 0.0)
            history = None
        case Roller():
            given = tuple(0.0 if axis == support.axis else None for axis in "xyz")
            history, normal = None, support.normal or ()
        case Displacement():
            given, history = (support.x, support.y, support.z), support.history
        case _:
            return ()
    x, y, z = (value is not None for value in given)
    values = _vector(f"supports.{name}", dict(zip("xyz", given, strict=True)))
    held = support.stages
    active = () if held is None else tuple(stage.name in held for stage in stages)
    factors = _history(history, len(stages))
    return (Support(name, support.boundary, (x, y, z), values, factors, active, normal),)


@singledispatch
def load_of(
    section: LoadSection, name: str, regions: Sequence[str], history: tuple[float, ...]
) -> LoadTerm:
    """The load that a section of ``loads`` asks for. One from outside registers here.

    Args:
        section: The section.
        name: Its name.
        regions: All elastic regions.
        history: Amplitudes at the ends of the stages.
    """
    raise NotImplementedError(f"no load is registered for {type(section).__name__}")


@load_of.register
def _(section: Force, name: str, regions: object, history: tuple[float, ...]) -> LoadTerm:
    return ForceTerm(name, section.boundary, section.force, tuple(section.at or ()), history)


@load_of.register
def _(section: Pressure, name: str, regions: object, history: tuple[float, ...]) -> LoadTerm:
    return PressureTerm(name, section.boundary, section.pressure, history)


@load_of.register
def _(
    section: BodyForce, name: str, regions: Sequence[str], history: tuple[float, ...]
) -> LoadTerm:
    chosen = tuple(regions) if section.regions is None else tuple(section.regions)
    density = {f"density[{i}]": value for i, value in enumerate(section.density)}
    return BodyForceTerm(name, chosen, _vector(f"loads.{name}", density), history)


@singledispatch
def law_of(section: InterfaceSection) -> InterfaceLaw | None:
    """The law that a section of ``interfaces`` asks for; None where the sides are one continuum.

    A law from outside registers here what its own section asks for.
    """
    raise NotImplementedError(f"no interface law is registered for {type(section).__name__}")


@law_of.register
def _(section: Bonded) -> None:
    return None


@law_of.register
def _(section: Contact) -> InterfaceLaw:
    return Coulomb(section.friction_coefficient, section.augmentation or 0.0)


@law_of.register
def _(section: Penalty) -> InterfaceLaw:
    return CoulombByPenalty(section.friction_coefficient, section.penalty)


def _contact(
    name: str, section: InterfaceSection, declared: Sides, moduli: Mapping[str, float]
) -> tuple[ContactTerm, ...]:
    """A term between a master and a slave; a bonded interface is none at all."""
    law = law_of(section)
    if law is None:
        return ()
    master, slave = _stiffer_first(declared, moduli)
    gap, history = section.initial_gap
    gap_field = field(f"interfaces.{name}.gap", gap)
    modulus = _stiffness(slave, moduli)
    course, turned = tuple(history or ()), master != tuple(declared[0])
    return (ContactTerm(name, master, slave, law, modulus, gap_field, course, turned),)


def _bond(
    name: str, section: InterfaceSection, sides: Sides, moduli: Mapping[str, float]
) -> tuple[BondTerm, ...]:
    """A bonded interface, unless no side of it deforms."""
    if law_of(section) is not None or not np.isfinite(_stiffness(sides[1], moduli)):
        return ()
    return (BondTerm(name, *sides),)


def _stiffness(side: Sequence[str], moduli: Mapping[str, float]) -> float:
    """Largest modulus on a side of an interface; of a rigid one larger than any."""
    return max(moduli.get(region, np.inf) for region in side)


def _stiffer_first(sides: Sides, moduli: Mapping[str, float]) -> Sides:
    """Master and slave: the softer side carries the jump."""
    a, b = (tuple(side) for side in sides)
    return (a, b) if _stiffness(a, moduli) >= _stiffness(b, moduli) else (b, a)


def _vector(key: str, components: Mapping[str, float | str | None]) -> Field:
    """Three of them as one: shape (n, 3), zero where there is none."""
    fields = [field(f"{key}.{name}", value or 0.0) for name, value in components.items()]
    return lambda x: np.stack([component(x) for component in fields], axis=1)
