"""Conduction of bodies and across interfaces, against closed forms and balances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from types import SimpleNamespace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

from app.campaigns.work_precision import fitted_order
from app.case.run_options import TimeOptions
from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.heat.implicit_step import ImplicitStep
from app.heat.matrices import REFACTOR_APPLICATIONS, KeptFactors
from app.heat.operators import HeatOperators
from app.laws.heat_conditions import FixedTemperature, HeatCondition
from app.laws.thermal import Thermal
from app.numerics.integrator import METHODS
from app.numerics.newton import Solver
from app.scene.scene import Interface, Scene
from app.stepping.heat_state import HeatState
from app.system.timing import Timing
from meshes import blocks
from meshes.distribute import TaggedMesh, distribute
from tests import support
from tests.cases import laws

ZERO = 273.15
PERFECT = np.inf


@cache
def stack(size: float, *blocks_: tuple[str, float], curved: bool = False) -> TaggedMesh:
    """A stack of blocks, 2 mm wide, from the bottom: names and heights."""
    geometry = SimpleNamespace(
        blocks=[SimpleNamespace(name=n, size=(2.0, 2.0, z)) for n, z in blocks_],
        region_names=[n for n, _ in blocks_],
        interface_sides={f"{a}_{b}": ((a,), (b,)) for (a, _), (b, _) in pairwise(blocks_)},
        tilt=0.0,
    )
    mesh = SimpleNamespace(size=size, far_size_or_default=size, curved=curved)
    return distribute(blocks.build(geometry, mesh), MPI.COMM_SELF)


CEMENT_ON_BONE = (("cement", 5.0), ("bone", 5.0))


def scene(
    conductors: Sequence[Thermal],
    heat: Sequence[HeatCondition] = (),
    contacts: Sequence[Interface] = (),
) -> Scene:
    """A scene without mechanics."""
    none = ((),) * 7
    given = {"conductors": tuple(conductors), "heat": tuple(heat)}
    return Scene(1, *none, **given, thermal_contacts=tuple(contacts), time=TimeOptions())


def conductor(region: str, k: float, initial: float = 37.0, capacity: float = 2.0) -> Thermal:
    return laws.conductor(region, (k,), None, capacity, ZERO + initial)


CEMENT = conductor("cement", 0.2, 100.0, 1.752)
BONE = conductor("bone", 0.58, 37.0, 2.52)


def fixed(name: str, boundary: str, celsius: float) -> FixedTemperature:
    return laws.temperature(name, ZERO + celsius, boundary=boundary)


def contact(h: float) -> tuple[Interface, ...]:
    """A constant conductance [W/(m2 K)] between the cement, the slave, and the bone."""
    if h == PERFECT:
        return ()
    return (laws.interface("cement_bone", ("bone",), ("cement",), (h * 1e-3, 0.0, np.inf)),)


class Solved(HeatState):
    """A scene with its solver, at its initial state."""

    def __init__(self, terms: Scene, tagged: TaggedMesh, tolerance: float = 1e-11) -> None:
        heat = ImplicitStep(HeatOperators(terms, tagged, Timing()))
        super().__init__(terms, heat, Solver(heat, tolerance, 30, "direct", {}, Timing()), None)

    @property
    def x(self) -> list[PETSc.Vec]:
        return self.solver.blocks()

    @property
    def flows(self) -> dict[str, float]:
        """Heat that enters at the end of the last solve."""
        return self._flows_of_implicit_stages[-1]

    def steady(self) -> Solved:
        """Solve for the steady state."""
        assert self.solve_steady() is not None
        return self

    def advance(self, dt: float, method: str = "sdirk4") -> float:
        """Make a time step; return the entered heat by the integrator's sum [N mm]."""
        self.method = METHODS[method]
        attempt = self.attempt(dt)
        assert attempt is not None
        return sum(self.accept(*attempt, dt).heats.values())

    @property
    def stored(self) -> float:
        return self.operators.stored(self.x)

    def celsius(self, region: str) -> tuple[Floats, Floats]:
        """Positions (n, 3) and temperatures (n,) of the nodes of a region."""
        operators = self.operators
        nodes = np.flatnonzero(operators.forms.volumes(region) > 0)
        T = operators.nodal(self.x)[operators.bodies.body_of_region[region]][nodes] - ZERO
        return operators.forms.space.tabulate_dof_coordinates()[nodes], T


