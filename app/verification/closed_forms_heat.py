r"""Closed forms of heat, cure and heated elastic bodies, each with its source.

Nothing here comes from the code under test. Units as everywhere:

* conductivity N/(s K) (= W/(m K)),
* capacity per volume N/(mm2 K) (= 1e6 J/(m3 K)),
* conductance N/(mm s K) (= 1e3 W/(m2 K)), heat flux N/(mm s) (= 1e3 W/m2),
* temperatures in degC where only differences count, else in K.

A conductor is passed as a pair (conductivity, capacity), an elastic material as (E, ν).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import erfc, erfcx, j0, j1, jn_zeros

from app.foundation.arrays import Floats
from app.verification.closed_forms import Elastic, Layers, lame

Conductor = tuple[float, float]

GAS = 8.314462618  # J/(mol K)


# Steady conduction


def two_bars(
    hot: float, cold: float, resistances: tuple[float, float], conductance: float
) -> tuple[float, float, float]:
    """Two bars in series between walls of given temperature, with a conductance between them.

    ``resistances`` are length over conductivity of each bar [mm s K/N].

    Returns:
        Heat flux, temperatures of the first and of the second side of the interface.
    """
    first_resistance, second_resistance = resistances
    q = (hot - cold) / (first_resistance + 1 / conductance + second_resistance)
    return q, hot - q * first_resistance, cold + q * second_resistance


def two_rings(
    hot: float,
    cold: float,
    radii: tuple[float, float, float],
    conductivities: tuple[float, float],
    conductance: float,
) -> tuple[float, float, float]:
    """Heat flow per length [N/s] and interface temperatures of two rings, as `two_bars`."""
    a, b, c = radii
    first_resistance = math.log(b / a) / (2 * math.pi * conductivities[0])
    second = math.log(c / b) / (2 * math.pi * conductivities[1])
    return two_bars(hot, cold, (first_resistance, second), 2 * math.pi * b * conductance)


@dataclass(frozen=True)
class Slab:
    """A perfused slab 0 < x < L, heated by a flux q at 0, cooled at its other side.

    k T'' - w (T - T_b) + s = 0 (Pennes, J. Appl. Physiol. 1, 1948), -k T'(0) = q,
    -k T'(L) = h (T(L) - T_a), with L in mm, w in N/(mm2 s K) and the source s in N/(mm2 s).
    """

    L: float
    k: float
    w: float
    T_b: float
    s: float
    q: float
    h: float
    T_a: float

    def temperature(self, x: Floats) -> Floats:
        """Temperature (n,) at x (n,)."""
        k = self.k
        h = self.h
        L = self.L
        m = math.sqrt(self.w / k)
        far_temperature = self.T_b + self.s / self.w
        # T = far_temperature + A exp(m (x - L)) + B exp(-m x)
        e = math.exp(-m * L)
        rows = [[-k * m * e, k * m], [k * m + h, (h - k * m) * e]]
        A, B = np.linalg.solve(rows, [self.q, h * (self.T_a - far_temperature)])
        return np.asarray(far_temperature + A * np.exp(m * (x - L)) + B * np.exp(-m * x))


# Transient conduction


def cooling_cylinder(
    r: Floats, t: float, radius: float, material: Conductor, start: float, wall: float
) -> Floats:
    """Temperature (n,) at radii (n,) of a cylinder whose surface is cooled at once to ``wall``.

    Carslaw & Jaeger, Conduction of Heat in Solids, section 7.6: 60 terms of Bessel's series.
    """
    k, c = material
    λ = jn_zeros(0, 60)
    decay = np.exp(-(λ**2) * k / c * t / radius**2)
    modes = j0(np.multiply.outer(r / radius, λ))
    return np.asarray(wall + 2 * (start - wall) * modes @ (decay / (λ * j1(λ))))


def effusivity(material: Conductor) -> float:
    """Square root of conductivity times capacity [N/(mm s^1/2 K)]."""
    return math.sqrt(material[0] * material[1])


@dataclass(frozen=True)
class HalfSpaces:
    """Two half-spaces of given temperatures in contact: x < 0 the first, x > 0 the second.

    Carslaw & Jaeger, section 2.15; with a conductance h, infinite if perfect, by Laplace's
    transform: the heat flux is h ΔT exp(H² t) erfc(H √t) with H = h (1/e₁ + 1/e₂).
    """

    first: Conductor
    second: Conductor
    temperatures: tuple[float, float]
    conductance: float = math.inf

    @property
    def contact(self) -> float:
        """Temperature of the interface if contact is perfect."""
        e = effusivity(self.first)
        f = effusivity(self.second)
        return (e * self.temperatures[0] + f * self.temperatures[1]) / (e + f)

    def temperature(self, x: Floats, t: float, in_first: bool) -> Floats:
        """Temperature (n,) at positions (n,) in one body at a time t > 0."""
        e = effusivity(self.first)
        f = effusivity(self.second)
        start = self.temperatures[0 if in_first else 1]
        k, c = self.first if in_first else self.second
        ξ = np.abs(x) / (2 * math.sqrt(k / c * t))
        drop = erfcx(ξ)
        if math.isfinite(self.conductance):
            H = self.conductance * (1 / e + 1 / f)
            drop = drop - erfcx(ξ + H * math.sqrt(t))
        return np.asarray(start + (self.contact - start) * drop * np.exp(-(ξ**2)))


def heated_half_space(x: Floats, t: float, flux: float, material: Conductor) -> Floats:
    """Rise (n,) of the temperature at depths (n,) under a constant flux (Carslaw & Jaeger, 2.9)."""
    k, c = material
    ξ = np.abs(x) / (2 * math.sqrt(k / c * t))
    ierfc = np.exp(-(ξ**2)) / math.sqrt(math.pi) - ξ * erfc(ξ)
    return np.asarray(2 * flux * math.sqrt(t) / effusivity(material) * ierfc)


# Cure


@dataclass(frozen=True)
class ExactKinetics:
    """Rate of cure k0 exp(-Ea/RT) a^m (1 - a)^n [1/s]; Ea in J/mol, T in K."""

    rate_constant: float
    activation_energy: float
    m: float
    n: float

    def rate(self, a: float, T: float) -> float:
        """Rate [1/s]."""
        k = self.rate_constant * math.exp(-self.activation_energy / (GAS * T))
        return float(k * a**self.m * (1 - a) ** self.n)

    def time(self, a: float, T: float, initial: float, rise: float) -> float:
        """Time to the degree a [s], warming by ``rise`` [K] per degree of cure (0 if isothermal).

        The temperature depends on the degree alone: the time is an integral over ln a.
        """

        def slowness(z: float) -> float:
            s = math.exp(z)
            return s / self.rate(s, T + rise * (s - initial))

        return float(quad(slowness, math.log(initial), math.log(a), epsrel=1e-12, limit=500)[0])

    def degree(self, t: float, T: float, initial: float, rise: float) -> float:
        """Degree of cure at a time, by inversion of `time`."""

        def late(a: float) -> float:
            return self.time(a, T, initial, rise) - t

        return float(brentq(late, initial, 1 - 1e-9, xtol=1e-13, rtol=1e-13))


# Heated elastic bodies


def hot_fit_pressure(
    radii: tuple[float, float],
    core: tuple[Elastic, float],
    ring: tuple[Elastic, float],
    conductivity: float,
    conductance: float,
    temperatures: tuple[float, float, float],
) -> float:
    """Pressure of a core at one temperature in a ring cooled from outside, plane strain [MPa].

    The bore of a free ring grows by (1 + ν) a b times its mean change of temperature (Timoshenko &
    Goodier, section 151). The core grows by the same formula with its material. Both are `Layers`
    of even strain.

    Args:
        radii: b of the interface, c of the outer surface [mm].
        core: Elastic material and coefficient of expansion [1/K].
        ring: The same.
        conductivity: Of the ring.
        conductance: Of the interface.
        temperatures: Of the core, of the outer surface, and without strain.
    """
    (b, c), (hot, cold, stress_free) = radii, temperatures
    wall = math.log(c / b) * b / conductivity
    inner = cold + (hot - cold) * wall / (wall + 1 / conductance)
    # The mean over the section of T = cold + (inner - cold) ln(c/r) / ln(c/b).
    part = 1 / (2 * math.log(c / b)) - b * b / (c * c - b * b)
    mean = cold + (inner - cold) * part
    strains = (core[1] * (hot - stress_free), ring[1] * (mean - stress_free))
    return float(-Layers(radii, (core[0], ring[0]), strains, (True,)).state_at(0, b)[1])


# Conductance that depends on pressure


@dataclass(frozen=True)
class Wall:
    """One state of `HeatedWalls`: pressure [MPa], heat flux, temperatures of the two sides."""

    pressure: float
    flux: float
    first: float
    second: float


@dataclass(frozen=True)
class HeatedWalls:
    """Two bars between fixed walls, pressed together by their expansion; ν = 0.

    The conductance between them is h₀ + h₁ p, h₁ in N/(mm s K) per MPa. More pressure lets more
    heat pass, which cools the hot bar and warms the cold one. If the cold bar expands more, several
    states are possible, one of them open (Barber, Dundurs & Comninou, J. Appl. Mech. 47, 1980).

    Attributes:
        lengths: Lengths of the bars [mm]; the hot wall holds the first one.
        moduli: Young's moduli of the bars [MPa].
        expansions: Coefficients of expansion of the bars [1/K].
        conductivities: Conductivities of the bars.
        h0: Conductance without pressure.
        h1: Increase of the conductance with pressure.
        gap: Gap without strain [mm].
        temperatures: Of the hot wall, of the cold wall, and without strain.
    """

    lengths: tuple[float, float]
    moduli: tuple[float, float]
    expansions: tuple[float, float]
    conductivities: tuple[float, float]
    h0: float
    h1: float
    gap: float
    temperatures: tuple[float, float, float]

    def state(self, p: float) -> Wall:
        """The thermal state under a pressure."""
        hot, cold, _ = self.temperatures
        resistances = tuple(L / k for L, k in zip(self.lengths, self.conductivities, strict=True))
        h = self.h0 + self.h1 * p
        return Wall(p, *two_bars(hot, cold, (resistances[0], resistances[1]), h))

    def excess(self, p: float) -> float:
        """Length of both bars under a pressure, without walls, minus the walls' distance [mm]."""
        hot, cold, stress_free = self.temperatures
        state = self.state(p)
        means = ((hot + state.first) / 2 - stress_free, (cold + state.second) / 2 - stress_free)
        walls = zip(self.lengths, self.moduli, self.expansions, means, strict=True)
        return sum(L * (a * mean - p / E) for L, E, a, mean in walls) - self.gap

    def states(self) -> tuple[Wall, ...]:
        """All states in equilibrium, by pressure; the excess times 1 + R h is quadratic in it."""
        R = sum(L / k for L, k in zip(self.lengths, self.conductivities, strict=True))
        p = np.array([0.0, 1.0, 2.0])
        values = [self.excess(s) * (1 + R * (self.h0 + self.h1 * s)) for s in p]
        roots = np.roots(np.polyfit(p, values, 2))
        closed = sorted(float(s.real) for s in roots if abs(s.imag) < 1e-12 and s.real > 0)
        return tuple(map(self.state, [0.0, *closed] if self.excess(0.0) <= 0 else closed))


