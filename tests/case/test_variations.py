"""Variations of a case in one run: allowed keys, order, independence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.case.case import Case, dump, load_case
from app.foundation.errors import InputError
from tests import support
from tests.cases import coupled
from tests.cases.varied_stem import STEM, Runs

MU = "interfaces.stem_cement.friction_coefficient"
SECTION = f"""
variations:
  as_is: {{}}
  fit: {{interfaces.stem_cement.gap: -0.002 mm}}
  mu2_900: {{{MU}: 0.2, loads.down.force: "[0, 0, -900] N"}}
  mu2_1200: {{{MU}: 0.2, loads.down.force: "[0, 0, -1200] N"}}
  mu2_600: {{{MU}: 0.2, loads.down.force: "[0, 0, -600] N"}}
  mu4_900: {{{MU}: 0.4, loads.down.force: "[0, 0, -900] N"}}
  mu4_1200: {{{MU}: 0.4, loads.down.force: "[0, 0, -1200] N"}}
  mu4_600: {{{MU}: 0.4, loads.down.force: "[0, 0, -600] N"}}
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "case.yaml"
    path.write_text(text)
    return path


# What may vary


def test_variations_star_is_every_name(tmp_path: Path) -> None:
    """The star stands for all names of the file, so all loads grow together."""
    section = "variations: {twice: {'loads.*.history': [2, 2]}}\n"
    (twice,) = load_case(written(tmp_path, STEM + section)).variations
    assert [load.history for load in twice.case.loads.values()] == [(2, 2), (2, 2)]
    assert twice.overrides == ("loads.down.history=[2, 2]", "loads.aside.history=[2, 2]")
    bad = "variations: {a: {interfaces.*.friction_coefficient: -1}}\n"
    path = written(tmp_path, STEM + bad)
    with pytest.raises(InputError) as caught:
        load_case(path)
    start = f"{path}:28:18: variations.a.interfaces.*.friction_coefficient: -1 must"
    assert [m.startswith(start) for m in caught.value.messages] == [True]


def test_variations_equal_cases_with_set(tmp_path: Path) -> None:
    """Overrides of a variation act like options of the case without variations."""
    path = written(tmp_path, STEM + SECTION)
    variations = load_case(path, ["title=mine"]).variations
    assert [v.name for v in variations][:3] == ["as_is", "fit", "mu2_900"] and len(variations) == 8
    for v in variations:
        alone = load_case(path, ["title=mine", "variations={}", *v.overrides]).config
        assert v.case == alone and v.case.title == "mine"
        assert "variations" not in dump(v.case)
    assert variations[1].case.interfaces["stem_cement"].gap == -0.002  # type: ignore[union-attr]
    assert variations[-1].case.loads["down"].force == (0, 0, -600)  # type: ignore[union-attr]


def test_variations_refuse_set_of_their_keys(tmp_path: Path) -> None:
    """Sweeps and studies refuse such keys too."""
    path = written(tmp_path, STEM + SECTION)
    option = "interfaces.stem_cement={kind: contact, friction_coefficient: 0.5}"
    with pytest.raises(InputError) as caught:
        load_case(path, [option])
    places = ["fit.interfaces.stem_cement.gap"]
    places += [f"mu{m}_{f}.{MU}" for m in "24" for f in (900, 1200, 600)]
    for message, place in zip(caught.value.messages, places, strict=True):
        refusal = (
            f" variations.{place}: varies, but --set interfaces.stem_cement fixes it for every case"
        )
        assert refusal in message
    assert load_case(path, [option, "variations={}"]).config


# Each: the section, and the expected message, with line and column below `variations`.
WRONG = {
    "mesh": ("  a: {mesh.size: 2 mm}", "2:7: variations.a.mesh.size: cannot vary between runs"),
    "material": ("  a: {regions.stem.youngs_modulus: 1 GPa}", "2:7: variations.a.regions.stem"),
    "support": ("  a: {supports.foot.kind: fixed}", "2:7: variations.a.supports.foot.kind"),
    "place of a load": ("  a: {loads.down.boundary: stem_top}", "2:7: variations.a.loads.down"),
    "stages": ("  a: {stages.0.increments: 2}", "2:7: variations.a.stages.0.increments: cannot"),
    "typing error": ("  a: {loads.down.hystory: [1, 1]}", "did you mean 'history'?"),
    "no such interface": (
        "  a: {interfaces.cement_stem.friction_coefficient: 1}",
        "2:7: variations.a.interfaces.cement_stem.friction_coefficient: interfaces.cement_stem",
    ),
    "value": (f"  a: {{{MU}: -1}}", f"2:7: variations.a.{MU}: -1 must not be negative"),
    "grid": (f"  grid: {{{MU}: [0.2, 0.2]}}", "2:3: variations.grid: a grid stands in a sweep"),
    "no mapping": ("  a: 3", "2:3: variations.a: 3 is not a mapping"),
    "name": ("  2nd: {}", "'2nd' is not a name"),
}


