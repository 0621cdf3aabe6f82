"""Closed forms of elastic bodies, contact and friction, each with its source.

Nothing here comes from the code under test. Lengths in mm, stresses and moduli in MPa, forces in N;
Young's modulus and Poisson's ratio are passed as a pair (E, ν). Positions are arrays (n, 3).

The problems are those of `configs/verification`; `problems` compares with them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from app.foundation.arrays import Floats

Elastic = tuple[float, float]
VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


# Elasticity


Vector = tuple[float, float, float]


@dataclass(frozen=True)
class CantileverBar:
    """A prismatic bar along z, without lateral strain, clamped at z = 0, with a force above it.

    The force acts at a point that moves with the top as a rigid body (Timoshenko and Goodier,
    Theory of Elasticity: sections 102 to 110 for bending and torsion of rectangles).

    Attributes:
        E: Young's modulus [MPa]; Poisson's ratio is zero.
        width: Size of the section along x [mm].
        depth: Size of the section along y [mm].
        length: Length [mm].
    """

    E: float
    width: float
    depth: float
    length: float

    def moments(self, force: Vector, head: Vector, z: float) -> Floats:
        """Moments about the centre of the section at z (3,) [N mm].

        ``head`` is the point of the force against the centre of the top [mm].
        """
        arm = np.array([head[0], head[1], head[2] + self.length - z])
        return np.cross(arm, force)

    def largest_stress(self, force: Vector, head: Vector, z: float) -> float:
        """Largest axial stress of the section at z [MPa]."""
        area = self.width * self.depth
        about_x, about_y, _ = np.abs(self.moments(force, head, z))
        bending = 6.0 * about_x / (area * self.depth) + 6.0 * about_y / (area * self.width)
        return float(force[2] / area + bending)

    def deflection(self, force: Vector, head: Vector) -> float:
        """Displacement of the point of the force along it [mm], by the energy of the bar."""
        area, shear_modulus = self.width * self.depth, self.E / 2.0
        z, weight = np.polynomial.legendre.leggauss(3)
        x, y, twist = np.array(
            [self.moments(force, head, 0.5 * self.length * (1.0 + point)) for point in z]
        ).T
        twice_energy = (
            force[2] ** 2 / (self.E * area)
            + 12.0 * x**2 / (self.E * area * self.depth**2)
            + 12.0 * y**2 / (self.E * area * self.width**2)
            + 1.2 * (force[0] ** 2 + force[1] ** 2) / (shear_modulus * area)
            + twist**2 / (shear_modulus * self.torsion_constant())
        )
        force_times_deflection = 0.5 * self.length * float(weight @ twice_energy)
        return force_times_deflection / float(np.linalg.norm(force))

    def torsion_constant(self) -> float:
        """Torsion constant of a rectangle [mm^4], by Saint-Venant's series."""
        long_side, short_side = max(self.width, self.depth), min(self.width, self.depth)
        odd_numbers = np.arange(1, 40, 2)
        series = (
            np.tanh(odd_numbers * math.pi * long_side / (2.0 * short_side)) / odd_numbers**5
        ).sum()
        return float(
            long_side
            * short_side**3
            / 3.0
            * (1.0 - 192.0 * short_side / (math.pi**5 * long_side) * series)
        )


@dataclass(frozen=True)
class Fibrous:
    """A transversely isotropic material: moduli [MPa] and ratios along and across the fibre.

    ``nu_l`` is minus the transverse over the axial strain under axial stress.
    """

    E_l: float
    E_t: float
    nu_l: float
    nu_t: float
    mu_l: float

    def compliance(self) -> Floats:
        """Compliance (6, 6) [1/MPa] for engineering strains 11, 22, 33, 23, 13, 12, fibre along 3.

        Written down from uniaxial and shear tests, one column each (Lekhnitskii, Theory of
        Elasticity of an Anisotropic Body, section 4); nothing of eq. 50 enters.
        """
        across_fibre = 1 / self.E_t
        along_fibre = 1 / self.E_l
        S = np.diag([across_fibre, across_fibre, along_fibre, 1 / self.mu_l, 1 / self.mu_l, 0])
        S[0, 1] = S[1, 0] = -self.nu_t * across_fibre
        S[:2, 2] = S[2, :2] = -self.nu_l * along_fibre
        S[5, 5] = 2 * (1 + self.nu_t) * across_fibre
        return S

    def stress(self, strain: Floats, fibre: Sequence[float]) -> Floats:
        """Stress (3, 3) [MPa] of a tensor strain (3, 3), the fibre along a direction (3,)."""
        axis = np.asarray([fibre]) / np.linalg.norm(fibre)
        i, j = np.array(VOIGT).T
        R = np.column_stack([null_space(axis), axis.T])
        engineering = (R.T @ strain @ R)[i, j] * [1, 1, 1, 2, 2, 2]
        σ = np.zeros((3, 3))
        σ[i, j] = σ[j, i] = np.linalg.solve(self.compliance(), engineering)
        return np.asarray(R @ σ @ R.T)


