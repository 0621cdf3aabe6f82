"""Strength and fatigue: cycles of stress by hand, re-entrant edges, verdicts and notes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from app.case.case import load_case
from app.fatigue import findings
from app.fatigue.laws import Fatigue, Murphy, Power, Verdonschot, Weibull
from app.fatigue.risk import NEAR, distance_from_edges, reentrant_edges, tensions
from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.foundation.verdict import recorded
from app.report import step_curves
from app.results.verdicts import notes_of
from app.soundness import preview, result_notes
from tests import support

SPECTRUM = (support.CONFIGS / "verification/spectrum.yaml").read_text()
POWER = "{intercept: 8.77, slope: 4.68}"
QUIET = ("output.report=false", "output.fields=false")


def turned(*principal: float, angle: float = 0.3) -> Floats:
    """Stress with principal values about rotated axes (1, 3, 3)."""
    c, s = math.cos(angle), math.sin(angle)
    Q = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return (Q * principal @ Q.T)[None]


@pytest.mark.parametrize(
    ("peak", "valley", "expected"),
    [
        (turned(10, 2, 1), turned(1, 0, 0), (10, 1)),
        (turned(10, 2, 1), turned(-4, 0, 0), (10, 0)),  # compression does nothing
        (turned(-10, -2, -3), turned(-1, 0, 0), (0, 0)),
        (turned(-5, 0, 0), turned(7, 0, 0), (7, 0)),  # the plane of the largest tension of both
        (turned(10, 0, 0), turned(0, 6, 0), (10, 0)),  # on another plane
        (turned(10, 0, 0), turned(6, 0, 0, angle=0.3 + math.pi / 4), (10, 3)),
    ],
)
def test_fatigue_tensions_of_a_cycle(
    peak: Floats, valley: Floats, expected: tuple[float, float]
) -> None:
    np.testing.assert_allclose(np.ravel(tensions(peak, valley)), expected, atol=1e-12)


def test_fatigue_lives_by_two_laws() -> None:
    """Years of walking, stairs and stumbling by two laws: `laws.md` gives them with two digits."""
    years = {1.5: (82, 44), 3.0: (3.2, 21), 5.0: (0.29, 7.9), 7.0: (0.06, 3.0)}
    laws: list[Power | Murphy] = [Verdonschot(), Murphy(ratio=0.0)]
    for walking, known in years.items():
        spectrum = ((1e6, walking), (5e4, 1.1 * walking), (10, 2.2 * walking))
        for law, life in zip(laws, known, strict=True):
            damage = sum(n * law.damage(s) for n, s in spectrum)
            assert 1 / damage == pytest.approx(life, rel=0.02)
    assert Verdonschot().damage(0.0) == 0
    assert Murphy().damage(0.0) == 0


@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.5])
def test_fatigue_mean_stress(ratio: float) -> None:
    """A cycle at the law's stress ratio is unchanged; another is on the same line of Goodman."""
    f = {"spectrum": {"a": 1}, "laws": {"x": {"intercept": 8.77, "slope": 4.68}}}
    plain = Fatigue.model_validate(f)
    line = Fatigue.model_validate(f | {"goodman": "40 MPa"})
    law = Power.model_construct(ratio=ratio)
    for rule in (plain, line):
        assert rule.equivalent(law, 12.0, 12.0 * ratio) == pytest.approx(12.0)
    assert plain.equivalent(law, 12.0, 5.0) == pytest.approx(7.0 / (1 - ratio))
    s = line.equivalent(law, 12.0, 5.0)
    left = s * (1 - ratio) / 2 / (1 - s * (1 + ratio) / 2 / 40)
    assert left == pytest.approx(3.5 / (1 - 8.5 / 40))
    assert line.equivalent(law, 60.0, 30.0) == pytest.approx(80 / (1 + ratio))  # beyond the line
    assert line.equivalent(law, 0.0, 0.0) == 0


def test_fatigue_weibull_risk_of_a_volume() -> None:
    law = Weibull.model_validate(
        {"shape": 2, "scale": "2 MPa", "threshold": "3 MPa", "reference_volume": "4 mm^3"}
    )
    np.testing.assert_allclose(law.risk(np.array([-9.0, 3.0, 5.0, 7.0])), [0, 0, 0.25, 1.0])


def test_fatigue_reentrant_edges() -> None:
    """An L has a re-entrant edge, also in pieces. A bar has none, nor have facets around a stem."""
    edges = reentrant_edges(
        support.mesh(load_case(support.CONFIGS / "verification/corner.yaml").config), "corner"
    )
    length = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum()
    assert length == pytest.approx(1.0) and np.all(edges[..., :2] == 10.0)
    x = np.array([[10, 10, 0.5], [7, 6, 0.2], [10, 10, 3.0]])
    np.testing.assert_allclose(distance_from_edges(x, edges), [0, 5, 2], atol=1e-12)
    assert not len(reentrant_edges(support.mesh(support.case(SPECTRUM)), "bar"))
    around = support.mesh(support.case(support.STEM))
    assert not len(reentrant_edges(around, "cement")) and NEAR > 0


