"""Closed forms of cement that creeps and bone that remodels.

Nothing here comes from the code under test. Units as in `closed_forms`; N cycles or seconds; a law
of creep is (A, p, m0, m1).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

from app.foundation.arrays import Floats

# Creep

Law = tuple[float, float, float, float]
# The law of creep_bar.yaml.
CEMENT_CREEP: Law = (7.985e-7, 1.9063, 0.4113, -0.1160)
# Norton's law, of exponent 4.
NORTON: Law = (1e-6, 4.0, 1.0, 0.0)
E = 2200.0  # Young's modulus of creep_bar.yaml [MPa]
# Subsidence of creep_taper.yaml by 1e7 cycles of creep [mm]: of rings in plane strain under 3 MPa,
# by an integration of rates (tests/verification/test_closed_forms_creep.py).
SUBSIDENCE = 0.15611


def creep_strain_at_constant_stress(law: Law, s: float, N: float) -> float:
    """Creep strain at a constant stress."""
    A, p, m0, m1 = law
    return float(A * s**p * N ** (m0 + m1 * math.log10(s)))


def relaxed_stress(law: Law, s: float, N: float) -> float:
    """Stress of a bar stretched to a stress s and held.

    By strain hardening dN/de is a function of e alone, as the stress is s - E e. In z = e^(1/m(s))
    it is smooth, and N(e) is its integral.
    """
    A, p, m0, m1 = law
    m = m0 + m1 * math.log10(s)
    z = np.linspace(0, (0.999 * s / E) ** (1 / m), 200_001)[1:]
    e = z**m
    stress = s - E * e
    m_now = m0 + m1 * np.log10(stress)
    slope = (A * stress**p) ** (-1 / m_now) * e ** (1 / m_now - 1 / m) * m / m_now
    cycles = np.concatenate([[0], np.cumsum((slope[1:] + slope[:-1]) / 2) * z[0]]) + slope[0] * z[0]
    return float(s - E * np.interp(N, cycles, e))


def shrink_fit(a: float, b: float, δ: float, ν: float, t: float) -> float:
    """Pressure of a rigid core of radius a in a ring a < r < b of Maxwell's law [MPa].

    The ring is too small by δ, in plane strain, after t relaxation times of shear. By
    correspondence G s / (s + 1) replaces G in the elastic solution. The inverse transform has two
    exponentials.
    """
    G = E / (2 + 2 * ν)
    K = E / (3 - 6 * ν)
    c = 2 * G * (1 / a**2 - 1 / b**2) * δ
    N1 = (K + G / 3) * b * b * a
    N0 = K * b * b * a
    D1 = a * a * G + b * b * (K + G / 3)
    s2 = -K * b * b / D1
    first_factor = (N0 - N1) / (-1 - s2)
    second_factor = (N1 * s2 + N0) / (1 + s2)
    return float(c / D1 * (first_factor * math.exp(-t) + second_factor * math.exp(s2 * t)))


def stationary_ring(r: Floats, n: float, pressure: float, a: float, b: float) -> Floats:
    """Hoop less radial stress (n,) at radii (n,) of a ring a < r < b under a pressure inside [MPa].

    Stationary creep by Norton's law of exponent n, plane strain. Volume is kept, so rates fall with
    1/r^2 and the difference with (1/r^2)^(1/n); equilibrium gives (2 p / n) (b/r)^(2/n) over
    (b/a)^(2/n) - 1.
    """
    return np.asarray(2 * pressure / n * (b / r) ** (2 / n) / ((b / a) ** (2 / n) - 1))


# Remodelling

# Of the cases remodelling.yaml and columns.yaml.
PER_DENSITY = 100.0  # Young's modulus over the square of the density [MPa / (g/cm3)^2]
STIMULUS = 0.25  # reference stimulus [J/g]
LAZY = 0.35  # half-width of the lazy zone
BOUNDS = (0.01, 1.74)  # densities [g/cm3]
START = 0.8  # density at the start [g/cm3]


def column_density(
    stress: float, start: float = START, lazy: float = LAZY, exponent: float = 2.0
) -> float:
    """Final density of a column under a stress [MPa], from a density at the start [g/cm3].

    The stimulus s^2 / (2 C rho^(exponent + 1)) ends on the edge of the lazy zone that it reaches
    first. A bound of the density may stop it before.
    """
    zone = np.array([1 + lazy, 1 - lazy])
    end_density = (stress**2 / (2 * PER_DENSITY * STIMULUS * zone)) ** (1 / (exponent + 1))
    return float(np.clip(start, *np.clip(end_density, *BOUNDS)))


def column_density_at(time: float, stress: float) -> float:
    """Density of a column on its way, by integration of its differential equation [g/cm3]."""

    def speed(t: float, rho: float) -> float:
        U = stress**2 / (2 * PER_DENSITY * rho**3)
        return max(U - (1 + LAZY) * STIMULUS, 0.0) + min(U - (1 - LAZY) * STIMULUS, 0.0)

    return float(solve_ivp(speed, (0, time), [START], rtol=1e-10, atol=1e-12).y[0, -1])