# Steady states


def test_conduction_of_a_bar_with_convection() -> None:
    """The flux is (T0 - Ta)/(L/k + 1/a), exact on straight cells and on quadratic ones."""
    heat: list[HeatCondition] = [
        fixed("hot", "bottom", 80.0),
        laws.convection("air", "top", 0.025, ZERO + 20.0),
    ]
    for curved in (False, True):
        s = Solved(scene([conductor("bar", 0.4)], heat), stack(1.2, ("bar", 6.0), curved=curved))
        s.steady()
        q = 60.0 / (6.0 / 0.4 + 1 / 0.025)
        x, T = s.celsius("bar")
        assert T == pytest.approx(80 - q * x[:, 2] / 0.4, abs=1e-8)
        assert s.flows == pytest.approx({"hot": 4 * q, "air": -4 * q}, rel=1e-9)


# Given temperatures at interfaces


@pytest.mark.parametrize("h", [300.0, 1e9])
def test_conduction_with_prescribed_region(h: float) -> None:
    """Cement stays at 100 everywhere, so only the conductance is between it and the bone."""
    heat: list[HeatCondition] = [
        laws.temperature("cement", ZERO + 100.0, regions=("cement",)),
        fixed("cold", "top", 37.0),
    ]
    s = Solved(scene([CEMENT, BONE], heat, contact(h)), stack(1.5, *CEMENT_ON_BONE)).steady()
    q = 63.0 / (1e3 / h + 5.0 / 0.58)
    assert s.celsius("cement")[1] == pytest.approx(100.0, abs=1e-10)
    x, T = s.celsius("bone")
    assert T == pytest.approx(37 + q * (10 - x[:, 2]) / 0.58, abs=1e-9)
    assert s.flows == pytest.approx({"cement": 4 * q, "cold": -4 * q}, rel=1e-8)


def test_conduction_jump_where_both_sides_are_prescribed() -> None:
    """If both temperatures are prescribed, the jump is their difference.

    The balance counts its heat.
    """
    heat = [fixed("warm", "cement_x_min", 60.0), fixed("cool", "bone_x_min", 40.0)]
    s = Solved(scene([CEMENT, BONE], heat, contact(300.0)), stack(1.0, *CEMENT_ON_BONE)).steady()
    j = s.operators.jumps
    assert j is not None
    edge = s.operators.forms.space.tabulate_dof_coordinates()[j.dof, 0] < 1e-9
    assert (j.prescribed == edge).all() and edge.any()
    assert s.x[1].array[edge] == pytest.approx(20.0, abs=1e-10)
    for region, given in (("cement", 60.0), ("bone", 40.0)):
        x, T = s.celsius(region)
        assert T[x[:, 0] < 1e-9] == pytest.approx(given, abs=1e-10)
        assert 40.0 < T.mean() < 60.0
    q = s.flows
    assert q["warm"] > 1.0
    assert q["warm"] + q["cool"] == pytest.approx(0.0, abs=1e-10 * q["warm"])
    through = float(j.weight @ j.flux(s.x[1].array)[0])
    assert q["cool"] == pytest.approx(through, rel=1e-9)


def test_conduction_later_of_two_prescribed_temperatures_holds() -> None:
    heat = [fixed("first", "x_min", 60.0), fixed("second", "bottom", 40.0)]
    s = Solved(scene([conductor("bar", 0.4)], heat), stack(1.0, ("bar", 2.0))).steady()
    x, T = s.celsius("bar")
    both = (x[:, 0] < 1e-9) & (x[:, 2] < 1e-9)
    assert T[both] == pytest.approx(40.0)
    assert sum(s.flows.values()) == pytest.approx(0.0, abs=1e-9 * s.flows["first"])


