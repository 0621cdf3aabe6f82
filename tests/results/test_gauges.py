"""Strain gauges of runs: exact for linear displacements, order on a beam, ranks, wrong keys."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mantle
from app.foundation.errors import InputError
from tests import support

# u = G x with this gradient, prescribed on the whole surface [1e-3].
GRADIENT = np.array([[1.0, 2.0, 3.0], [2.0, -1.0, 0.0], [1.0, 4.0, 0.5]])
LINEAR = """
geometry: {kind: blocks, blocks: [{name: bar, size: [4 mm, 3 mm, 6 mm]}]}
mesh: {size: 2 mm, far_size: 2 mm}
regions: {bar: {youngs_modulus: 1 GPa, poisson_ratio: 0.3, tissue: other}}
supports:
  bottom: &linear {kind: displacement, boundary: bottom, x: "1e-3 * (x + 2*y + 3*z)",
    y: "1e-3 * (2*x - y)", z: "1e-3 * (x + 4*y + 0.5*z)"}
  top: {<<: *linear, boundary: top}
  left: {<<: *linear, boundary: x_min}
  right: {<<: *linear, boundary: x_max}
  front: {<<: *linear, boundary: y_min}
  back: {<<: *linear, boundary: y_max}
stages: [{name: load, increments: 2}]
output:
  error: true
  probes:
    tip: [1 mm, 1 mm, 3 mm]
    near: {kind: strain_gauge, boundary: x_max, at: "[4.2, 1.4, 2.9] mm", direction: [1, 5, 1],
      diameter: 1.5 mm}
    seen: {kind: strain_gauge, boundary: y_max, at: "[1.7, -3, 2] mm", towards: [0, 1, 0],
      direction: [0, 0, 1], diameter: 2 mm}
"""
# A rod, a tube on it, and a tube on that, of one material, strained evenly on the whole surface.
TUBES = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
  length: 24 mm, taper: 0 deg}
mesh: {size: 5 mm, far_size: 6 mm}
regions:
  stem: &material {youngs_modulus: 1 GPa, poisson_ratio: 0.3}
  cement: *material
  bone: *material
supports:
  bottom: &even {kind: displacement, boundary: bottom, x: -3e-4 * x, y: -3e-4 * y, z: 1e-3 * z}
  top: {<<: *even, boundary: top}
  outer: {<<: *even, boundary: bone_surface}
output:
  probes:
    axial: {kind: strain_gauge, boundary: bone_surface, at: "[0, 0, 12] mm", towards: [1, 0.3, 0],
      direction: [0.2, 0, 1], diameter: 3 mm}
    hoop: {kind: strain_gauge, boundary: bone_surface, at: "[0, 0, 9] mm", towards: [1, 2, 0],
      direction: [-2, 1, 0], diameter: 6 mm}
    across: {kind: strain_gauge, boundary: top, at: "[7, 0, 24] mm", direction: [0, 1, 0],
      diameter: 8 mm}
"""
# A cantilever of depth 2 c = 4 mm, loaded at its end, without Poisson's effect. With k = E:
# strain_zz = (L - z) x, strain_xz = (x^2 - c^2) / 2, x from the middle, times 1e-4.
BEAM = """
geometry: {kind: blocks, blocks: [{name: beam, size: [4 mm, 3 mm, 12 mm]}]}
mesh: {size: 4 mm, far_size: 4 mm}
regions: {beam: {youngs_modulus: 1 GPa, poisson_ratio: 0, tissue: other}}
supports:
  low: &bent {kind: displacement, boundary: bottom,
    x: "-1e-4 * (6 * z**2 - z**3 / 6 + 4 * z)", y: 0 mm,
    z: "1e-4 * ((12 * z - z**2 / 2) * (x - 2) + (x - 2)**3 / 3)"}
  high: {<<: *bent, boundary: top}
output:
  report: false
  error: true
  probes:
"""
GAUGE = """    at_{place}: {{kind: strain_gauge, boundary: x_max, at: "[4, {y}, {z}] mm",
      direction: [0, 0, 1], diameter: 1.6 mm}}
"""


@pytest.mark.parametrize("order", [1, 2])
def test_gauges_are_exact_for_linear_displacements(order: int, tmp_path: Path) -> None:
    """Means of d . strain d, and u at the centre, are exact at every step, with errors of zero."""
    results = support.run(LINEAR, tmp_path, f"mesh.order={order}")
    for name, d, x in (
        ("near", [0, 5, 1], [4, 1.4, 2.9]),
        ("seen", [0, 0, 1], [1.7, 3, 2]),
    ):
        along = np.array(d) / np.linalg.norm(d)
        strain = 1e-3 * along @ GRADIENT @ along
        numbers = results.summary["probes"][name]
        assert numbers["strain"] == pytest.approx(strain, rel=1e-9)
        assert numbers["displacement"] == pytest.approx(1e-3 * GRADIENT @ x, rel=1e-9)
        assert numbers["centre"] == pytest.approx(x)
        assert numbers["direction"] == pytest.approx(along)
        assert numbers["strain_error"] < 1e-12
        assert max(results.summary["probes"]["tip"]["displacement_error"]) < 1e-9
        course = results.step_record[f"{name} strain [-]"]
        assert course == pytest.approx([strain / 2, strain], rel=1e-9)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Probes and strain gauges" in page and "strain of gauges" in page


