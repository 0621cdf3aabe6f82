"""Fields along paths in the files of a run, against formulas; on two ranks and after a restart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mantle
from app.foundation.errors import InputError
from app.results.reading import PathTable, Results
from app.system.folders import saved
from tests import support
from tests.cases.blocks import WALL

# Bent about y: u = (-(z^2 + nu (x^2 - y^2)) / 2, -nu x y, x z) / R, and sigma_zz = E x / R alone.
BENT = """
geometry: {kind: blocks, blocks: [{name: beam, size: [4 mm, 3 mm, 6 mm]}]}
mesh: {order: 2, size: 2 mm, far_size: 2 mm}
regions: {beam: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3, tissue: other}}
supports:
  low: &bent {kind: displacement, boundary: bottom, x: "-1e-4 * (z**2 + 0.3 * (x**2 - y**2)) / 2",
    y: "-1e-4 * 0.3 * x * y", z: "1e-4 * x * z"}
  high: {<<: *bent, boundary: top}
output:
  paths:
    across:
      kind: line
      start: "[-0.5, 0.7, 2.3] mm"
      end: "[4.5, 0.7, 3.1] mm"
      points: 21
      fields: [displacement.x, displacement.y, displacement.z, stress.zz, von_mises, displacement]
"""
# Stretched along z by 1 MPa: u = (-nu x, -nu y, z) / E.
BAR = """
geometry: {kind: blocks, blocks: [{name: bar, size: [4 mm, 4 mm, 6 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions: {bar: {youngs_modulus: 100 MPa, poisson_ratio: 0.3, tissue: other}}
supports:
  base: {kind: roller, boundary: bottom, axis: z}
  left: {kind: roller, boundary: x_min, axis: x}
  front: {kind: roller, boundary: y_min, axis: y}
loads: {pull: {kind: pressure, boundary: top, pressure: -1 MPa}}
stages: [{name: load, increments: 2}]
output:
  paths:
    up: {kind: line, start: "[1.3, 0.2, 0] mm", end: "[0.3, 2.2, 6] mm", points: 7,
      fields: [displacement.z, displacement.x, stress.zz, stress.xx, principal_max]}
    ring: {kind: section, region: bar, height: 3 mm, points: 17}
    round: {kind: circle, centre: "[2, 2, 3] mm", radius: 1 mm, points: 9, region: bar}
"""
# Two layers that cannot widen: sigma_xx = nu / (1 - nu) sigma_zz differs from layer to layer.
LAYERS = """
geometry: {kind: blocks, blocks: [{name: low, size: [4 mm, 4 mm, 3 mm]},
                                  {name: high, size: [4 mm, 4 mm, 3 mm]}]}
mesh: {order: 2, size: 2 mm, far_size: 2 mm}
regions:
  low: {youngs_modulus: 100 MPa, poisson_ratio: 0.2, tissue: other}
  high: {youngs_modulus: 900 MPa, poisson_ratio: 0.4, tissue: other}
supports:
  base: {kind: roller, boundary: bottom, axis: z}
  left: {kind: roller, boundary: x_min, axis: x}
  right: {kind: roller, boundary: x_max, axis: x}
  front: {kind: roller, boundary: y_min, axis: y}
  back: {kind: roller, boundary: y_max, axis: y}
loads: {press: {kind: pressure, boundary: top, pressure: 1 MPa}}
output:
  paths:
    up: {kind: line, start: "[1.3, 1.2, 0] mm", end: "[1.3, 1.2, 6] mm", points: 13,
      fields: [stress.zz, stress.xx]}
"""
# The wall with paths through its layers.
WALL_WITH_PATHS = (
    WALL
    + """\
output:
  paths:
    warm: {kind: line, start: "[1.1, 2.3, 0] mm", end: "[1.1, 2.3, 5] mm", region: hot}
    cool: {kind: line, start: "[1.1, 2.3, 5] mm", end: "[1.1, 2.3, 8] mm", region: cold}
"""
)
# A stem 5 um too thick in its cement and bone, in plane strain: Lame's shrink fit.
FIT = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
  length: 12 mm, taper: 0 deg}
mesh: {order: 2, size: 2 mm, far_size: 3 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2 GPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 2 GPa, poisson_ratio: 0.3}
interfaces: {stem_cement: {kind: contact, friction_coefficient: 0, gap: -0.005 mm}}
supports:
  below: {kind: roller, boundary: bottom, axis: z}
  above: {kind: roller, boundary: top, axis: z}
  outer: {kind: foundation, boundary: bone_surface, stiffness: 1e-4 MPa/mm}
  hold: {kind: foundation, boundary: stem_bottom, stiffness: 1 MPa/mm}
output:
  paths:
    around: {kind: section, interface: stem_cement, height: 5 mm, points: 33,
      fields: [pressure, slip, gap, status]}
    medial: {kind: side, interface: stem_cement, side: medial, region: cement,
      fields: [pressure, stress.xx, stress.yy]}
    posterior: {kind: side, interface: cement_bone, side: posterior, region: cement,
      fields: [stress.yy]}
    out: {kind: line, start: "[7, 0, 5] mm", end: "[16, 0, 5] mm", fields: [stress.xx, stress.yy]}
"""


def at_end(results: Results, name: str) -> PathTable:
    """Rows of a path at the last step."""
    table = results.paths[name]
    last = table["step"] == table["step"].max()
    return {title: values[last] for title, values in table.items()}


def places(path: PathTable) -> np.ndarray:
    """Positions (n, 3) [mm]."""
    return np.column_stack([path[f"{axis} [mm]"] for axis in "xyz"])


def test_path_tables_quadratic_displacement_is_exact(tmp_path: Path) -> None:
    """Bending at second order has linear stress, and a von Mises stress with a kink."""
    path = at_end(support.run(BENT, tmp_path), "across")
    x, y, z = places(path).T
    inside = (x >= 0) & (x <= 4)
    assert inside.sum() == 17 and (path["region"] == "beam").tolist() == inside.tolist()
    exact = {
        "displacement.x [mm]": -1e-4 * (z**2 + 0.3 * (x**2 - y**2)) / 2,
        "displacement.y [mm]": -1e-4 * 0.3 * x * y,
        "displacement.z [mm]": 1e-4 * x * z,
        "stress.zz [MPa]": 0.1 * x,
        "von_mises [MPa]": 0.1 * np.abs(x),
    }
    exact["displacement [mm]"] = np.sqrt(
        sum(exact[f"displacement.{axis} [mm]"] ** 2 for axis in "xyz")
    )
    for title, values in exact.items():
        assert path[title][inside] == pytest.approx(values[inside], abs=1e-9)
        assert np.isnan(path[title][~inside]).all()


@pytest.mark.parametrize("order", [1, 2])
def test_path_tables_linear_displacement_is_exact(order: int, tmp_path: Path) -> None:
    """A bar is under tension. Written steps and all kinds of paths through bodies are exact."""
    results = support.run(BAR, tmp_path, f"mesh.order={order}")
    table = results.paths["up"]
    assert np.unique(table["step"]).tolist() == [1, 2]
    for step, share in ((1, 0.5), (2, 1.0)):
        rows = table["step"] == step
        x, z = table["x [mm]"][rows], table["z [mm]"][rows]
        assert table["displacement.z [mm]"][rows] == pytest.approx(share * z / 100, abs=1e-11)
        assert table["displacement.x [mm]"][rows] == pytest.approx(-0.003 * share * x, abs=1e-11)
        assert table["stress.zz [MPa]"][rows] == pytest.approx(share, abs=1e-9)
        assert table["principal_max [MPa]"][rows] == pytest.approx(share, abs=1e-9)
        assert table["stress.xx [MPa]"][rows] == pytest.approx(0, abs=1e-9)
        assert table["arc length [mm]"][rows] == pytest.approx(np.sqrt(41) * z / 6, abs=1e-9)
    ring = at_end(results, "ring")
    x = places(ring)
    assert ring["arc length [mm]"] == pytest.approx(np.arange(17), abs=1e-9)
    # From the middle of x_max towards y, back to where it began.
    assert x[[0, 2, 4, 8, 12, 16]] == pytest.approx(
        np.array([[4, 2, 3], [4, 4, 3], [2, 4, 3], [0, 2, 3], [2, 0, 3], [4, 2, 3]]), abs=1e-6
    )
    u = np.sqrt((0.003 * x[:, 0]) ** 2 + (0.003 * x[:, 1]) ** 2 + 0.03**2)
    assert ring["displacement [mm]"] == pytest.approx(u, abs=1e-8)
    circle = at_end(results, "round")
    angle = np.linspace(0, 2 * np.pi, 9)
    exact = np.column_stack([2 + np.cos(angle), 2 + np.sin(angle), np.full(9, 3)])
    assert places(circle) == pytest.approx(exact, abs=1e-9)
    assert circle["von_mises [MPa]"] == pytest.approx(1, abs=1e-9)


def test_path_tables_stress_jumps_between_bonded_regions(tmp_path: Path) -> None:
    path = at_end(support.run(LAYERS, tmp_path), "up")
    assert path["stress.zz [MPa]"] == pytest.approx(-1, abs=1e-9)
    ratio = np.where(path["region"] == "low", 0.2, 0.4)
    assert set(path["region"]) == {"low", "high"}
    assert path["stress.xx [MPa]"] == pytest.approx(-ratio / (1 - ratio), abs=1e-9)


def test_path_tables_temperature_through_a_wall_is_exact(tmp_path: Path) -> None:
    """The temperature is linear in each layer. Each region has its side of the jump."""
    results = support.run(WALL_WITH_PATHS, tmp_path)
    flux = 60.0 / (5 / 2.0 + 1 / 0.4 + 3 / 0.5 + 1 / 0.2)  # mW/mm2
    warm, cool = at_end(results, "warm"), at_end(results, "cool")
    assert [*warm][-1] == "temperature [degC]"
    assert warm["temperature [degC]"] == pytest.approx(80 - flux * warm["z [mm]"] / 2, abs=1e-5)
    surface = 80 - flux * (5 / 2 + 1 / 0.4)
    exact = surface - flux * (cool["z [mm]"] - 5) / 0.5
    assert cool["temperature [degC]"] == pytest.approx(exact, abs=1e-5)


def test_path_tables_of_a_shrink_fit_follow_lame(tmp_path: Path) -> None:
    """Pressure is around and along the interface, radial and hoop stress through both rings."""
    results = support.run(FIT, tmp_path)
    a, b, nu = 7.0, 16.0, 0.3

    def inwards(E: float, inner: float) -> float:
        """Radial displacement of the surface at a by unit pressure, in plane strain."""
        if not inner:
            return (1 + nu) * (1 - 2 * nu) * a / E
        return (1 + nu) / E * (a**2 * a * (1 - 2 * nu) + a * b**2) / (b**2 - a**2)

    p = 0.005 / (inwards(110e3, 0.0) + inwards(2e3, a))
    around = at_end(results, "around")
    r = np.hypot(around["x [mm]"], around["y [mm]"])
    assert r == pytest.approx(a, rel=2e-4) and around["z [mm]"] == pytest.approx(5, abs=1e-3)
    assert around["arc length [mm]"][-1] == pytest.approx(2 * np.pi * a, rel=0.01)
    assert around["pressure [MPa]"] == pytest.approx(p, rel=0.02)
    assert around["gap [mm]"] == pytest.approx(0, abs=1e-9)
    assert set(around["status [-]"]) == {2.0}
    medial = at_end(results, "medial")
    assert medial["pressure [MPa]"] == pytest.approx(p, rel=0.03)
    assert medial["z [mm]"] == pytest.approx(np.linspace(0, 12, 101), abs=1e-6)
    assert medial["y [mm]"] == pytest.approx(0, abs=1e-6)
    assert set(medial["region"]) == {"cement"}
    ring = p * a**2 / (b**2 - a**2)
    hoop = ring * (1 + b**2 / a**2)
    # Stress at nodes varies from cell to cell; its mean along the path does not.
    assert medial["stress.xx [MPa]"].mean() == pytest.approx(-p, rel=0.1)
    assert medial["stress.yy [MPa]"].mean() == pytest.approx(hoop, rel=0.1)
    posterior = at_end(results, "posterior")
    assert posterior["y [mm]"] == pytest.approx(-11, abs=0.01)
    radial = ring * (1 - b**2 / 11**2)
    assert posterior["stress.yy [MPa]"].mean() == pytest.approx(radial, abs=0.05 * p)
    out = at_end(results, "out")
    x = out["x [mm]"]
    middle = (x > 8) & (x < 15)
    for title, sign in (("stress.xx [MPa]", -1), ("stress.yy [MPa]", 1)):
        exact = ring * (1 + sign * b**2 / x**2)
        assert np.abs(out[title] - exact)[middle].max() < 0.1 * p


@pytest.mark.parallel
def test_path_tables_on_two_ranks_have_equal_numbers(tmp_path: Path) -> None:
    """Every point of every kind of path has equal numbers of contact, bodies and heat."""
    for name, text in (("fit", FIT), ("bar", BAR), ("wall", WALL_WITH_PATHS)):
        folder = tmp_path / name
        folder.mkdir()
        one, two = (each.paths for each in support.results_on_one_and_two_ranks(text, folder))
        assert one.keys() == two.keys()
        for path in one:
            assert one[path]["region"].tolist() == two[path]["region"].tolist()
            for title in [title for title in one[path] if title != "region"]:
                largest = np.nanmax(np.abs(one[path][title]))
                assert two[path][title] == pytest.approx(
                    one[path][title], rel=1e-6, abs=1e-6 * largest + 1e-12, nan_ok=True
                )


def test_path_tables_continue_after_a_restart(tmp_path: Path) -> None:
    """Runs without field files continue too."""
    changes = {"output.fields": False, "output.checkpoint.steps": 1}
    (tmp_path / "case.yaml").write_text(BAR)
    case = mantle.load(tmp_path / "case.yaml", **changes)
    mantle.run(case, tmp_path / "out")
    whole = Results(tmp_path / "out").paths["up"]
    first = saved(tmp_path / "out")[-1]
    assert len(whole["step"]) == 2 * 7
    (tmp_path / "out" / "path_up.csv").unlink()
    mantle.run(case, tmp_path / "out", force=True, restart=str(first))
    again = Results(tmp_path / "out").paths["up"]
    for title in [title for title in whole if title != "region"]:
        assert again[title] == pytest.approx(whole[title], abs=1e-11)
    # A run of a case without this path removes its file.
    mantle.run(
        mantle.load(tmp_path / "case.yaml", **{"output.paths": {}}), tmp_path / "out", force=True
    )
    assert not [*(tmp_path / "out").glob("path_*.csv")]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"up": {"end": "[9, 9, 9] mm", "start": "[8, 8, 8] mm"}}, "up: lies outside every body"),
        (
            {"ring": {"height": "7 mm"}},
            r"ring: there is no region 'bar' at the height 7 mm; .* 6 mm",
        ),
        ({"round": {"radius": "5 mm"}}, "round: no point of the path is in region 'bar'; "),
        ({"up": {"fields": ["von_misses"]}}, r"up.fields.?0.?: this run has no field 'von_misses'"),
        ({"up": {"fields": ["temperature"]}}, "this run has no field 'temperature'"),
        ({"up": {"fields": ["stress"]}}, "a stress is six numbers; expected e.g. stress.xz"),
        ({"up": {"fields": ["von_mises.x"]}}, "von_mises has no components"),
        ({"ring": {"region": "rod"}}, "no region 'rod'"),
        ({"ring": {"kind": "side", "interface": "a_b", "side": "medial"}}, "no interface 'a_b'"),
    ],
)
def test_path_tables_wrong_keys_are_found_by_check(
    changes: dict[str, dict[str, object]], text: str, tmp_path: Path
) -> None:
    """Errors have the line of the file and come before the solve."""
    (tmp_path / "case.yaml").write_text(BAR)
    name, keys = next(iter(changes.items()))
    if "kind" in keys:
        overrides: dict[str, object] = {f"output.paths.{name}": keys}
    else:
        overrides = {f"output.paths.{name}.{key}": value for key, value in keys.items()}
    with pytest.raises(InputError, match=text):
        mantle.check(mantle.load(tmp_path / "case.yaml", **overrides))


def test_path_tables_outside_are_noted_with_their_stretch(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(BAR)
    change = {"output.paths.up.end": "[0.3, 2.2, 9] mm"}
    notes = mantle.check(mantle.load(tmp_path / "case.yaml", **change)).notes
    (note,) = [n for n in notes if n.where == "output.paths.up"]
    assert note.what.startswith("2 of its 7 points are outside every body (7.728 to 9.274 mm")


def test_path_tables_side_needs_a_stem(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(LAYERS)
    path = {"kind": "side", "interface": "low_high", "side": "medial"}
    case = mantle.load(tmp_path / "case.yaml", **{"output.paths": {"medial": path}})
    with pytest.raises(InputError, match=r"medial: geometry\.kind: blocks has no axis of a stem"):
        mantle.check(case)
