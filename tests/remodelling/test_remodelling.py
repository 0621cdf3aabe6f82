"""Remodelling of bone: equal cases, unchanged parts, bad input."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from app.campaigns.runs import runs_of
from app.case.case import load_case
from app.foundation.errors import InputError
from app.remodelling.intact_femur import values_in_nearest_cells
from app.remodelling.laws import remodelling_of
from app.results.reading import Run
from app.scene.scene import build_scene
from app.simulation.finished_runs import finished
from app.simulation.session import run
from app.soundness.preview import input_notes
from tests import support
from tests.cases.blocks import PULLED, bar

CASE = support.CONFIGS / "verification" / "remodelling.yaml"
SHORT = "stages.1.remodels=2 s"


def solved(folder: Path, *overrides: str, case: Path = CASE) -> Run:
    """Run a case; its results."""
    folder.mkdir()
    run(load_case(case, [*overrides, "output.report=false"]), folder)
    return Run(folder)


def end(folder: Path, *overrides: str) -> float:
    """Uniform density at the end of the block [g/cm3]."""
    rho = solved(folder, *overrides).on_cells("density")
    assert np.ptp(rho) < 1e-9
    return float(rho[0])


def test_remodelling_density_is_limited_to_the_largest(tmp_path: Path) -> None:
    """Published copies of the law set the density to the least one."""
    results = solved(tmp_path / "a", "loads.press.pressure=40 MPa")
    assert np.all(results.on_cells("density") == 1.74)
    mass = results.summary["remodelling"]["mass"]
    assert mass["cut"] < 0 < mass["added"] and abs(mass["audit"]) < 1e-10
    assert mass["end"] == pytest.approx(1.74e-3)
    assert results.step_record["bone mass [g]"][-1] == pytest.approx(1.74e-3)
    assert results.step_record["remodelled [s]"][-1] == pytest.approx(30.0)


def test_remodelling_stimulus_is_the_mean_of_energies(tmp_path: Path) -> None:
    """A load and its opposite act like each alone. Half of the load gives the mean of 1 and 1/4."""
    reverse = "stages=[{name: press}, {name: pull}, {name: time, remodels: 2 s}]"
    both = "remodelling.load_cases=[press, pull]"
    alone = end(tmp_path / "alone", SHORT)
    for name, factor, as_if in (("pull", -1.0, 3.0), ("half", 0.5, 3 * (5 / 8) ** 0.5)):
        factors = f"loads.press.history=[1, {factor}, 0]"
        density = end(tmp_path / name, reverse, both, factors)
        same = (
            alone
            if as_if == 3
            else end(tmp_path / "as", SHORT, f"loads.press.pressure={as_if} MPa")
        )
        assert density == pytest.approx(same, abs=1e-9)


def test_remodelling_in_other_units(tmp_path: Path) -> None:
    other = {
        "stimulus": "250 J/kg",
        "rate": "60 kg^2/(m^6 Pa min)",
        "density": "[10 kg/m^3, 1740 kg/m^3]",
        "tolerance": "10 kg/m^3",
    }
    a = remodelling_of(load_case(CASE).config)
    overrides = [f"remodelling.{key}={value}" for key, value in other.items()]
    b = remodelling_of(load_case(CASE, overrides).config)
    assert a == b and a is not None


def test_remodelling_unchanged_load_changes_nothing(tmp_path: Path) -> None:
    """The intact case has equal loads, so nothing changes. A tenth of the load removes bone."""
    text = CASE.read_text()
    intact = tmp_path / "intact.yaml"
    intact.write_text(
        text[: text.index("remodelling:")].replace("  - {name: time, remodels: 30 s}\n", "")
    )
    reference = ("remodelling.stimulus=", f"remodelling.intact={intact}", SHORT)
    grid = "regions.bone.youngs_modulus=[[0 mm, 16 MPa], [1 mm, 64 MPa]]"
    intact.write_text(intact.read_text().replace("64 MPa", "[[0 mm, 16 MPa], [1 mm, 64 MPa]]"))
    same = solved(tmp_path / "same", *reference, grid).summary["remodelling"]
    assert same["mass"]["added"] == 0.0 and same["mass"]["end"] == same["mass"]["start"]
    less = solved(tmp_path / "less", *reference, grid, "loads.press.pressure=0.3 MPa")
    assert less.summary["remodelling"]["mass"]["added"] < -1e-5
    # By a run's folder; and a message names what the intact case lacks.
    folder = tmp_path / "run"
    folder.mkdir()
    run(load_case(intact), folder)
    again = solved(
        tmp_path / "again", *reference[::2], f"remodelling.intact={folder}/case.yaml", grid
    )
    assert again.summary["remodelling"] == same
    with pytest.raises(
        InputError, match=r"remodelling.intact: .* has no stage stroll; it has press"
    ):
        stages = "stages=[{name: stroll}, {name: time, remodels: 2 s}]"
        solved(tmp_path / "x", *reference, stages, "remodelling.load_cases=[stroll]")


@pytest.mark.parametrize("order", [("soft", "stiff"), ("stiff", "soft")])
def test_remodelling_reference_is_found_by_region(order: tuple[str, str], tmp_path: Path) -> None:
    """The intact case may list its regions in another order; equal loads still change nothing.

    With E = 100 rho^2 a gram of the soft block has 2.8 times the energy of one of the stiff block.
    """
    moduli = {"soft": "32 MPa", "stiff": "64 MPa"}
    blocks = [{"name": name, "size": ["1 mm"] * 3} for name in moduli]
    changes = {"geometry.blocks": blocks, "interfaces": {"soft_stiff": {"kind": "bonded"}}}

    def regions(names: Iterable[str]) -> dict[str, object]:
        bone = {"poisson_ratio": 0.3, "tissue": "bone"}
        return {name: {"youngs_modulus": moduli[name], **bone} for name in names}

    intact = YAML(typ="safe").load(CASE)
    del intact["remodelling"]
    intact["stages"] = intact["stages"][:1]
    intact["geometry"]["blocks"], intact["interfaces"] = changes.values()
    intact["regions"] = regions(order)
    path = tmp_path / "intact.yaml"
    path.write_text(json.dumps(intact))
    mass = solved(
        tmp_path / "run",
        *(f"{key}={json.dumps(value)}" for key, value in changes.items()),
        f"regions={json.dumps(regions(moduli))}",
        "remodelling.stimulus=",
        f"remodelling.intact={path}",
        SHORT,
    ).summary["remodelling"]["mass"]
    assert mass["added"] == 0.0 and mass["end"] == mass["start"]


def test_remodelling_runs_depend_on_the_content_of_the_intact_case(tmp_path: Path) -> None:
    """Another modulus in the file makes another run; a newer file makes results old."""
    text = CASE.read_text()
    intact = tmp_path / "intact.yaml"
    intact.write_text(
        text[: text.index("remodelling:")].replace("  - {name: time, remodels: 30 s}\n", "")
    )
    overrides = ["remodelling.stimulus=", f"remodelling.intact={intact}", SHORT]
    loaded = load_case(CASE, [*overrides, "output.report=false"])
    out = tmp_path / "run"
    solved(out, *overrides)
    assert finished(out, loaded.config)
    ids = set()
    for modulus in ("64 MPa", "32 MPa"):
        intact.write_text(intact.read_text().replace("64 MPa", modulus))
        planned = [load_case(CASE, overrides).itself]
        ids |= {batch_run.id for batch_run in runs_of(planned, tmp_path, 1)}
    assert len(ids) == 2
    later = (out / "DONE").stat().st_mtime + 1
    os.utime(intact, (later, later))
    assert not finished(out, loaded.config)


def test_remodelling_bone_at_loads_and_supports_is_frozen(tmp_path: Path) -> None:
    results = solved(
        tmp_path / "a",
        SHORT,
        "remodelling.frozen=",
        "mesh.size=0.2 mm",
        "supports.floor={kind: fixed, boundary: bottom}",
    )
    z, rho = results.points[results.cells][:, :, 2], results.on_cells("density")
    at_ends = np.isclose(z, 0) | np.isclose(z, 1)
    assert rho[at_ends.all(axis=1)] == pytest.approx(0.8, abs=1e-14)
    assert np.all(rho[~at_ends.any(axis=1)] < 0.75)


def test_remodelling_long_filter_gives_uniform_stimulus(tmp_path: Path) -> None:
    """The stimulus is the mean energy per mass, so the density stays uniform under a local load."""
    plate = CASE.with_name("plate.yaml")
    shares = []
    for name, length in (("none", ""), ("long", "100 mm")):
        r = solved(tmp_path / name, SHORT, f"remodelling.filter={length}", case=plate)
        shares.append(float(np.ptp(r.on_cells("density"))))
    assert shares[1] < 1e-3 * shares[0]


def test_remodelling_density_follows_the_modulus() -> None:
    """A varying modulus of the case gives the density of the law, linear between vertices."""
    text = (
        PULLED
        + """