def sine(x: Floats, amplitude: float, side: float) -> Floats:
    """Displacement (n, 3): amplitude sin(πx/L) sin(πy/L) sin(πz/L) along x, zero on a cube."""
    u = np.zeros_like(x)
    u[:, 0] = amplitude * np.sin(math.pi * x / side).prod(axis=1)
    return u


# Press fits


def lame_pressure(δ: float, b: float, c: float, core: Elastic, ring: Elastic) -> float:
    """Pressure of a core of radius b in a ring b < r < c too small by δ, plane strain [MPa].

    Timoshenko & Goodier, Theory of Elasticity, section 28, with E/(1-ν²) and ν/(1-ν).
    """
    return lame_pressure_free(δ, b, c, _plane_strain(core), _plane_strain(ring))


def lame_pressure_free(δ: float, b: float, c: float, core: Elastic, ring: Elastic) -> float:
    """The same with free ends (plane stress) [MPa]."""
    (E_i, ν_i), (E_o, ν_o) = core, ring
    return δ / b / (((c * c + b * b) / (c * c - b * b) + ν_o) / E_o + (1 - ν_i) / E_i)


def press_out_factor(μ: float, r: float, R: float, length: float, ν: float) -> float:
    r"""Force that pulls a rigid rod out of a ring r < R, over μ p A with Lamé's pressure p.

    Friction loads the ring along the axis: its axial stress changes by -2 μ p r / (R² - r²) per
    length. By Poisson's effect this moves the inner surface. The pressure p then changes along the
    axis, and so does the shear stress in the ring,

    .. math:: τ = μ p \frac{r}{R^2 - r^2} \left(\frac{R^2}{x} - x\right)

    at a radius x. Its change along the axis is a radial force per volume, which moves the inner
    surface too (`_under_changing_shear`). At a distance s from the free end of the ring

    .. math:: p = \frac{p_0}{1 + ε} e^{b s / (1 + ε)}, \quad
              b = \frac{2 μ r ν}{(R^2 - r^2) k}, \quad
              k = \frac{R^2 + r^2}{R^2 - r^2} + ν, \quad ε = μ b m / k ,

    with the displacement m of the inner surface by a unit change of shear.

    A negative μ is for pushing in a rod whose ring is held at its far end.
    """
    k = (R * R + r * r) / (R * R - r * r) + ν
    b = 2 * μ * r / (R * R - r * r) * ν / k
    ε = μ * b * _under_changing_shear(r, R, ν) / k
    bL = b / (1 + ε) * length
    return math.expm1(bL) / bL / (1 + ε)


def _under_changing_shear(r: float, R: float, ν: float) -> float:
    """Displacement of the inner surface of a ring whose shear changes along its axis [mm].

    The ring is free at both surfaces, in plane stress. The shear stress at the inner surface
    changes by E / r per length, with the profile of `press_out_factor`: the displacement of a
    pressure E k / r there would be k. Particular solutions of the radial force R²/x - x are
    -(1 - ν²) R² x ln(x) / 2 and (1 - ν²) x³ / 8.
    """
    scale = r / (R * R - r * r)

    def force_alone(x: float) -> tuple[float, float]:
        """Displacement and radial stress of the particular solution at a radius."""
        u = scale * (1 - ν * ν) * (x**3 / 8 - R * R * x * math.log(x) / 2)
        slope = scale * (1 - ν * ν) * (3 * x * x / 8 - R * R * (math.log(x) + 1) / 2)
        return u, (slope + ν * u / x) / (1 - ν * ν)

    # Added is C x + B / x, whose radial stress is C / (1 - ν) - B / (x² (1 + ν)).
    (u, inner), (_, outer) = force_alone(r), force_alone(R)
    B = (1 + ν) * (inner - outer) / (1 / r**2 - 1 / R**2)
    C = (1 - ν) * (B / (r * r * (1 + ν)) - inner)
    return (u + C * r + B / r) / r


