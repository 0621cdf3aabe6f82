r"""Exact solutions of the verification problems of heated elastic bodies: closed forms.

Nothing here comes from the code under test. Units and pairs as in `closed_forms_heat`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Floats
from app.verification.closed_forms import Elastic, lame
from app.verification.closed_forms_heat import two_bars


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
    Goodier, section 151), the core by the same with its own: both are `Layers` of even strain.

    Args:
        radii: b of the interface, c of the outer surface [mm].
        core: Elastic material and coefficient of expansion [1/K].
        ring: The same.
        conductivity: Of the ring.
        conductance: Of the interface.
        temperatures: Of the core, of the outer surface, and without strain.
    """
    (b, c), (hot, cold, free) = radii, temperatures
    wall = math.log(c / b) * b / conductivity
    inner = cold + (hot - cold) * wall / (wall + 1 / conductance)
    # The mean over the section of T = cold + (inner - cold) ln(c/r) / ln(c/b).
    part = 1 / (2 * math.log(c / b)) - b * b / (c * c - b * b)
    mean = cold + (inner - cold) * part
    strains = (core[1] * (hot - free), ring[1] * (mean - free))
    return float(-Layers(radii, (core[0], ring[0]), strains, (True,)).at(0, b)[1])


@dataclass(frozen=True)
class Layers:
    """A core and concentric rings around it without load, in plane strain.

    In each u_r = A r + B / r, with B = 0 in the core (Timoshenko & Goodier, section 28). A core too
    large by δ is one of the free strain δ / (1 + ν) r. From inside to outside: radii of the outer
    surfaces [mm], materials, and free strains, the same in all directions; for each pair of
    neighbours whether they are joined, else there is no traction between them.
    """

    radii: Sequence[float]
    materials: Sequence[Elastic]
    free_strains: Sequence[float]
    joined: Sequence[bool]

    def at(self, i: int, r: float) -> Floats:
        """Displacement [mm], radial and hoop stress [MPa] of layer i at r (3,)."""
        terms, free = self._terms(i, r)
        return np.asarray(terms @ self._constants()[i] - free)

    def gap(self, i: int) -> float:
        """Gap between layers i and i + 1 [mm]."""
        r = self.radii[i]
        return float(self.at(i + 1, r)[0] - self.at(i, r)[0])

    def _terms(self, i: int, r: float) -> tuple[Floats, Floats]:
        """Coefficients of A and B in `at` (3, 2), and what the free strain takes off (3,)."""
        λ, μ = lame(self.materials[i])
        b = 1 / r**2 if i else 0.0
        terms = [[r, b * r], [2 * (λ + μ), -2 * μ * b], [2 * (λ + μ), 2 * μ * b]]
        return np.array(terms), (3 * λ + 2 * μ) * self.free_strains[i] * np.array([0, 1, 1])

    def _constants(self) -> Floats:
        """A and B of each layer (n, 2)."""
        n = len(self.radii)
        M, f = np.zeros((2 * n, n, 2)), np.zeros(2 * n)
        M[0, 0, 1] = 1.0
        for i, r in enumerate(self.radii):
            row = 2 * i + 1
            own, free = self._terms(i, r)
            M[row, i], f[row] = own[1], free[1]
            if i + 1 == n:
                continue
            other, its = self._terms(i + 1, r)
            if self.joined[i]:
                M[row, i + 1] = -other[1]
                f[row] -= its[1]
                M[row + 1, i], M[row + 1, i + 1] = own[0], -other[0]
            else:
                M[row + 1, i + 1], f[row + 1] = other[1], its[1]
        return np.asarray(np.linalg.solve(M.reshape(2 * n, 2 * n), f).reshape(n, 2))


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
    """Two bars between fixed walls, pressed together by their own expansion; ν = 0.

    The conductance between them is h₀ + h₁ p, h₁ in N/(mm s K) per MPa. More pressure lets more
    heat pass, which cools the hot bar and warms the cold one: where the cold bar expands more,
    several states can hold, one of them open (Barber, Dundurs & Comninou, J. Appl. Mech. 47, 1980).
    Lengths [mm], Young's moduli [MPa], expansions [1/K] and conductivities are those of the bars;
    the gap [mm] is that without strain; temperatures are those of the hot wall, which holds the
    first bar, of the cold one, and without strain.
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
        """Length of both bars under a pressure, free to expand, over the room they have [mm]."""
        hot, cold, free = self.temperatures
        state = self.state(p)
        means = ((hot + state.first) / 2 - free, (cold + state.second) / 2 - free)
        each = zip(self.lengths, self.moduli, self.expansions, means, strict=True)
        return sum(L * (a * mean - p / E) for L, E, a, mean in each) - self.gap

    def states(self) -> tuple[Wall, ...]:
        """All states in equilibrium, by pressure; the excess times 1 + R h is quadratic in it."""
        R = sum(L / k for L, k in zip(self.lengths, self.conductivities, strict=True))
        p = np.array([0.0, 1.0, 2.0])
        values = [self.excess(s) * (1 + R * (self.h0 + self.h1 * s)) for s in p]
        roots = np.roots(np.polyfit(p, values, 2))
        closed = sorted(float(s.real) for s in roots if abs(s.imag) < 1e-12 and s.real > 0)
        return tuple(map(self.state, [0.0, *closed] if self.excess(0.0) <= 0 else closed))


@dataclass(frozen=True)
class WavyContact:
    """Two blocks, 0 < z < H and H < z < 2 H, that touch with a pressure that varies along x.

    With p = p₀ + p₁ cos κx, κ = π / L, and the conductance h₀ + h₁ p the temperature jumps by g
    everywhere, the heat flux q = g (h₀ + h₁ p) varies, and

        T = T_m + g (below only) - q (z - H) / k,     u = (0, 0, f(x) (z - H)),
        (λ + 2 μ) f = -p + (3 λ + 2 μ) a (T_i - T_ref),   T_i = T_m + g below, T_m above,

    so that neither shear nor motion is on z = H, and nothing but sliding on x = 0 and x = L. The
    values are those of wavy_contact.yaml; pairs are of the block below and of that above.
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
