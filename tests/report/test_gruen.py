"""Gruen zones in reports: stress shielding, mantles by thickness."""

from __future__ import annotations

import pytest

from app.report import gruen, pictures, sweep_figures, sweep_report
from app.report import sweep_results as rs
from tests.report.sweeps import MODULI, Maker, contact, femur, zones

# Zones and mantles


def test_gruen_errors_are_marked_as_in_tables(maker: Maker) -> None:
    """0.7 ± 0.84 is not resolved; the error of a zone may be unknown beside those of others."""
    summary = {"gruen": zones(0.003, ())}
    errors = {"1": 0.0008, "2": 0.0084}
    for zone, error in errors.items():
        summary["gruen"][zone]["strain_energy_density_error"] = {"cortical_bone": error}
    maker.stance("titanium", 3.0, 1.0, {}, summary=summary)
    (_, _, rows), *_ = gruen.tables(rs.read(maker.write()).cases[0])
    assert [row[1] for row in rows[:3]] == [
        "3.00 ± 0.80",
        "6 ± 8.4 (not resolved)",
        "9 (error unknown)",
    ]


def test_gruen_stress_shielding_is_relative_to_the_intact_femur(
    maker: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    both = ("stem_cement", "cement_bone")
    for stem, density in (("titanium", 0.003), ("CoCr", 0.002)):
        summary = {"gruen": zones(density, both)}
        for t in (3.0, 4.0):
            maker.stance(stem, t, 1.0, {}, summary=summary)
    data = femur()
    del data["regions"]["stem"]
    maker.add("intact", data, {"gruen": zones(0.004, ())})
    results = rs.read(maker.write())
    without = gruen.intact(results.cases)
    assert without is not None and without.name == "intact"
    change = gruen.shielding(results.cases[1], without)
    assert set(change) == {"cortical_bone"}
    assert list(change["cortical_bone"].values()) == pytest.approx([-0.25] * 14)
    tables = {title: (head, rows) for title, head, rows in gruen.tables(results.cases[0])}
    assert [*tables] == ["Bone", "cement-bone interface", "stem-cement interface"]
    assert tables["Bone"][1][6] == ["7 (frontal)", "21"]
    head, rows = tables["stem-cement interface"]
    assert len(rows) == 14
    assert len(head) == 1 + 1
    assert len(rows[0]) == 1 + 1
    assert rows[6][:2] == ["7 (frontal)", "20.0 / 10.0"] and rows[7][0] == "8 (lateral)"
    monkeypatch.setattr(pictures, "ends", lambda s: [(c.name, c) for c in s.cases[1::2]])
    page = sweep_report.run(maker.folder)[0][0].read_text()
    assert "Stress shielding" in page and "14 (lateral)" in page


def test_gruen_mantles_are_listed_by_thickness(maker: Maker) -> None:
    for stem in MODULI:
        for t in (5.0, 3.0):
            thickness = {"nominal": t, "min": 0.5, "median": t, "clipped_fraction": 0.25}
            summary = {"mantle": {"thickness": thickness, "volume": 1e4 * t, "cortex_min": 2.5}}
            maker.stance(stem, t, 1.0, {}, summary=summary)
    head, rows = gruen.mantles(rs.read(maker.write()).cases)
    assert [row[2] for row in rows] == ["3", "5"] and {row[0] for row in rows} == {"femur"}
    assert dict(zip(head, rows[0], strict=True))["cement (cm³)"] == "30"
    assert "25 %" in rows[0] and "-" in rows[0] and rows[0][-1] == "2.5"


def test_gruen_mantles_are_compared_by_achieved_thickness(maker: Maker) -> None:
    """The keys of the geometry do not matter: here canals and stems."""
    for part, key, means in (
        ("clipped", "taper", (2.0, 2.6)),
        ("cavity", "stem_width", (2.1, 4.0)),
    ):
        for mu in (0.4, 1.0):
            for nominal, mean in zip((2, 4), means, strict=True):
                overrides = {
                    f"geometry.{key}": nominal,
                    "geometry.cement_thickness": f"{nominal} mm",
                }
                overrides["interfaces.cement_bone.friction_coefficient"] = mu
                thickness = {"nominal": nominal, "mean": mean, "clipped_fraction": 4.0 - mean}
                more = {
                    "part": part,
                    "overrides": overrides,
                    "summary": {"mantle": {"thickness": thickness}},
                }
                numbers = contact(lambda *a, x=mean: x, "", 0, 0, 0.1)
                maker.stance("titanium", nominal, mu, numbers, name=f"{part}{mean}{mu}", **more)
    cases = rs.read(maker.write()).cases
    groups = sweep_figures._groups(cases, sweep_figures.ACHIEVED)
    assert [(name.split(":")[0], [*overrides]) for name, overrides in groups] == [
        *[("clipped", [2.0, 2.6])] * 2,
        *[("cavity", [2.1, 4.0])] * 2,
    ]
    drawn = str(sweep_figures.draw_over_keys(cases, None)[0])
    assert "Numbers over achieved mean thickness" in drawn
    for case in cases:
        case.summary["mantle"]["thickness"]["clipped_fraction"] = 0.0
    assert "achieved" not in str(sweep_figures.draw_over_keys(cases, None)[0])