def taper_force(
    depth: float, angle: float, radii: tuple[float, float], outer: float, ring: Elastic
) -> float:
    """Axial force on a frictionless rigid cone driven into a ring with its taper by a depth [N].

    Each slice is a ring of Lamé with the interference depth tan(angle).

    Args:
        depth: Depth [mm].
        angle: Half-angle of the cone [rad].
        radii: Radii of the cone at both ends [mm].
        outer: Outer radius of the ring [mm].
        ring: Its material.
    """
    slope = math.tan(angle)
    edges = np.linspace(*radii, 201)
    middles = 0.5 * (edges[1:] + edges[:-1])
    fits = [lame_pressure_free(depth * slope, b, outer, (1e12, 0.3), ring) for b in middles]
    # The pressure acts on the area that each slice shows along the axis.
    return float((np.array(fits) * math.pi * np.diff(edges**2)).sum())


def _plane_strain(material: Elastic) -> Elastic:
    E, ν = material
    return E / (1 - ν * ν), ν / (1 - ν)


def lame(material: Elastic) -> tuple[float, float]:
    """Lamé's coefficients λ and μ [MPa]."""
    E, ν = material
    return E * ν / ((1 + ν) * (1 - 2 * ν)), E / (2 * (1 + ν))


@dataclass(frozen=True)
class Layers:
    """A core and concentric rings around it without load, in plane strain.

    In each u_r = A r + B / r, with B = 0 in the core (Timoshenko & Goodier, section 28). A core too
    large by δ is one of the free strain δ / (1 + ν) r. All attributes are from inside to outside.

    Attributes:
        radii: Radii of the outer surfaces [mm].
        materials: Young's modulus [MPa] and Poisson's ratio of each.
        free_strains: Free strains, the same in all directions.
        joined: For each pair of neighbours True if they are joined, False for no traction.
    """

    radii: Sequence[float]
    materials: Sequence[Elastic]
    free_strains: Sequence[float]
    joined: Sequence[bool]

    def state_at(self, i: int, r: float) -> Floats:
        """Displacement [mm], radial and hoop stress [MPa] of layer i at r (3,)."""
        terms, free_terms = self._terms(i, r)
        return np.asarray(terms @ self._constants()[i] - free_terms)

    def gap(self, i: int) -> float:
        """Gap between layers i and i + 1 [mm]."""
        r = self.radii[i]
        return float(self.state_at(i + 1, r)[0] - self.state_at(i, r)[0])

    def _terms(self, i: int, r: float) -> tuple[Floats, Floats]:
        """Coefficients of A and B in `state_at` (3, 2), and what the free strain takes off (3,)."""
        λ, μ = lame(self.materials[i])
        b = 1 / r**2 if i else 0.0
        terms = [[r, b * r], [2 * (λ + μ), -2 * μ * b], [2 * (λ + μ), 2 * μ * b]]
        return np.array(terms), (3 * λ + 2 * μ) * self.free_strains[i] * np.array([0, 1, 1])

    def _constants(self) -> Floats:
        """A and B of each layer (n, 2)."""
        n = len(self.radii)
        M = np.zeros((2 * n, n, 2))
        f = np.zeros(2 * n)
        M[0, 0, 1] = 1.0
        for i, r in enumerate(self.radii):
            row = 2 * i + 1
            terms, free_terms = self._terms(i, r)
            M[row, i] = terms[1]
            f[row] = free_terms[1]
            if i + 1 == n:
                continue
            next_terms, next_free_terms = self._terms(i + 1, r)
            if self.joined[i]:
                M[row, i + 1] = -next_terms[1]
                f[row] -= next_free_terms[1]
                M[row + 1, i] = terms[0]
                M[row + 1, i + 1] = -next_terms[0]
            else:
                M[row + 1, i + 1] = next_terms[1]
                f[row + 1] = next_free_terms[1]
        return np.asarray(np.linalg.solve(M.reshape(2 * n, 2 * n), f).reshape(n, 2))