@pytest.mark.parametrize("what", WRONG)
def test_variations_refuse_keys_of_mesh_and_stiffness(what: str, tmp_path: Path) -> None:
    section, expected = WRONG[what]
    start = STEM.count("\n")
    path = written(tmp_path, STEM + "variations:\n" + section + "\n")
    with pytest.raises(InputError) as caught:
        load_case(path)
    (message,) = caught.value.messages[:1]
    if expected[0].isdigit():
        line, _, rest = expected.partition(":")
        expected = f"{path}:{start + int(line)}:{rest}"
        assert message.startswith(expected), message
    assert expected in message
    if "may not" in expected:
        assert "allowed: interfaces.<name>" in message and "loads.<name>.force" in message


# What they give


def changed(*overrides: str) -> Case:
    return support.case(STEM, *overrides)


CASES = {
    "as_is": changed(),
    "loose": changed(f"{MU}=0.2"),
    "smooth": changed(f"{MU}=0"),
    "heavy": changed("loads.down.force=[0, 0, -1300] N", "loads.aside.force=[250, 0, 0] N"),
    "fit": changed("interfaces.stem_cement.gap=-0.002 mm"),
    "open": changed("interfaces.stem_cement.gap=0.001 mm", f"{MU}=0.5"),
    "tied": changed("interfaces.cement_bone={kind: bonded}"),
    "damped": changed("solver.augmentation_factor=0.1"),
    "soft": changed(
        "interfaces.cement_bone={kind: penalty, friction_coefficient: 0.2, penalty: 1e4 MPa/mm}"
    ),
}


def test_variations_are_independent_of_order_and_company() -> None:
    """Variations run forward, backward and each alone."""
    alone = {name: Runs().run(case) for name, case in CASES.items()}
    for names in (list(CASES), list(CASES)[::-1]):
        runs = Runs()
        for name in names:
            numbers, expected = runs.run(CASES[name])[0], alone[name][0]
            for u, v in zip(numbers, expected, strict=True):
                assert np.abs(u - v).max() < 1e-8 * np.abs(v).max(), name
        # One mesh and, but for the tied one, one set of matrices.
        one, other = runs.last._other_models
        assert one.tagged is other.tagged


def test_variations_with_scaled_loads_take_no_iterations() -> None:
    """Contact with friction is homogeneous, so all results follow from one load."""
    runs = Runs()
    u, iterations, numbers = runs.run(CASES["as_is"])
    assert len(iterations) == 3 and sum(iterations) > 5
    # Also from another time: here it is the answer.
    v, again, _ = runs.run(changed("stages.0.increments=2"))
    assert again == [0, 0, 0, 0]
    assert support.difference(v[0], u[0]) < 1e-12
    heavy = changed("loads.down.force=[0, 0, -1800] N", "loads.aside.force=[400, 0, 0] N")
    v, again, double = runs.run(heavy)
    assert again == [0, 0, 0]
    assert support.difference(v[0], 2 * u[0]) < 1e-12
    q, p = double["interfaces"]["stem_cement"], numbers["interfaces"]["stem_cement"]
    # Dissipation is of second degree.
    assert q["dissipation"] == pytest.approx(4 * p["dissipation"], rel=1e-10)
    assert q["slip_path_max"] == pytest.approx(2 * p["slip_path_max"], rel=1e-10)


def test_variations_warm_start_saves_iterations() -> None:
    """A start from another coefficient of friction takes fewer iterations than one from rest."""
    runs = Runs()
    taken = [sum(runs.run(changed(f"{MU}={μ}"))[1]) for μ in (0.3, 0.35, 0.4, 0.45)]
    alone = sum(Runs().run(changed(f"{MU}=0.45"))[1])
    assert taken[0] > 0.8 * alone and 0 < taken[-1] < 0.8 * alone


def test_variations_companions_share_their_mesh() -> None:
    """The error companion of the second variation has the mesh and matrices of the first."""
    runs = Runs()
    for override in (f"{MU}=0.4", f"{MU}=0.3"):
        runs.run(changed(override))
        coarse = changed(override, "mesh.size=6 mm", "mesh.far_size=6 mm")
        numbers = runs.last.numbers_of_companion(coarse)
        assert len(runs.last._other_models) == 2
        alone = Runs()
        expected = alone.run(coarse)[2]["interfaces"]["stem_cement"]["slip_p99"]
        slip = numbers["interfaces"]["stem_cement"]["slip_p99"]
        assert slip == pytest.approx(expected, rel=1e-8)


def test_variations_of_conductance_in_coupled_cases() -> None:
    """The mechanics are reused, at rest and at the initial temperature."""
    key = "interfaces.lower_upper.conductance.per_pressure"
    cases = [
        support.case(coupled.CASE, f"{key}={value} W/(m^2 K MPa)", "stages[1].increments=2")
        for value in (400, 100, 800)
    ]
    runs = Runs()
    for case in cases:
        (u, v), _, numbers = runs.run(case)
        (u0, v0), _, expected = Runs().run(case)
        assert support.difference(u, u0) < 1e-8 and support.difference(v, v0) < 1e-8
        for region in ("lower", "upper"):
            ours = numbers["thermal"]["regions"][region]["temperature_mean"]
            theirs = expected["thermal"]["regions"][region]["temperature_mean"]
            assert ours == pytest.approx(theirs, rel=1e-8)
    assert len(runs.last._other_models) == 1
