"""Failure index of interfaces: bonded ones by equilibrium, others by their points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests import support

STRENGTH = "strength: {tension: 1.35 MPa, shear: 2.25 MPa}"
# Two bars of unlike moduli, one on the other.
BARS = f"""
geometry: {{kind: blocks, blocks: [{{name: one, size: [4 mm, 4 mm, 4 mm]}},
                                  {{name: two, size: [4 mm, 4 mm, 4 mm]}}]}}
mesh: {{size: 2 mm}}
regions:
  one: {{youngs_modulus: 2 GPa, poisson_ratio: 0, tissue: other}}
  two: {{youngs_modulus: 20 GPa, poisson_ratio: 0, tissue: other}}
interfaces: {{one_two: {{kind: bonded, {STRENGTH}}}}}
"""
CONTACT = f"interfaces.one_two={{kind: contact, friction_coefficient: 5, {STRENGTH}}}"


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("pull", "shear"), [(1.3, 0.0), (2.7, 0.0), (-9.0, 2.0), (1.0, 4.0)])
def test_bond_forces_of_a_pulled_and_sheared_interface(
    tmp_path: Path, order: int, pull: float, shear: float
) -> None:
    """Tractions are uniform.

    Strains follow from the moduli; the surface has given displacements.
    """
    below, above = f"min(z, 4) * {1 / 2e3}", f"max(z - 4, 0) * {1 / 20e3}"
    along = f"({below} + {above})"
    given = f"x: '{2 * shear} * {along}', y: 0 mm, z: '{pull} * {along}'"
    faces = ("bottom", "top", "x_min", "x_max", "y_min", "y_max")
    held = [f"{f}: {{kind: displacement, boundary: {f}, {given}}}" for f in faces]
    supports = f"supports={{{', '.join(held)}}}"
    results = support.run(BARS, tmp_path, f"mesh.order={order}", supports)
    index = np.hypot(max(pull, 0.0) / 1.35, shear / 2.25)
    bond = results.summary["bonds"]["one_two"]
    assert bond["failure_index_max"] == pytest.approx(index, rel=1e-9)
    map_ = results.fields.at_interface("one_two", "failure_index")
    assert map_.max() == pytest.approx(index, rel=1e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_bond_forces_equal_those_of_sticking_contact(tmp_path: Path, order: int) -> None:
    """Multipliers agree at edges, unlike sides, rollers on the rim, and a region in two bodies."""
    supports = (
        "{base: {kind: fixed, boundary: bottom}, cut: {kind: roller, boundary: y_min, axis: y}}"
    )
    press = "{kind: force, boundary: top, force: [30 N, 10 N, -160 N]}"
    changes = (f"mesh.order={order}", f"supports={supports}", f"loads.press={press}")
    bonded = support.run(BARS, tmp_path / "bonded", *changes)
    sticks = support.run(BARS, tmp_path / "sticks", *changes, CONTACT)
    assert sticks.summary["interfaces"]["one_two"]["stick_fraction"] == 1.0
    maps = [r.fields.at_interface("one_two", "failure_index") for r in (bonded, sticks)]
    one, two = (np.sort(values[values > 0]) for values in maps)
    assert two == pytest.approx(np.repeat(one, 2), rel=1e-6)  # nodes of each body
    numbers = bonded.summary["bonds"]["one_two"], sticks.summary["interfaces"]["one_two"]
    for key in ("failure_index_max", "failure_index_p99", "failure_load_factor"):
        assert numbers[0][key] == pytest.approx(numbers[1][key], rel=1e-9)
        assert numbers[0][key] > 0
    assert numbers[0]["normal_mean"] == pytest.approx(-numbers[1]["pressure_mean"], rel=1e-9)
    assert numbers[0]["normal_max"] > numbers[0]["normal_mean"]
    assert numbers[0]["shear_mean"] == pytest.approx(numbers[1]["shear_mean"], rel=1e-9)
    last = bonded.step_record["one_two failure_index_p99 [-]"][-1]
    assert last == numbers[0]["failure_index_p99"]
    assert numbers[0]["failure_index_p99"] == pytest.approx(1 / numbers[0][key], rel=1e-12)


def test_bond_forces_load_factor_at_one_percent_failure(tmp_path: Path) -> None:
    """A bond under a moment times its load factor fails on a hundredth of its area."""
    supports = "supports={base: {kind: fixed, boundary: bottom}}"
    bent = "loads.bent={{kind: force, boundary: top, force: '[1, 0, 4] N', history: [{}]}}"
    first = support.run(BARS, tmp_path / "one", supports, bent.format(1.0))
    bond = first.summary["bonds"]["one_two"]
    assert bond["strength_fraction"] == 0.0
    factor = bent.format(bond["failure_load_factor"])
    again = support.run(BARS, tmp_path / "two", supports, factor)
    bond = again.summary["bonds"]["one_two"]
    assert bond["failure_index_p99"] == pytest.approx(1.0, rel=1e-9)
    assert bond["strength_fraction"] == pytest.approx(0.01, rel=1e-6)


@pytest.mark.parametrize(("pull", "fraction"), [(1.34, 0.0), (1.36, 1.0)])
def test_bond_forces_of_a_pulled_bar_reach_the_strength(
    tmp_path: Path, pull: float, fraction: float
) -> None:
    changes = ("supports.base={kind: fixed, boundary: bottom}", "interfaces={}")
    load = f"loads.up={{kind: pressure, boundary: top, pressure: {-pull} MPa}}"
    bond = support.run(BARS, tmp_path, *changes, load).summary["bonds"]["one_two"]
    assert bond["normal_mean"] == pytest.approx(pull, rel=1e-9)
    assert bond["normal_max"] == pytest.approx(pull, rel=1e-9)
    assert bond["shear_max"] == pytest.approx(0.0, abs=1e-8)
    assert bond["strength_fraction"] == fraction
    assert bond["area"] == pytest.approx(16.0)


def test_bond_forces_need_a_strength(tmp_path: Path) -> None:
    load = "loads.press={kind: pressure, boundary: top, pressure: 1 MPa}"
    base = "supports={base: {kind: fixed, boundary: bottom}}"
    for law in ("{kind: bonded}", CONTACT.partition("=")[2].replace(f", {STRENGTH}", "")):
        results = support.run(BARS, tmp_path / law[7:10], load, base, f"interfaces.one_two={law}")
        keys = {key for q in results.summary.get("bonds", {}).values() for key in q}
        keys |= {key for q in results.summary["interfaces"].values() for key in q}
        keys |= {*results.step_record, *results.fields.point_fields}
        assert "strength_fraction" not in results.summary["interfaces"].get("one_two", {})
        assert not [name for name in keys if "failure" in name]