@dataclass(frozen=True)
class OvalFit:
    r"""A press fit whose interference varies: δ₀ + δ₂ cos 2θ at r = b; no friction, plane strain.

    The even part is Lamé's. The rest is Michell's solution of order 2 (Barber, Elasticity, table
    9.1), in the core and in the ring:

    .. math:: φ = (A r² + B r⁴) \cos 2θ, \qquad φ = (A r² + B r⁴ + C r^{-2} + D) \cos 2θ .

    There is no shear on r = b and no traction on r = c. On r = b normal tractions are equal, and
    the jump is given.

    Radii b of the interface and c of the outer surface, δ₀ and δ₂ in mm.
    """

    b: float
    c: float
    core: Elastic
    ring: Elastic
    δ0: float
    δ2: float

    def pressure(self, x: Floats) -> Floats:
        """Pressure (n,) at points of the interface [MPa]."""
        p0 = lame_pressure(self.δ0, self.b, self.c, self.core, self.ring)
        A = self._michell()[0]
        θ = np.arctan2(x[:, 1], x[:, 0])
        return np.asarray(p0 + 2 * A * np.cos(2 * θ))  # σ_rr of A r² is -2 A

    def displacement(self, x: Floats, in_core: bool) -> Floats:
        """Displacement (n, 3) [mm]; each body's formula holds beyond it too."""
        r = np.hypot(x[:, 0], x[:, 1])
        θ = np.arctan2(x[:, 1], x[:, 0])
        material = self.core if in_core else self.ring
        E, ν = material
        p = lame_pressure(self.δ0, self.b, self.c, self.core, self.ring) * (1 + ν) / E
        b2 = self.b**2
        c2 = self.c**2
        if in_core:
            u_r = -p * (1 - 2 * ν) * r
            constants = self._michell()[:2]
        else:
            u_r = p * b2 / (c2 - b2) * ((1 - 2 * ν) * r + c2 / r)
            constants = self._michell()[2:]
        terms = _michell_motion(r, material)[:, : len(constants)]
        radial, hoop = np.einsum("k,ikn->in", constants, terms)
        u_r = u_r + radial * np.cos(2 * θ)
        u_θ = hoop * np.sin(2 * θ)
        cos = np.cos(θ)
        sin = np.sin(θ)
        return np.column_stack([u_r * cos - u_θ * sin, u_r * sin + u_θ * cos, 0 * r])

    def _michell(self) -> Floats:
        """A, B of the core and A, B, C, D of the ring."""
        inner = _michell_stress(self.b)
        outer = _michell_stress(self.c)
        core, ring = (_michell_motion(self.b, m)[0] for m in (self.core, self.ring))
        rows = np.zeros((6, 6))
        # No shear on the interface, of either body.
        rows[0, :2] = inner[1, :2]
        rows[1, 2:] = inner[1]
        # No traction on the outer surface.
        rows[2:4, 2:] = outer
        # Equal normal traction, and the given jump, on the interface.
        rows[4] = [*-inner[0, :2], *inner[0]]
        rows[5] = [*-core[:2], *ring]
        return np.asarray(np.linalg.solve(rows, [0, 0, 0, 0, 0, self.δ2]))


def _michell_motion(r: float | Floats, material: Elastic) -> Floats:
    """u_r over cos 2θ and u_θ over sin 2θ of A r², B r⁴, C r⁻² and D (2, 4, ...)."""
    E, ν = material
    κ = 3 - 4 * ν
    R = np.asarray(r)
    radial = [-2 * R, (κ - 3) * R**3, 2 / R**3, (κ + 1) / R]
    hoop = [2 * R, (κ + 3) * R**3, 2 / R**3, (1 - κ) / R]
    return (1 + ν) / E * np.array([radial, hoop])


def _michell_stress(r: float) -> Floats:
    """σ_rr over cos 2θ and σ_rθ over sin 2θ of the four terms (2, 4)."""
    normal = [-2, 0, -6 / r**4, -4 / r**2]
    shear = [2, 6 * r**2, -6 / r**4, -2 / r**2]
    return np.array([normal, shear])


# Fibres about an axis


@dataclass(frozen=True)
class FibreRing:
    """A ring a < r < b with fibres around its axis, or away from it, under a pressure inside.

    Plane strain: ε_r = β_rr σ_r + β_rθ σ_θ and so on with β_ij = a_ij - a_iz a_jz / a_zz.
    Equilibrium σ_θ = (r σ_r)' and compatibility ε_r = (r ε_θ)' leave σ_r = A r^(k-1) + B r^(-k-1)
    with k² = β_rr / β_θθ (Lekhnitskii, Anisotropic Plates, section 24).

    Radii a and b in mm, pressure in MPa; ``radial``: the fibres point away from the axis.
    """

    a: float
    b: float
    pressure: float
    material: Fibrous
    radial: bool

    def stress(self, r: Floats) -> tuple[Floats, Floats]:
        """Radial and hoop stress (n,) at radii (n,) [MPa]."""
        rr, _, tt = self._compliance()
        k = math.sqrt(rr / tt)
        ρ = r / self.b
        c = self.a / self.b
        A = self.pressure * c ** (k + 1) / (1 - c ** (2 * k))
        rising_terms = A * ρ ** (k - 1)
        falling_terms = A * ρ ** (-k - 1)
        return rising_terms - falling_terms, k * (rising_terms + falling_terms)

    def displacement(self, x: Floats) -> Floats:
        """Displacement (n, 3) [mm] at points (n, 3), the axis along z."""
        r = np.hypot(x[:, 0], x[:, 1])
        σ_r, σ_t = self.stress(r)
        _, rt, tt = self._compliance()
        return np.asarray((rt * σ_r + tt * σ_t)[:, None] * x * [1, 1, 0])

    def _compliance(self) -> tuple[float, float, float]:
        """β_rr, β_rθ, β_θθ [1/MPa]."""
        S = self.material.compliance()
        # Of the axes of the material the third is the fibre.
        r, t, z = (2, 0, 1) if self.radial else (0, 2, 1)
        rr, rt, tt = (S[i, j] - S[i, z] * S[j, z] / S[z, z] for i, j in ((r, r), (r, t), (t, t)))
        return rr, rt, tt


