r"""Exact solutions of the verification problems of heat and cure: closed forms with sources.

Nothing here comes from the code under test. Units as everywhere: conductivity N/(s K) (= W/(m K)),
capacity per volume N/(mm2 K) (= 1e6 J/(m3 K)), conductance N/(mm s K) (= 1e3 W/(m2 K)), heat flux
N/(mm s) (= 1e3 W/m2); temperatures in degC where only differences count, else in K. A conductor is
passed as a pair (conductivity, capacity), an elastic material as (E, ν).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import erfc, erfcx, j0, j1, jn_zeros

from app.foundation.arrays import Floats

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
    first, second = resistances
    q = (hot - cold) / (first + 1 / conductance + second)
    return q, hot - q * first, cold + q * second


def two_rings(
    hot: float,
    cold: float,
    radii: tuple[float, float, float],
    conductivities: tuple[float, float],
    conductance: float,
) -> tuple[float, float, float]:
    """Heat flow per length [N/s] and interface temperatures of two rings, as `two_bars`."""
    a, b, c = radii
    first = math.log(b / a) / (2 * math.pi * conductivities[0])
    second = math.log(c / b) / (2 * math.pi * conductivities[1])
    return two_bars(hot, cold, (first, second), 2 * math.pi * b * conductance)


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
        k, h, L = self.k, self.h, self.L
        m = math.sqrt(self.w / k)
        far = self.T_b + self.s / self.w
        # T = far + A exp(m (x - L)) + B exp(-m x)
        e = math.exp(-m * L)
        rows = [[-k * m * e, k * m], [k * m + h, (h - k * m) * e]]
        A, B = np.linalg.solve(rows, [self.q, h * (self.T_a - far)])
        return np.asarray(far + A * np.exp(m * (x - L)) + B * np.exp(-m * x))


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
        e, f = effusivity(self.first), effusivity(self.second)
        return (e * self.temperatures[0] + f * self.temperatures[1]) / (e + f)

    def temperature(self, x: Floats, t: float, in_first: bool) -> Floats:
        """Temperature (n,) at positions (n,) in one body at a time t > 0."""
        e, f = effusivity(self.first), effusivity(self.second)
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