def test_conduction_steady_state_needs_a_prescribed_temperature() -> None:
    cold = [fixed("cold", "top", 37.0)]
    for h, heat in ((0.0, []), (300.0, []), (0.0, cold)):
        s = Solved(scene([CEMENT, BONE], heat, contact(h)), stack(1.5, *CEMENT_ON_BONE))
        with pytest.raises(InputError, match="nothing sets the temperature of 'cement'"):
            s.steady()
    s = Solved(scene([CEMENT, BONE], cold, contact(300.0)), stack(1.5, *CEMENT_ON_BONE)).steady()
    assert s.celsius("cement")[1] == pytest.approx(37.0, abs=1e-8)


# Transients


@pytest.mark.parametrize("h", [0.0, 300.0, 1e9, PERFECT])
@pytest.mark.parametrize("dt", [1e-3, 1.0, 3600.0])
def test_conduction_between_bodies_conserves_heat(h: float, dt: float) -> None:
    """Without exchange the heat at the start, by volumes, stays constant."""
    s = Solved(scene([CEMENT, BONE], (), contact(h)), stack(1.5, *CEMENT_ON_BONE), 1e-10)
    reference = (100.0 + 37.0) / 2
    start = 20 * (1.752 * (100.0 - reference) + 2.52 * (37.0 - reference))
    assert s.stored == pytest.approx(start, rel=1e-11)
    for _ in range(3):
        s.advance(dt)
        assert s.stored == pytest.approx(start, rel=1e-9)
    if h == 0.0:
        assert s.celsius("cement")[1] == pytest.approx(100.0, abs=1e-9)
        assert s.celsius("bone")[1] == pytest.approx(37.0, abs=1e-9)
    elif dt == 3600.0:
        mixed = (1.752 * 100.0 + 2.52 * 37.0) / (1.752 + 2.52)
        assert s.celsius("bone")[1] == pytest.approx(mixed, abs=0.1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("h", [300.0, PERFECT])
def test_conduction_balance_closes_with_all_conditions(h: float, method: str) -> None:
    """Heat from the conditions, by the sums of the integrator, equals the stored heat."""
    time_course = ((0.0, 0.0), (3.0, 1.0), (8.0, 0.2))
    heat: list[HeatCondition] = [
        # Its time course multiplies kelvins.
        laws.temperature(
            "held",
            lambda x: ZERO + 40 + 3 * x[:, 0],
            ((0.0, 1.0), (8.0, 1.02)),
            boundary="bottom",
        ),
        laws.flux("lamp", "x_min", lambda x: 0.4 * x[:, 2], time_course),
        laws.source("ohmic", ("bone",), lambda x: 0.05 * x[:, 1]),
        laws.convection("air", "top", 0.02, ZERO + 20.0),
        laws.perfusion("blood", ("bone",), 0.01, ZERO + 37.0),
    ]
    s = Solved(scene([CEMENT, BONE], heat, contact(h)), stack(1.0, *CEMENT_ON_BONE), 1e-10)
    before, moved = s.stored, 0.0
    for _ in range(5):
        came = s.advance(1.5, method)
        moved += 1.5 * max(abs(f) for flows in s._flows_of_implicit_stages for f in flows.values())
        after = s.stored
        assert after - before == pytest.approx(came, abs=1e-9 * moved)
        before = after
    # The lamp on a side of 2 mm by 10 mm: 0.4 times the first moment of its height.
    m = np.interp(7.5, *np.array(time_course).T)
    assert s.flows["lamp"] == pytest.approx(0.4 * 2 * 50 * m, rel=1e-9)
    assert s.flows["ohmic"] == pytest.approx(0.05 * 2 * 5 * 2, rel=1e-9)
    assert all(abs(f) > 0 for f in s.flows.values())


# Cure and friction


def curing(h: float) -> Scene:
    """Cement that sets next to bone, without other heat."""
    cement = conductor("cement", 0.2, 75.0, 1.752)
    cure = laws.cure("cement", laws.BALIGA, 0.05)
    return replace(scene([cement, BONE], (), contact(h)), cures=(cure,))


@pytest.mark.parametrize("h", [0.0, 300.0, PERFECT])
def test_conduction_heat_of_cure_equals_cured_mass(h: float) -> None:
    s = Solved(curing(h), stack(1.5, *CEMENT_ON_BONE), 1e-10)
    before, α = s.stored, s.state[-1].copy()
    V = s.operators.forms.volumes("cement")
    V = V[V > 0]
    for _ in range(8):
        came = s.advance(2.0)
        released = 155.0 * float(V @ (s.state[-1] - α))
        assert came == pytest.approx(released, rel=1e-9)
        assert s.stored - before == pytest.approx(released, rel=1e-8)
        before, α = s.stored, s.state[-1].copy()
        assert ((α >= 0.05) & (α <= 1)).all()
    assert α.max() > 0.5
    if h == 0.0:
        # Adiabatic, node by node.
        assert s.celsius("cement")[1] == pytest.approx(75 + 155 / 1.752 * (α - 0.05), abs=1e-6)
        assert s.celsius("bone")[1] == pytest.approx(37.0, abs=1e-9)


def test_conduction_jacobian_is_the_derivative() -> None:
    """A Taylor test has conductance that depends on pressure, and cure."""
    rng = np.random.default_rng(1)
    law = laws.interface("cement_bone", ("bone",), ("cement",), (0.05, 0.1, 0.4))
    terms = replace(curing(PERFECT), thermal_contacts=(law,))
    terms = replace(terms, heat=(fixed("cold", "top", 37.0), fixed("side", "x_min", 45.0)))
    operators = HeatOperators(terms, stack(1.5, *CEMENT_ON_BONE), Timing())
    c, j = ImplicitStep(operators), operators.jumps
    assert j is not None
    j.pressure[:] = rng.uniform(-1.0, 6.0, len(j.pressure))
    x, d = c.initial(), c.vectors()
    degrees = c.degrees(x)
    assert c.begin([v.array for v in x], degrees, 0.8, 0.8)
    for v in x:
        v.array[:] += rng.uniform(-5.0, 5.0, v.getLocalSize())
    c.impose(x)
    for v, held in zip(d, (operators.fixed.base_condition >= 0, j.prescribed), strict=True):
        v.array[:] = np.where(held, 0.0, rng.uniform(-1.0, 1.0, v.getLocalSize()))
    c.jacobian(x)
    f0 = c.vectors()
    c.residual(x, f0)
    slope = c.vectors()
    for row, out in zip(c.matrices(), slope, strict=True):
        for A, v in zip(row, d, strict=True):
            A.multAdd(v, out, out)
    remainders = []
    for ε in (1.0, 0.5, 0.25):
        y, f = [v.copy() for v in x], c.vectors()
        for v, w in zip(y, d, strict=True):
            v.axpy(ε, w)
        c.residual(y, f)
        for a, b, s in zip(f, f0, slope, strict=True):
            a.axpy(-1.0, b)
            a.axpy(-ε, s)
        remainders.append(np.sqrt(sum(a.norm() ** 2 for a in f)))
    assert remainders[0] > 1e-6
    assert fitted_order([1.0, 0.5, 0.25], remainders) == pytest.approx(2.0, abs=0.1)
    matrix = c.matrices()
    transposed = matrix[0][1].copy().transpose()
    transposed.axpy(-1.0, matrix[1][0])
    assert transposed.norm() == 0
    for k in (0, 1):
        assert matrix[k][k].isSymmetric(1e-12 * matrix[k][k].norm())


@pytest.mark.parametrize("side", ["bone", "cement"])
def test_conduction_prescribed_temperature_leaves_the_other_side_free(side: str) -> None:
    """The interface has finite conductance, and the temperature acts at the start."""
    s = Solved(
        scene([CEMENT, BONE], [fixed("wall", f"{side}_x_min", 60.0)], contact(300.0)),
        stack(1.5, *CEMENT_ON_BONE),
    )
    for region, initial in (("cement", 100.0), ("bone", 37.0)):
        x, T = s.celsius(region)
        wall = np.isclose(x[:, 0], 0.0) & (region == side)
        assert pytest.approx(np.where(wall, 60.0, initial), abs=1e-9) == T


# Extremes


@cache
def cylinders() -> TaggedMesh:
    text = (support.CONFIGS / "cylinders.yaml").read_text()
    return support.mesh(support.case(text, "mesh.size=2.5 mm", "mesh.far_size=5 mm"), MPI.COMM_SELF)


@pytest.mark.parametrize("dt", [1e-3, 0.05, 1.0, 10.0, 3600.0])
@pytest.mark.parametrize("h", [300.0, PERFECT])
def test_conduction_obeys_the_maximum_principle(h: float, dt: float) -> None:
    """Cement at 100 degC is between stem and bone at 37.

    Bounds hold to 1e-9 of the range, and no heat is lost.
    """
    stem = conductor("stem", 14.8, 37.0, 3.735)
    contacts = () if h == PERFECT else (
        laws.interface("stem_cement", ("stem",), ("cement",), (h * 1e-3, 0.0, np.inf)),
        *contact(h),
    )  # fmt: skip
    terms = scene([stem, CEMENT, BONE], [fixed("outer", "bone_surface", 37.0)], contacts)
    s = Solved(terms, cylinders(), 1e-8)
    before = s.stored
    for _ in range(4):
        came = s.advance(dt)
        for region in ("stem", "cement", "bone"):
            celsius = s.celsius(region)[1]
            assert celsius.min() > 37 - 63e-9 and celsius.max() < 100 + 63e-9
        assert s.stored - before == pytest.approx(came, abs=1e-9 * abs(before))
        before = s.stored
    # On this mesh short steps do leave them unless conduction is corrected.
    assert (s.operators.principle.version > 0) == (dt <= 1.0)


def test_conduction_bounds_follow_the_data() -> None:
    tagged = stack(1.5, *CEMENT_ON_BONE)
    given = fixed("cold", "top", 20.0)
    warm = laws.flux("lamp", "bottom", 0.1, ((0.0, 0.0), (1.0, 1.0)))
    s = Solved(scene([CEMENT, BONE], [given, warm], contact(300.0)), tagged)
    bounds = s.operators.principle
    assert (bounds.low, bounds.high) == pytest.approx((ZERO + 20.0, ZERO + 100.0))
    s.advance(1.0)
    assert bounds.low == pytest.approx(ZERO + 20.0) and bounds.high == np.inf
    drain = warm.named("lamp", flux=-0.1)
    s = Solved(scene([CEMENT, BONE], [given, drain], contact(300.0)), tagged)
    s.advance(1.0)
    bounds = s.operators.principle
    assert bounds.low == -np.inf and bounds.high == pytest.approx(ZERO + 100.0)


# Factors of the matrix: kept while they are good, made again when they are not

BOTH = pytest.mark.parametrize("h", [300.0, PERFECT], ids=["jumps", "one block"])


def heated(h: float) -> tuple[Solved, KeptFactors]:
    cold = [fixed("cold", "top", 20.0)]
    s = Solved(scene([CEMENT, BONE], cold, contact(h)), stack(1.0, *CEMENT_ON_BONE))
    principle = s.operators.principle
    principle.heated = principle.cooled = True  # no bounds, no corrections
    return s, s.solver.snes.getKSP().getPC().getPythonContext()


@BOTH
def test_conduction_equal_steps_share_factors(h: float) -> None:
    s, factors = heated(h)
    s.advance(1.0)
    made = factors.factorizations
    for _ in range(4):
        s.advance(1.0)
    assert factors.factorizations == made
    s.advance(2.0)
    assert factors.factorizations == made + 1


@BOTH
def test_conduction_old_factors_are_reused_while_cheaper(h: float) -> None:
    """Each step is a little longer than the last, but too little for new factors."""
    s, factors = heated(h)
    other, fresh = heated(h)
    made, solves = 0, 0
    for k in range(12):
        dt = 1.0 + 0.005 * k
        s.advance(dt)
        fresh._size = 0.0  # any change is large
        other.advance(dt)
        assert np.concatenate(s.state) == pytest.approx(np.concatenate(other.state), abs=1e-8)
        made, solves = factors.factorizations, solves + 5
    assert 1 < made < fresh.factorizations
    assert made <= 2 + solves // REFACTOR_APPLICATIONS * 2