# Contact of curved bodies


def contact_modulus(*materials: Elastic) -> float:
    """1 / E* = Σ (1 - ν²) / E over the elastic bodies (one against a rigid body) [MPa]."""
    return 1 / sum((1 - ν * ν) / E for E, ν in materials)


@dataclass(frozen=True)
class Hertz:
    """Half-width or radius a [mm], peak pressure p0 [MPa] and approach δ [mm] (nan for a line)."""

    a: float
    p0: float
    approach: float


def hertz_line(load: float, radius: float, modulus: float) -> Hertz:
    """A cylinder under a load per length [N/mm] (Johnson, Contact Mechanics, section 4.2c)."""
    a = math.sqrt(4 * load * radius / (math.pi * modulus))
    return Hertz(a, 2 * load / (math.pi * a), math.nan)


def hertz_point(load: float, radius: float, modulus: float) -> Hertz:
    """A ball under a load [N] (Johnson, Contact Mechanics, section 4.2a)."""
    a = (3 * load * radius / (4 * modulus)) ** (1 / 3)
    return Hertz(a, 3 * load / (2 * math.pi * a * a), a * a / radius)


def stick_half_width(a: float, shear: float, pressure: float, friction: float) -> float:
    """Half-width of the strip that sticks in a line contact, Q after P, Q < μP [mm].

    Cattaneo 1938, Mindlin 1949 (Johnson, Contact Mechanics, section 7.2).
    """
    return a * math.sqrt(1 - shear / (friction * pressure))


# Friction


@dataclass(frozen=True)
class FoundationBar:
    """A bar on a bed with friction f [N/mm], pulled at its end by F [N]; stiffness EA [N].

    Where the bar slips its force falls by f per length: an ordinary integral of f x / EA.
    Unloading slips back over half that length with twice the friction.
    """

    force: float
    friction: float
    stiffness: float

    @property
    def end(self) -> float:
        """End displacement under the first load [mm]."""
        return self.force**2 / (2 * self.stiffness * self.friction)

    @property
    def residual(self) -> float:
        """End displacement after unloading [mm]."""
        return self.end / 2

    @property
    def cycle(self) -> float:
        """Work lost per cycle of unloading and loading [N mm]."""
        return self.force**3 / (12 * self.stiffness * self.friction)


def push_up(slope: float, friction: float) -> float:
    """Horizontal force over weight that slides a block up a slope of the given tangent."""
    return (slope + friction) / (1 - friction * slope)


def penalty_penetration(stiffness: float, motion: float, penalty: float) -> float:
    """Penetration of a bar in series with a penalty spring [mm]; both stiffnesses per area."""
    return stiffness * motion / (stiffness + penalty)


def particle_friction(k_T: float, w: float) -> float:
    """Friction beyond which Klarbring's particle has several solutions under some load.

    The particle, on springs [[k_T, w], [w, k_N]], rests on a rigid line with Coulomb friction
    (Klarbring, Ingenieur-Archiv 60, 1990).
    """
    return k_T / abs(w)


# Cook's membrane

# Displacement (across, up) [mm] of the corner (48, 60) of the membrane (0, 0) (48, 44) (48, 60)
# (0, 44), plane strain, E = 250 MPa, F = 100 N per mm of thickness along y over the right edge:
# tests/reference/cook_taylor_hood.py.
COOK = {
    0.3: (-6.88970, 9.22266),
    0.45: (-6.00846, 8.22283),
    0.49: (-5.70232, 7.86599),
    0.499: (-5.62897, 7.78000),
    0.4999: (-5.62155, 7.77128),
}


# Finite sliding

# Sink [um] and mean pressure [MPa] within 20 degrees of the pole of the ball of ball_in_cup.yaml
# without friction, by clearance [mm]; the outside of the cup stays at 22 mm: from
# tests/reference/axisymmetric.py.
CUP = {
    0.05: (35.424, 8.298),
    0.1: (45.084, 10.332),
    0.2: (58.746, 13.159),
    0.5: (84.498, 18.328),
}
