"""From the configuration to the scene: the only place that chooses what is solved.

One ``match`` per choice, each arm returning a tuple of terms; what a case does not contain is an
empty tuple.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from app import config
from app.terms import (
    BodyForce,
    Contact,
    Eigenstrain,
    Elastic,
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
    zero, always = (0.0, 0.0, 0.0), (1.0,) * stages
    match support:
        case config.Fixed():
            return (Support(name, support.boundary, (True, True, True), zero, always),)
        case config.Roller():
            held = (support.axis == "x", support.axis == "y", support.axis == "z")
            return (Support(name, support.boundary, held, zero, always),)
        case config.Displacement():
            x, y, z = support.x, support.y, support.z
            return (
                Support(
                    name,
                    support.boundary,
                    (x is not None, y is not None, z is not None),
                    (x or 0.0, y or 0.0, z or 0.0),
                    _history(support.history, stages),
                ),
            )
        case _:
            return ()


def _load(name: str, load: config.Load, moduli: Mapping[str, float], stages: int) -> Load:
    history = _history(load.history, stages)
    match load:
        case config.Force():
            return Force(name, load.boundary, load.force, tuple(load.at or ()), history)
        case config.Pressure():
            return Pressure(name, load.boundary, load.pressure, history)
        case config.BodyForce():
            regions = tuple(moduli) if load.regions is None else tuple(load.regions)
            return BodyForce(name, regions, load.density, history)


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
    gap = law.gap
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
            gap=lambda x: _gap(gap, x),
            history=_history(law.gap_history, stages),
        ),
    )


def _gap(gap: float | str, x: Floats) -> Floats:
    if isinstance(gap, str):
        return np.asarray(config.evaluate(gap, x))
    return np.full(len(x), gap)