# Those of heated_walls.yaml.
WALLS = HeatedWalls(
    lengths=(5, 5),
    moduli=(110e3, 2200),
    expansions=(9e-6, 80e-6),
    conductivities=(6.7, 0.2),
    h0=0.01,
    h1=0.3,
    gap=0.005,
    temperatures=(80, 37, 37),
)


@dataclass(frozen=True)
class WavyContact:
    r"""Two blocks, 0 < z < H and H < z < 2 H, that touch with a pressure that varies along x.

    The pressure is p = p₀ + p₁ cos κx, κ = π / L, and the conductance h₀ + h₁ p. The temperature
    jumps by g everywhere, and the heat flux is q = g (h₀ + h₁ p). The solution is

    .. math:: T = T_i - q (z - H) / k, \quad u = (0, 0, f(x) (z - H)), \quad
              (λ + 2 μ) f = -p + (3 λ + 2 μ) a (T_i - T_{ref}),

    with T_i = T_m + g below and T_m above,

    without shear or motion on z = H, and with sliding only on x = 0 and x = L. The values are those
    of wavy_contact.yaml. Pairs are of the block below and of that above.
    """

    L: float = 2.0  # mm
    H: float = 1.0  # mm
    p: tuple[float, float] = (2.0, 1.0)  # p₀ and p₁ [MPa]
    h: tuple[float, float] = (0.1, 0.1)  # h₀ and h₁
    g: float = 10.0  # K
    T_m: float = 50.0
    T_ref: float = 37.0
    conductivities: tuple[float, float] = (0.2, 0.58)
    materials: tuple[Elastic, Elastic] = ((2200.0, 0.3), (17e3, 0.3))
    expansions: tuple[float, float] = (80e-6, 27.5e-6)  # 1/K

    def pressures(self, x: Floats) -> Floats:
        """Pressure (n,) at points (n, 3)."""
        return np.asarray(self.p[0] + self.p[1] * np.cos(math.pi * x[:, 0] / self.L))

    def temperature(self, x: Floats, upper: bool) -> Floats:
        """Temperature (n,) at points (n, 3) of one block."""
        q = self.g * (self.h[0] + self.h[1] * self.pressures(x))
        base = self.T_m + (0.0 if upper else self.g)
        return np.asarray(base - q * (x[:, 2] - self.H) / self.conductivities[upper])

    def displacement(self, x: Floats, upper: bool) -> Floats:
        """Displacement (n, 3) at points (n, 3) of one block [mm]."""
        λ, μ = lame(self.materials[upper])
        T = self.T_m + (0.0 if upper else self.g) - self.T_ref
        f = (-self.pressures(x) + (3 * λ + 2 * μ) * self.expansions[upper] * T) / (λ + 2 * μ)
        u = np.zeros_like(x)
        u[:, 2] = f * (x[:, 2] - self.H)
        return u
