"""A wrong sign or factor in the equations makes a problem of ``mantle verify`` fail.

Each mistake is planted in a copy of the program, one at a time: eq. 48 to 50 (elasticity), eq. 57
and 65 (contact), Coulomb's cone, loads; eq. 14, 66 and 68 (heat at interfaces), conduction, cure,
thermal strain.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import support

ELASTICITY, CONTACT = "forms/elasticity.py", "forms/contact.py"
HEAT, INTERFACE_HEAT, CURE = (
    "forms/heat.py",
    "forms/interface_heat.py",
    "forms/cure.py",
)
TRIAL = "S = f + r * (d + gap)"
RADIUS = "radius = μ * sum(p[1:], p[0])"

# A file, what is in it, what is planted instead, and problems of which one has to fail.
MUTATIONS = {
    # The errors of eq. 50 as printed, one by one.
    "eq50_poisson_ratio_in_e1": (
        ELASTICITY,
        "e1 = (ν_t + a) * E_t",
        "e1 = (ν_t + ν_t**2 * E_t / E_l) * E_t",
        "uniaxial_along",
    ),
    "eq50_poisson_ratio_in_e3": (
        ELASTICITY,
        "ν_l * ν_t - a) * E_t",
        "ν_l * ν_t - ν_t**2 * E_t / E_l) * E_t",
        "uniaxial_along",
    ),
    "eq50_poisson_ratio_in_e5": (
        ELASTICITY,
        "- a + (1 - ν_t**2)",
        "- ν_t**2 * E_t / E_l + (1 - ν_t**2)",
        "uniaxial_along",
    ),
    "eq50_inverted_moduli_in_e5": (
        ELASTICITY,
        "(1 - ν_t**2) * E_l / E_t",
        "(1 - ν_t**2) * E_t / E_l",
        "uniaxial_along",
    ),
    # Others.
    "eq50_factor_in_Δ": (ELASTICITY, "2 * ν_l**2 * E_t", "ν_l**2 * E_t", "uniaxial_along"),
    "eq50_sign_in_e2": (
        ELASTICITY,
        "e2 = E_t / (1 + ν_t)\n",
        "e2 = E_t / (1 - ν_t)\n",
        "uniaxial_along",
    ),
    "eq50_sign_in_e3": (ELASTICITY, "e3 = (ν_l - ν_t", "e3 = (ν_l + ν_t", "uniaxial_along"),
    "eq50_factor_in_e4": (ELASTICITY, "e4 = 2 * μ_l - E_t", "e4 = μ_l - E_t", "patch_fibre_111"),
    "eq50_sign_in_e5": (ELASTICITY, "e5 = -4 * μ_l", "e5 = 4 * μ_l", "uniaxial_along"),
    "eq48_lame_coefficient": (
        ELASTICITY,
        "E * ν / ((1 + ν) * (1 - 2 * ν)), E",
        "E * ν / ((1 + ν) * (1 - ν)), E",
        "sine_p2",
    ),
    "eq49_unsymmetric_stress": (
        ELASTICITY,
        "sym(diff(energy(e), e))",
        "diff(energy(e), e)",
        "patch_fibre_011",
    ),
    "eq65_sign_of_the_augmentation": (CONTACT, TRIAL, "S = f - r * (d + gap)", "incline"),
    "eq65_sign_of_the_multiplier": (CONTACT, TRIAL, "S = r * (d + gap) - f", "incline"),
    "eq65_sign_of_the_gap": (CONTACT, TRIAL, "S = f + r * (d - gap)", "lame_plane_strain_5"),
    "eq65_factor_of_the_potential": (
        CONTACT,
        "energy = (square - inner(f, f)) / (2 * r)",
        "energy = (square - inner(f, f)) / r",
        "wall_penalty",
    ),
    "eq65_other_half_line": (CONTACT, "p = [-a for a in", "p = [a for a in", "incline"),
    "eq65_slip_since_the_last_state": (
        CONTACT,
        "dS = f + r * (d - jump_old)",
        "dS = f + r * d",
        "foundation_bar",
    ),
    "eq65_disc_not_frozen": (
        CONTACT,
        "frozen = _states(S_star, dS, normals, μ)",
        "frozen = _states(S, dS, normals, μ)",
        "incline",
    ),
    # The same for an augmented Lagrangian, where F is P(S), but a penalty has no multiplier.
    "cone_of_the_multiplier": (CONTACT, "{S_star: S}", "{S_star: f}", "incline"),
    "cone_without_coefficient": (CONTACT, RADIUS, "radius = sum(p[1:], p[0])", "incline"),
    "cone_of_negative_radius": (CONTACT, RADIUS, "radius = -μ * sum(p[1:], p[0])", "incline"),
    "cone_inside_out": (
        CONTACT,
        "le(inner(S_T, S_T), radius**2)",
        "ge(inner(S_T, S_T), radius**2)",
        "incline",
    ),
    "cone_projection": (
        CONTACT,
        "2 * radius * size - radius**2",
        "radius * size - radius**2",
        "incline",
    ),
    "eq57_penalty": (
        CONTACT,
        'r: Augmentation, or penalty [MPa/mm].\n    """\n',
        'r: Augmentation, or penalty [MPa/mm].\n    """\n    r = 1.01 * r\n',
        "wall_penalty",
    ),
    "sign_of_the_body_force": (
        "forms/loads.py",
        "return dot(b, v)",
        "return -dot(b, v)",
        "sine_p2",
    ),
    # Heat: the errors of eq. 14, 66 and 68 as printed, and others.
    "eq14_sign_of_the_flux": (
        INTERFACE_HEAT,
        "q = -diff(conduction_potential(t, conductance(",
        "q = diff(conduction_potential(t, conductance(",
        "heat_bars",
    ),
    "eq66_sign_of_the_pressure": (
        INTERFACE_HEAT,
        "conditional(gt(p, 0), p, 0 * p)",
        "conditional(gt(p, 0), -p, 0 * p)",
        "wavy_temperature",
    ),
    "eq68_factor_of_the_flux": (
        INTERFACE_HEAT,
        "return h / 2 * τ**2",
        "return h * τ**2",
        "heat_bars",
    ),
    "eq68_no_net_heat_of_friction": (
        INTERFACE_HEAT,
        "return (1 - share) * D, share * D",
        "return -share * D, share * D",
        "rubbing_energy",
    ),
    "share_of_the_other_side": (
        "app/scene/build.py",
        "e_s / (e_s + e_m)",
        "e_m / (e_s + e_m)",
        "rubbing_split",
    ),
    "given_share_of_the_other_side": (
        "app/scene/build.py",
        "share if turned else 1.0 - share",
        "1.0 - share if turned else share",
        "rubbing_given",
    ),
    "fourier_factor": (HEAT, "return k / 2 * inner(g, g)", "return k * inner(g, g)", "heat_slab"),
    "fourier_across_the_fibre": (
        HEAT,
        "(k_l - k_t) / 2 * dot(m, g) ** 2",
        "(k_l + k_t) / 2 * dot(m, g) ** 2",
        "heat_fibre",
    ),
    "exchange_factor": (
        HEAT,
        "return coefficient / 2 * (θ - outside) ** 2",
        "return coefficient * (θ - outside) ** 2",
        "heat_slab",
    ),
    "sign_of_the_heating": (HEAT, "return q * v\n", "return -q * v\n", "heat_slab"),
    "capacity": (
        "app/heat/heat_forms.py",
        "+= c.capacity * ",
        "+= 1.1 * c.capacity * ",
        "heat_cylinder",
    ),
    "heat_of_cure": (
        "app/heat/cure_heat.py",
        "c.heat * volume[dof]",
        "0.9 * c.heat * volume[dof]",
        "cure_heat",
    ),
    "sign_of_the_cure": (
        "app/heat/cure_heat.py",
        "(d.degree - a)",
        "(a - d.degree)",
        "cure_heat",
    ),
    "arrhenius_sign": (CURE, "exp(-Ea / (", "exp(Ea / (", "cure_isothermal"),
    "arrhenius_exponents": (
        CURE,
        "a**m * max_value(limit - a, 0) ** n",
        "a**n * max_value(limit - a, 0) ** m",
        "cure_isothermal",
    ),
    "sign_of_the_thermal_strain": (
        "app/mechanics/thermal_strain.py",
        "(temperatures[x.region].x.array - x.reference)",
        "(x.reference - temperatures[x.region].x.array)",
        "layers_bonded",
    ),
    "factor_of_the_thermal_strain": (
        ELASTICITY,
        "return e * Identity(3)",
        "return e / 3 * Identity(3)",
        "layers_bonded",
    ),
}