@pytest.mark.parametrize("region", ["lower", "upper"])
def test_fatigue_next_to_or_in_a_region_with_a_table_of_moduli(region: str, tmp_path: Path) -> None:
    """Without Poisson's ratio two blocks of other moduli have the stress of the load."""
    case = """
    geometry: {kind: blocks, blocks: [{name: lower, size: [2 mm, 2 mm, 2 mm]},
                                      {name: upper, size: [2 mm, 2 mm, 2 mm]}]}
    mesh: {order: 1, size: 1 mm}
    regions:
      lower: {youngs_modulus: [[0 mm, 1 GPa], [2 mm, 1 GPa]], poisson_ratio: 0}
      upper: {youngs_modulus: 2 GPa, poisson_ratio: 0}
    supports: {floor: {kind: fixed, boundary: bottom}}
    loads: {pull: {kind: pressure, boundary: top, pressure: -3 MPa}}
    stages: [{name: walking}]
    output: {report: false}
    """
    fatigue = f"fatigue={{region: {region}, spectrum: {{walking: 1e6}}, laws: {{p: {POWER}}}}}"
    results = support.run(case, tmp_path, fatigue)
    damage = results.fields.on_cells("damage_p")
    expected = 1e6 * 3**4.68 / 10**8.77
    np.testing.assert_allclose(damage[damage > 0], expected, rtol=1e-9)
    assert results.summary["fatigue"]["p"]["stress_p99"] == pytest.approx(3.0)


def test_fatigue_life_is_reported_as_a_range(tmp_path: Path) -> None:
    """Damage is in numbers, fields and the closing lines, with notes on laws and their use.

    One law on one mesh has no range, so it gives no years.
    """
    laws = "fatigue.laws={v: {kind: verdonschot_1997, measured: [7 MPa, 20 MPa]}}"
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    results = support.run(SPECTRUM, tmp_path / "one", laws)
    damage = (1e6 * 3**4.68 + 5e4 * 2.97**4.68 + 10 * 6.6**4.68) / 10**8.77
    np.testing.assert_allclose(results.fields.on_cells("damage_v"), damage, rtol=1e-9)
    s = results.summary
    assert s["fatigue"]["v"]["stress_p99"] == pytest.approx(6.6)
    notes = "; ".join(notes_of(s))
    assert "laws.v: Verdonschot and Huiskes 1997, from memory: check" in notes
    assert "laws.v: was measured at 7 to 20 MPa, and is used at 6.6 MPa" in notes
    (life,) = (v.text for v in recorded(s) if v.where == "fatigue")
    assert "the life is not shown without an uncertainty (over v)" in life
    case = support.case(SPECTRUM)
    assert not preview.input_notes(case)
    two = support.run(SPECTRUM, tmp_path / "two", *QUIET, "output.error=true").summary
    (life,) = (v.text for v in recorded(two) if v.where == "fatigue")
    assert "lasts 3.3 to 21 years, over power, logarithmic and mesh: for comparison" in life
    assert not [n for n in result_notes.of_results(case, two) if "measured" in n.text]
    q = {"damage_p99": 0.5, "damage_p99_error": 0.3}
    assert "lasts 1.2 to 5 years, over v and mesh" in findings.life({"v": q})
    open_end = findings.life({"v": q | {"damage_p99_error": 0.6}})
    assert "lasts at least 0.91 years; an upper limit is not resolved, over v" in open_end
    # Over 5 MPa nothing is left at 6.6 MPa but the whole; the curve falls to zero behind it.
    volumes = [s["regions"]["bar"][f"volume_over_{p}_MPa"] for p in (3, 5, 7, 9, 11)]
    assert volumes == pytest.approx([16, 16, 0, 0, 0])
    (panel,) = step_curves.tension(s)
    assert panel.lines[0].y == pytest.approx(volumes)


def test_fatigue_risk_that_grows_with_refinement_is_reported() -> None:
    on_meshes = {
        "a_edge.failure_risk": [[1, 3e-3], [2, 1e-3]],
        "a.failure_risk": [[1, 1e-3], [2, 3e-3]],
    }
    q = {"failure_probability": 2e-3, "edge": {"failure_risk": 0.03, "failure_probability": 0.031}}
    q["neck"] = {"von_mises_max": 1.0}  # of a stem
    line = findings._strength("a", q, on_meshes)
    expected = (
        "0.2 %, 3.1 % at its edge (failure_risk grows from 0.001 at 2 mm to 0.003 and may not "
        "converge)"
    )
    assert line.text.endswith(f"a fails with a probability of {expected}")
    assert line.tone == "doubtful" and not findings._strength("a", q, {}).tone


@pytest.mark.parametrize(("end", "is_refused"), [(10, True), (100, False)])
def test_fatigue_refuses_a_cycle_table_that_ends_below_its_peak(
    end: int, is_refused: bool, tmp_path: Path
) -> None:
    """The damage is that of the forces at the end of the stage. Tables act in the last stage."""
    table = tmp_path / "table.csv"
    table.write_text(f"time [s], factor [%]\n0, {end}\n0.5, 100\n0.8, 40\n1, {end}\n")
    force = f"force: [12 N, 0 N, 0 N], cycle_table: {table}"
    changes = (
        f"loads.pull={{kind: force, boundary: x_max, {force}}}",
        "stages=[{name: walking}, {name: stairs}]",
    )
    support.case(SPECTRUM, *changes, "fatigue.spectrum={walking: 1e6}")
    stairs = "fatigue.spectrum={stairs: 1e6}"
    if is_refused:
        words = r"spectrum\.stairs: loads\.pull ends its cycle table at 10 % of the largest force"
        with pytest.raises(InputError, match=words):
            support.case(SPECTRUM, *changes, stairs)
    else:
        support.case(SPECTRUM, *changes, stairs)
