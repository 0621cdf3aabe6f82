"""From the configuration to the scene: the only place that chooses what is solved.

One ``match`` per choice, each arm returning a tuple of terms; what a case does not contain is an
empty tuple.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from app import config
from app.errors import InputError
from app.terms import (
    BodyForce,
    Contact,
    Eigenstrain,
    Elastic,
    Field,
    Force,
    Foundation,
    Load,
    Pressure,
    RigidBody,
    Scene,
    Stage,
    Support,
)
from forms.elasticity import isotropic_coefficients, transversely_isotropic_coefficients

Floats = NDArray[np.float64]


def build(case: config.Case) -> Scene:
    """Choose the terms of a case."""
    stages = len(case.stages)
    regions = [_region(name, r, stages) for name, r in case.regions.items()]
    elastic = tuple(e for e in regions if isinstance(e, Elastic))
    moduli = {e.region: e.modulus for e in elastic}
    return Scene(
        order=case.mesh.order,
        elastic=elastic,
        rigid=tuple(e for e in regions if isinstance(e, RigidBody)),
        foundations=tuple(f for s in case.supports.values() for f in _foundation(s)),
        supports=tuple(f for name, s in case.supports.items() for f in _support(name, s, stages)),
        loads=tuple(_load(name, load, moduli, stages) for name, load in case.loads.items()),
        contacts=tuple(
            term
            for name, law in case.interfaces.items()
            for term in _contact(name, law, case.geometry.interface_sides[name], moduli, stages)
        ),
        stages=tuple(Stage(s.name, s.increments, s.adaptive, s.max_cut_backs) for s in case.stages),
    )


def _history(values: tuple[float, ...] | None, stages: int) -> tuple[float, ...]:
    return values if values is not None else (1.0,) * stages


def _region(name: str, region: config.Region, stages: int) -> Elastic | RigidBody:
    match region:
        case config.Rigid():
            return RigidBody(name)
        case config.Isotropic():
            return Elastic(
                name,
                isotropic_coefficients(region.youngs_modulus, region.poisson_ratio),
                (),
                region.youngs_modulus,
                _eigenstrains(region.eigenstrains, stages),
            )
        case config.TransverselyIsotropic():
            return Elastic(
                name,
                transversely_isotropic_coefficients(
                    region.axial_youngs_modulus,
                    region.transverse_youngs_modulus,
                    region.axial_poisson_ratio,
                    region.transverse_poisson_ratio,
                    region.axial_shear_modulus,
                ),
                tuple(region.fibre),
                max(region.axial_youngs_modulus, region.transverse_youngs_modulus),
                _eigenstrains(region.eigenstrains, stages),
            )


def _eigenstrains(strains: tuple[config.Eigenstrain, ...], stages: int) -> tuple[Eigenstrain, ...]:
    return tuple(Eigenstrain(s.strain, _history(s.history, stages)) for s in strains)


def _foundation(support: config.Support) -> tuple[Foundation, ...]:
    match support:
        case config.Foundation():
            return (Foundation(support.boundary, support.stiffness),)
        case _:
            return ()


def _support(name: str, support: config.Support, stages: int) -> tuple[Support, ...]:
    match support:
        case config.Fixed():
            given: tuple[float | str | None, ...] = (0.0, 0.0, 0.0)
            history = None
        case config.Roller():
            given = tuple(0.0 if axis == support.axis else None for axis in "xyz")
            history = None
        case config.Displacement():
            given, history = (support.x, support.y, support.z), support.history
        case _:
            return ()
    x, y, z = (value is not None for value in given)
    values = _vector(f"supports.{name}", dict(zip("xyz", given, strict=True)))
    return (Support(name, support.boundary, (x, y, z), values, _history(history, stages)),)


def _load(name: str, load: config.Load, moduli: Mapping[str, float], stages: int) -> Load:
    history = _history(load.history, stages)
    match load:
        case config.Force():
            return Force(name, load.boundary, load.force, tuple(load.at or ()), history)
        case config.Pressure():
            return Pressure(name, load.boundary, load.pressure, history)
        case config.BodyForce():
            regions = tuple(moduli) if load.regions is None else tuple(load.regions)
            density = {f"density[{i}]": value for i, value in enumerate(load.density)}
            return BodyForce(name, regions, _vector(f"loads.{name}", density), history)


def _contact(
    name: str,
    law: config.Interface,
    sides: tuple[tuple[str, ...], tuple[str, ...]],
    moduli: Mapping[str, float],
    stages: int,
) -> tuple[Contact, ...]:
    """A contact term; a bonded interface is none at all."""
    match law:
        case config.Bonded():
            return ()
        case config.Contact():
            augmented, stiffness = True, law.augmentation or 0.0
        case config.Penalty():
            augmented, stiffness = False, law.penalty
    # The softer side carries the jump; a rigid side is stiffer than any.
    stiff = [max(moduli.get(r, np.inf) for r in side) for side in sides]
    master, slave = sides if stiff[0] >= stiff[1] else sides[::-1]
    return (
        Contact(
            name=name,
            master=tuple(master),
            slave=tuple(slave),
            frictional=law.friction_coefficient > 0,
            friction=law.friction_coefficient,
            augmented=augmented,
            stiffness=stiffness,
            modulus=min(stiff),
            gap=_field(f"interfaces.{name}.gap", law.gap),
            history=_history(law.gap_history, stages),
        ),
    )


def _field(key: str, value: float | str) -> Field:
    """A value or an expression as a function of points (n, 3): shape (n,)."""

    def at(x: Floats) -> Floats:
        if not isinstance(value, str):
            return np.full(len(x), value)
        try:
            return config.evaluate(value, x)
        except InputError as error:
            raise InputError(f"{key}: {error}") from error

    return at


def _vector(key: str, components: Mapping[str, float | str | None]) -> Field:
    """Three of them as one: shape (n, 3), zero where there is none."""
    fields = [_field(f"{key}.{name}", value or 0.0) for name, value in components.items()]
    return lambda x: np.stack([field(x) for field in fields], axis=1)
