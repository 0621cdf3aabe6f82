"""Conduction of bodies and across interfaces, against closed forms."""

from __future__ import annotations

from types import SimpleNamespace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from numpy.typing import NDArray

from app.conduction import Conduction
from app.terms import Conductor, FixedTemperature, HeatCondition, Scene, ThermalContact
from app.timing import Timing
from meshes import blocks
from meshes.distribute import TaggedMesh, distribute

Floats = NDArray[np.float64]
ZERO = 273.15


def stack(size: float, *, tilt: float = 0.0, **heights: float) -> TaggedMesh:
    """A stack of blocks 2 mm wide, from the bottom."""
    geometry = SimpleNamespace(
        blocks=[SimpleNamespace(name=n, size=(2.0, 2.0, z)) for n, z in heights.items()], tilt=tilt
    )
    mesh = SimpleNamespace(size=size, far_size=size, curved=False)
    data = blocks.build(geometry, mesh) if MPI.COMM_WORLD.rank == 0 else None
    return distribute(data, MPI.COMM_WORLD)


def scene(
    conductors: list[Conductor],
    heat: list[HeatCondition],
    contacts: list[ThermalContact] | None = None,
) -> Scene:
    """A scene without mechanics."""
    return Scene(
        1, (), (), (), (), (), (), (),
        conductors=tuple(conductors),
        heat=tuple(heat),
        thermal_contacts=tuple(contacts or []),
    )  # fmt: skip


def conductor(region: str, k: float, initial: float = 37.0, capacity: float = 2.0) -> Conductor:
    return Conductor(region, (k,), (), capacity, ZERO + initial)


def fixed(name: str, boundary: str, celsius: float) -> FixedTemperature:
    return FixedTemperature(name, boundary, (), lambda x: np.full(len(x), ZERO + celsius), ())


def solve(
    conduction: Conduction,
    x: list[PETSc.Vec],
    h: float = np.inf,
    seconds: float = 0.0,
    iterations: int = 4,
) -> list[PETSc.Vec]:
    """One implicit solve by Newton's method with a direct solver."""
    assert conduction.begin([v.array for v in x], [], h, seconds)
    y = [v.copy() for v in x]
    conduction.impose(y)
    ksp = PETSc.KSP().create(conduction.comm)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    for _ in range(iterations):
        f, dx = conduction.vectors(), conduction.vectors()
        conduction.residual(y, f)
        conduction.jacobian(y)
        A = PETSc.Mat().createNest(conduction.matrix, comm=conduction.comm)
        right, left = PETSc.Vec().createNest(f), PETSc.Vec().createNest(dx)
        A.assemble()
        flat = A.convert("aij", PETSc.Mat()) if len(f) > 1 else conduction.matrix[0][0]
        one, two = flat.createVecLeft(), flat.createVecRight()
        one.array[:] = right.array if len(f) == 1 else np.concatenate([v.array for v in f])
        ksp.setOperators(flat)
        ksp.solve(one, two)
        at = 0
        for v, w in zip(y, left.getNestSubVecs(), strict=True):
            n = v.getLocalSize()
            w.array[:] = two.array[at : at + n]
            at += n
            v.axpy(-1.0, w)
    return y


@pytest.mark.parametrize("h", [0.2, 30.0, 300.0, 1e6, 1e9, 1e12])
def test_two_bars_with_resistance(h: float) -> None:
    """physics.md 5.8: q = (T1 - T2)/(L1/k1 + 1/h + L2/k2)."""
    tagged = stack(1.5, cement=5.0, bone=5.0)
    contact = ThermalContact("cement_bone", ("bone",), ("cement",), h * 1e-3, 0.0, np.inf)
    conduction = Conduction(
        scene(
            [conductor("cement", 0.2), conductor("bone", 0.58)],
            [fixed("hot", "bottom", 100.0), fixed("cold", "top", 37.0)],
            [contact],
        ),
        tagged,
        Timing(),
    )
    x = solve(conduction, conduction.initial())
    q = 63.0 / (5.0 / 0.2 + 1e3 / h + 5.0 / 0.58)
    T = conduction.nodal(x)
    b = conduction.bodies.of_region
    j = conduction.jumps[0]
    assert T[b["cement"]][j.dof] - ZERO == pytest.approx(100 - q * 25, abs=1e-9)
    assert T[b["bone"]][j.dof] - ZERO == pytest.approx(37 + q * 5 / 0.58, abs=1e-9)
    flux = j.flux(x[1].array)[0]
    assert flux == pytest.approx(-q, rel=1e-9)
    flows = conduction.flows(x)
    assert flows["hot"] == pytest.approx(4 * q, rel=1e-9)
    assert flows["cold"] == pytest.approx(-4 * q, rel=1e-9)
    if h == 300:
        assert q == pytest.approx(1.704821, abs=1e-6)