@pytest.mark.parametrize("curved", [False, True])
def test_gauges_on_round_bodies_measure_a_uniform_strain(curved: bool, tmp_path: Path) -> None:
    """The strain is 1e-3 along and -0.3e-3 around.

    Facets are straight and curved, over several regions.
    """
    results = support.run(TUBES, tmp_path, f"mesh.curved={str(curved).lower()}")
    strains = {name: probe["strain"] for name, probe in results.summary["probes"].items()}
    along = np.array(results.summary["probes"]["axial"]["direction"])
    inclined = 1e-3 * (along[2] ** 2 - 0.3 * (along[0] ** 2 + along[1] ** 2))
    expected = {"axial": inclined, "hoop": -0.3e-3, "across": -0.3e-3}
    assert strains == pytest.approx(expected, rel=1e-6)
    radius = np.hypot(*results.summary["probes"]["axial"]["centre"][:2])
    assert radius == pytest.approx(16, abs=1e-3 if curved else 0.3)


@pytest.mark.parametrize(
    ("order", "sizes", "least"), [(1, (2.0, 1.0, 0.7), 0.8), (2, (4.0, 2.0, 1.0), 1.8)]
)
def test_gauges_converge_on_a_beam(
    order: int, sizes: tuple[float, ...], least: float, tmp_path: Path
) -> None:
    """The strain is linear along the beam, so its mean is that at the centre, 2e-4 (12 - z).

    At least three quarters of the estimated errors contain the true one.
    """
    z = np.linspace(2.5, 9.5, 8)
    text = BEAM
    for place, height in enumerate(z):
        text += GAUGE.format(place=place, y=0.9 + 0.15 * place, z=height)
    errors = []
    contained = []
    for size in sizes:
        changes = (f"mesh.size={size} mm", f"mesh.far_size={size} mm", f"mesh.order={order}")
        probes = support.run(text, tmp_path / f"{size}", *changes).summary["probes"]
        strains = np.array([probe["strain"] for probe in probes.values()])
        off = strains - 2e-4 * (12 - z)
        errors.append(np.sqrt(np.mean((off / (2e-4 * (12 - z))) ** 2)))
        estimated = np.array([probe.get("strain_error", np.nan) for probe in probes.values()])
        contained += (np.abs(off) <= estimated)[np.isfinite(estimated)].tolist()
    assert np.mean(contained) >= 0.75
    assert errors[-1] < (0.1 if order == 1 else 0.002)
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] > least


@pytest.mark.parallel
def test_gauges_on_two_ranks_have_equal_numbers(tmp_path: Path) -> None:
    for name, text in (("linear", LINEAR), ("tubes", TUBES)):
        folder = tmp_path / name
        folder.mkdir()
        results = support.results_on_one_and_two_ranks(text, folder)
        one, two = (each.summary["probes"] for each in results)
        assert one.keys() == two.keys()
        for probe in one:
            for key in ("strain", "displacement", "centre", "direction"):
                if key in one[probe]:
                    assert two[probe][key] == pytest.approx(one[probe][key], rel=1e-7, abs=1e-12)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"diameter": "7 mm"},
            "diameter: 54 % of the circle .* beyond .* at most about 2.2 mm",
        ),
        ({"at": "[4, 2.9, 5.9] mm"}, "near.diameter: .* beyond the edge .* another place"),
        ({"at": "[9, 1, 3] mm"}, r"near.at: is 5 mm from x_max; .* \(4, 1, 3\) mm"),
        ({"direction": [1, 0, 0]}, "near.direction: is 90 degrees out of the surface"),
        ({"towards": [0, 0, 1]}, "near.towards: .* does not meet the surface; the surface fills"),
        ({"boundary": "side"}, "near.boundary: the geometry .* has no boundary 'side'"),
        ({"diameter": "0 mm"}, "near.diameter: "),
        ({"direction": [0, 0, 0]}, "near.direction: is the zero vector"),
        ({"kind": "gauge"}, "near.kind: .*point, strain_gauge"),
    ],
)
def test_gauges_wrong_keys_are_found_by_check(
    changes: dict[str, object], text: str, tmp_path: Path
) -> None:
    """Errors come before the solve."""
    (tmp_path / "case.yaml").write_text(LINEAR)
    overrides = {f"output.probes.near.{key}": value for key, value in changes.items()}
    with pytest.raises(InputError, match=text):
        mantle.check(mantle.load(tmp_path / "case.yaml", **overrides))


def test_gauges_faults_have_their_line(tmp_path: Path) -> None:
    """The line is that of the key in the file of the case."""
    line = next(k for k, text in enumerate(LINEAR.splitlines(), 1) if "diameter: 2 mm" in text)
    (tmp_path / "case.yaml").write_text(LINEAR.replace("diameter: 2 mm", "diameter: 9 mm"))
    with pytest.raises(InputError, match=rf"case\.yaml:{line}:\d+: output\.probes\.seen\.diameter"):
        mantle.check(mantle.load(tmp_path / "case.yaml"))


def test_gauges_need_bodies_that_deform(tmp_path: Path) -> None:
    text = """
geometry: {kind: blocks, blocks: [{name: wall, size: [4 mm, 4 mm, 5 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions:
  wall: {kind: conductor, tissue: other, thermal: {conductivity: 2 W/(m K), density: 1000 kg/m^3,
    specific_heat: 1000 J/(kg K), initial_temperature: 37 degC}}
heat: {stove: {kind: temperature, boundary: bottom, temperature: 80 degC}}
stages: [{name: rest, steady: true}]
output:
  probes:
    gauge: {kind: strain_gauge, boundary: top, at: "[2, 2, 5] mm", direction: [1, 0, 0],
      diameter: 2 mm}
"""
    (tmp_path / "case.yaml").write_text(text)
    with pytest.raises(InputError, match=r"probes\.gauge: every region is a conductor, which has "):
        mantle.load(tmp_path / "case.yaml")