def verify(program: Path, pattern: str) -> subprocess.CompletedProcess[str]:
    """Run ``mantle verify`` of a copy of the program."""
    command = [sys.executable, "-m", "mantle", "verify", "-k", pattern, "-o", "out", "--cores", "2"]
    environment = os.environ | {"PYTHONPATH": str(program)}
    return subprocess.run(command, cwd=program, env=environment, capture_output=True, text=True)


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """A copy of the program."""
    for folder in ("app", "forms", "meshes", "configs"):
        caches = shutil.ignore_patterns("__pycache__")
        shutil.copytree(support.ROOT / folder, tmp_path / folder, ignore=caches)
    shutil.copy(support.ROOT / "mantle.py", tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("pattern", sorted({pattern for *_, pattern in MUTATIONS.values()}))
def test_a_copy_without_mistakes_passes(pattern: str, program: Path) -> None:
    end = verify(program, pattern)
    assert end.returncode == 0, (end.stdout, end.stderr)


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTATIONS)
def test_a_planted_mistake_makes_a_problem_fail(name: str, program: Path) -> None:
    file, right, wrong, pattern = MUTATIONS[name]
    text = (program / file).read_text(encoding="utf-8")
    assert text.count(right) == 1
    (program / file).write_text(text.replace(right, wrong), encoding="utf-8")
    end = verify(program, pattern)
    assert end.returncode == 1, (end.returncode, end.stdout, end.stderr)
    said = end.stdout.splitlines()
    assert any(re.search(r"checks?: .*(missed|failed): ", line) for line in said), end.stdout
    print(name, [line for line in said if "missed" in line or "failed" in line])