stages: [{name: pull}, {name: time, remodels: 1 s}]
remodelling: {load_cases: [pull], stimulus: 1 J/g, rate: 1 g^2/(cm^6 MPa s), lazy_zone: 0.5,
  law: {density: apparent, ranges: [[0 g/cm^3, 0 MPa, 1 GPa, 1]]},
  density: [0.1 g/cm^3, 1 g/cm^3]}
"""
    )
    for order in (1, 2):
        K = [
            support.assemble(support.case(t, f"mesh.order={order}"), bar(20))[0].stiffness.K
            for t in (PULLED, text)
        ]
        assert (K[0] - K[1]).norm() < 1e-12 * K[0].norm()


def test_remodelling_interpolates_from_another_mesh() -> None:
    """Values are linear within cells. Beyond the border they are those of its cells."""
    rng = np.random.default_rng(0)
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]], dtype=float)
    values = corners @ [1.0, 2.0, 3.0] + 4
    x = rng.dirichlet([1, 1, 1, 1], 20)[:, 1:]
    assert values_in_nearest_cells(corners, values, x) == pytest.approx(x @ [1.0, 2.0, 3.0] + 4)
    assert values_in_nearest_cells(corners, values, np.array([[2.0, 0, 0]])) == pytest.approx([5.0])


def test_remodelling_notes_a_missing_lazy_zone() -> None:
    assert not input_notes(load_case(CASE).config)
    (note,) = input_notes(load_case(CASE, ["remodelling.lazy_zone=0"]).config)
    assert "remodelling.lazy_zone is 0: if the modulus rises faster" in note.text


def test_remodelling_costs_nothing_if_absent() -> None:
    scene = build_scene(load_case(support.CONFIGS / "blocks.yaml").config)
    assert not scene.stiffness_varies and not scene.loads_of
    assert not any(e.varies for e in scene.elastic)


LAW = "remodelling.law={density: apparent, ranges: [[0 g/cm^3, 0 MPa, 100 MPa, "


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ("remodelling.density=[2 g/cm^3, 1 g/cm^3]", r"\.density: 2 is not below 1 g/cm\^3"),
        ("remodelling.stimulus=", r"remodelling: needs a reference: expected intact"),
        ("remodelling.stimulus=0 J/g", r"stimulus: 0 J/g must be positive"),
        ("remodelling.rate=-1 g^2/(cm^6 MPa s)", r"rate: .* must be positive"),
        ("remodelling.lazy_zone=1.5", r"lazy_zone: 1.5 must be at most 1"),
        ("remodelling.intact=nowhere.yaml", r"intact: no such file: .*nowhere.yaml"),
        ("remodelling.load_cases=[stride]", r"load_cases\[0\]: 'stride' is not an earlier stage"),
        ("remodelling.load_cases=[time]", r"load_cases\[0\]: 'time' is not an earlier stage"),
        ("remodelling.frozen=[skin]", r"remodelling.frozen\[0\]: 'skin' is not one of x_min"),
        ("remodelling.regions=[skin]", r"remodelling.regions: skin cannot remodel; expected"),
        (f"{LAW}-1]]}}", r"law: does not rise between the bounds"),
        (
            "regions.bone.youngs_modulus=1 GPa",
            r"regions.bone: has 3.162 g/cm\^3 .*; expected 0.01 to",
        ),
        ("remodelling=", r"stages\[1\].remodels: the law of remodelling is missing or wrong"),
        ("stages=[{name: press}]", r"stages: no stage has remodelling"),
        ("stages.1.duration=1 s", r"remodels: is the time of the stage"),
        (
            "stages.1.cycles=2",
            r"cycles: a stage with a duration cannot have cycles; use a stage without duration",
        ),
    ],
)
def test_remodelling_refuses_bad_input(overrides: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_case(CASE, [overrides])


def test_remodelling_with_zero_stimulus(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"stimulus: the smallest value is -0.5 J/g"):
        solved(tmp_path / "x", "remodelling.stimulus=x - 0.5")
