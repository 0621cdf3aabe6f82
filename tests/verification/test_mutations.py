"""A wrong sign or factor in the equations makes a problem of ``mantle verify`` fail.

A copy of the program has one mistake at a time: eq. 48 to 50 (elasticity), eq. 57 and 65 (contact),
Coulomb's cone, loads; eq. 14, 66 and 68 (heat at interfaces), conduction, cure, thermal strain.
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

# A file; a problem that has to fail; each mistake: what is in the file -> what is planted instead.
# Those of eq. 14, 50, 66 and 68 as printed are among them, one by one.
TABLE = r"""
forms/elasticity.py
  uniaxial_along
    eq50_poisson_ratio_in_e1: e1 = (ν_t + a) * E_t -> e1 = (ν_t + ν_t**2 * E_t / E_l) * E_t
    eq50_poisson_ratio_in_e3: ν_l * ν_t - a) * E_t -> ν_l * ν_t - ν_t**2 * E_t / E_l) * E_t
    eq50_poisson_ratio_in_e5: - a + (1 - ν_t**2) -> - ν_t**2 * E_t / E_l + (1 - ν_t**2)
    eq50_inverted_moduli_in_e5: (1 - ν_t**2) * E_l / E_t -> (1 - ν_t**2) * E_t / E_l
    eq50_factor_in_Δ: 2 * ν_l**2 * E_t -> ν_l**2 * E_t
    eq50_sign_in_e2: e2 = E_t / (1 + ν_t)\n -> e2 = E_t / (1 - ν_t)\n
    eq50_sign_in_e3: e3 = (ν_l - ν_t -> e3 = (ν_l + ν_t
    eq50_sign_in_e5: e5 = -4 * μ_l -> e5 = 4 * μ_l
  patch_fibre_111
    eq50_factor_in_e4: e4 = 2 * μ_l - E_t -> e4 = μ_l - E_t
  sine_p2
    eq48_lame_coefficient: ν / ((1 + ν) * (1 - 2 * ν)), E -> ν / ((1 + ν) * (1 - ν)), E
  layers_bonded
    factor_of_the_thermal_strain: return e * Identity(3) -> return e / 3 * Identity(3)
forms/contact.py
  incline
    eq65_sign_of_the_augmentation: λ + r * (jump + i -> λ - r * (jump + i
    eq65_sign_of_the_multiplier: λ + r * (jump + i -> -λ + r * (jump + i
    eq65_other_half_line: p = [-a for a in -> p = [a for a in
    eq65_disc_not_frozen: _states(S_star, dS, normals, μ) -> _states(S, dS, normals, μ)
    cone_of_the_multiplier: {S_star: S} -> {S_star: multiplier}
    cone_without_coefficient: radius = μ * sum(p[1:], p[0]) -> radius = sum(p[1:], p[0])
    cone_of_negative_radius: radius = μ * sum(p[1:], p[0]) -> radius = -μ * sum(p[1:], p[0])
    cone_inside_out: le(inner(S_T, S_T), radius**2) -> ge(inner(S_T, S_T), radius**2)
    cone_projection: 2 * radius * size - radius**2 -> radius * size - radius**2
  lame_plane_strain_5
    eq65_sign_of_the_gap: r * (jump + initial_gap) -> r * (jump - initial_gap)
  wall_penalty
    eq65_factor_of_the_potential: inner(λ, λ)) / (2 * r) -> inner(λ, λ)) / r
    eq57_penalty: q = variable(jump)\n -> r = 1.01 * r\n    q = variable(jump)\n
  foundation_bar
    eq65_slip_since_the_last_state: r * (jump - jump_old) -> r * jump
forms/loads.py
  sine_p2
    sign_of_the_body_force: return dot(b, v) -> return -dot(b, v)
forms/interface_heat.py
  heat_bars
    eq14_sign_of_the_flux: q = -diff(conduction_potential( -> q = diff(conduction_potential(
    eq68_factor_of_the_flux: return h / 2 * τ**2 -> return h * τ**2
  wavy_temperature
    eq66_sign_of_the_pressure: conditional(gt(p, 0), p, 0 * p) -> conditional(gt(p, 0), -p, 0 * p)
  rubbing_energy
    eq68_no_net_heat_of_friction: (1 - share) * D, share * D -> -share * D, share * D
app/scene/scene.py
  rubbing_split
    share_of_the_other_side: = slave_effusivity / ( -> = master_effusivity / (
  rubbing_given
    given_share_swapped: first_share if swapped else -> first_share if not swapped else
forms/heat.py
  heat_slab
    fourier_factor: return k / 2 * inner(g, g) -> return k * inner(g, g)
    exchange_factor: coefficient / 2 * (θ - outside) ** 2 -> coefficient * (θ - outside) ** 2
    sign_of_the_heating: return q * v\n -> return -q * v\n
  heat_fibre
    fourier_across_the_fibre: (k_l - k_t) / 2 * dot(m, g) -> (k_l + k_t) / 2 * dot(m, g)
app/heat/operators.py
  heat_cylinder
    capacity: += c.capacity * -> += 1.1 * c.capacity *
app/heat/curing.py
  cure_heat
    heat_of_cure: c.heat * volume[dof] -> 0.9 * c.heat * volume[dof]
    sign_of_the_cure: (d.degree - a) -> (a - d.degree)
forms/cure.py
  cure_isothermal
    arrhenius_sign: exp(-Ea / ( -> exp(Ea / (
    arrhenius_exponents: a**m * max_value(limit - a, 0) ** n -> a**n * max_value(limit - a, 0) ** m
app/mechanics/thermal_strain.py
  layers_bonded
    sign_of_the_thermal_strain: = x.expansion * (temp -> = -x.expansion * (temp
"""


def mutations() -> dict[str, tuple[str, str, str, str]]:
    """Mistakes by name: a file, its text, the wrong text, and the problem that has to fail."""
    table, file, problem = {}, "", ""
    for line in filter(None, TABLE.splitlines()):
        if line.startswith("    "):
            name, _, change = line.strip().partition(": ")
            right, wrong = change.replace("\\n", "\n").split(" -> ")
            table[name] = (file, right, wrong, problem)
        elif line.startswith("  "):
            problem = line.strip()
        else:
            file = line
    return table


MUTATIONS = mutations()


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


@pytest.mark.parametrize("name", MUTATIONS)
def test_mutations_change_one_place(name: str) -> None:
    file, right, wrong, _ = MUTATIONS[name]
    assert right != wrong
    assert (support.ROOT / file).read_text(encoding="utf-8").count(right) == 1


@pytest.mark.slow
@pytest.mark.parametrize("pattern", sorted({pattern for *_, pattern in MUTATIONS.values()}))
def test_mutations_unchanged_copy_passes(pattern: str, program: Path) -> None:
    end = verify(program, pattern)
    assert end.returncode == 0, (end.stdout, end.stderr)


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTATIONS)
def test_mutations_make_a_problem_fail(name: str, program: Path) -> None:
    file, right, wrong, pattern = MUTATIONS[name]
    text = (program / file).read_text(encoding="utf-8")
    assert text.count(right) == 1
    (program / file).write_text(text.replace(right, wrong), encoding="utf-8")
    end = verify(program, pattern)
    assert end.returncode == 1, (end.returncode, end.stdout, end.stderr)
    printed = end.stdout.splitlines()
    assert any(re.search(r"problems?: .*(missed|failed): ", line) for line in printed), end.stdout
    print(name, [line for line in printed if "missed" in line or "failed" in line])
