"""``docs/paper`` on made-up sweeps with the numbers of the paper, or with others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.case.number_text import Number
from app.report import sweep_results as rs
from app.schema import yaml_file
from docs.paper import cases as paper
from docs.paper import claims, compare
from docs.paper.claims import AGREES, DIFFERS, UNDECIDED
from tests.report.sweeps import MODULI, Law, Maker, as_the_paper_says, contact, femur, sweep, zones
from tests.support import CONFIGS


@pytest.fixture
def maker(tmp_path: Path) -> Maker:
    return Maker(tmp_path)


def verdicts(results: rs.SweepResults) -> dict[str, str]:
    return {t.name: t.verdict for t in claims.judge(paper.Cases(results))}


def test_paper_statement_is_undecided_within_errors() -> None:
    assert claims.exceeds(Number(3.0, 0.4), Number(2.0, 0.5)) == AGREES
    assert claims.exceeds(Number(3.0, 0.5), Number(2.0, 0.5)) == UNDECIDED
    assert claims.exceeds(Number(2.0, 0.4), Number(3.0, 0.5)) == DIFFERS
    assert claims.exceeds(Number(3.0, 0.1), Number(2.0, 0.1), 2.0) == DIFFERS
    assert claims.exceeds(Number(100.0), Number(100.0)) == DIFFERS
    assert claims.exceeds(Number(100.0, 0.1), Number(100.0, 0.1)) == UNDECIDED
    assert claims.alike(Number(1.0, 0.004), Number(1.01, 0.004), 0.02) == AGREES
    assert claims.alike(Number(1.0, 0.02), Number(1.01, 0.02), 0.02) == UNDECIDED
    assert claims.alike(Number(1.0, 0.02), Number(1.1, 0.02), 0.02) == DIFFERS


# The paper's cases


def test_paper_cases_are_those_of_named_parts(maker: Maker) -> None:
    """A case is found by stem, thickness and friction.

    Of two similar cases the finer one counts, then the first.
    """
    for t in (3.0, 4.0):
        maker.stance("titanium", t, 1.0, {})
    maker.add("finer", femur(), {}, unknowns=10)
    maker.add("again", femur(), {}, unknowns=10)
    maker.stance("CoCr", 4.0, 0.4, {}, part="friction")
    maker.stance("CoCr", 4.0, 1.0, {}, part="mine")
    cases = paper.Cases(rs.read(maker.write()))
    names = {t: c.name for t, c in cases.over("thickness", stem="titanium").items()}
    assert names == {3.0: "titanium 3 1", 4.0: "finer"}
    assert list(cases.over("friction", stem="CoCr")) == [0.4]


def test_paper_parts_are_shipped() -> None:
    """Every label is a part of the shipped sweep. The override distinguishes the two readings."""
    data = yaml_file.read(CONFIGS / "sweeps" / "paper.yaml").data["parts"]
    assert {*paper.MODELS, *paper.CAUSES} <= set(data)
    for part in ("hot", "slice"):
        assert [*data[part]["table"]["held"]] == ["heat.held"]


# Trends


@pytest.mark.parametrize(("error", "verdict"), [(1e-3, AGREES), (0.8, UNDECIDED)])
def test_paper_trends_hold_for_its_numbers(maker: Maker, error: float, verdict: str) -> None:
    """Trends are undecided if errors are as large. There are no numbers of heat."""
    judged = verdicts(sweep(maker, as_the_paper_says, error))
    mechanical = dict.fromkeys(["T-a", "T-b", "T-c", "T-d", "T-e", "T-f"], verdict)
    assert judged == mechanical | dict.fromkeys(["T-g", "T-h"], UNDECIDED)


@pytest.mark.parametrize(
    ("trend", "factor"),
    [
        ("T-a", lambda s, t, mu, n: 1.1 if s == "titanium" and "slip" in n else 1.0),
        ("T-b", lambda s, t, mu, n: 0.3 if t < 2.5 and "slip" in n else 1.0),
        ("T-c", lambda s, t, mu, n: 2.0 if t > 6 and n == "stem_cement.shear" else 1.0),
        ("T-d", lambda s, t, mu, n: mu**2 if n == "cement_bone.slip" else 1.0),
        ("T-e", lambda s, t, mu, n: mu**2 if n == "stem_cement.gap" else 1.0),
        ("T-f", lambda s, t, mu, n: 2.0 if n == "cement_bone.shear" else 1.0),
    ],
)
def test_paper_trend_fails_for_other_numbers(maker: Maker, trend: str, factor: Law) -> None:
    results = sweep(maker, lambda *of: as_the_paper_says(*of) * factor(*of), 1e-3)
    assert verdicts(results)[trend] == DIFFERS


def test_paper_trend_is_judged_again_with_causes(maker: Maker) -> None:
    """Room in the canal makes thin mantles slip like the paper's; a smoother stem does not."""

    def shipped(stem: str, t: float, mu: float, name: str) -> float:
        return as_the_paper_says(stem, t, mu, name) * (0.3 if t < 2.5 and "slip" in name else 1.0)

    for part, law in (("canal", as_the_paper_says), ("interface", shipped)):
        for t in (2.0, 5.0):
            maker.stance("titanium", t, 1.0, contact(law, "titanium", t, 1.0, 1e-3), part=part)
    results = sweep(maker, shipped, 1e-3)
    trends = {t.name: t for t in claims.judge(paper.Cases(results))}
    assert trends["T-b"].tried == "room in the canal (agrees), a smoother stem (differs)"
    assert trends["T-c"].verdict == AGREES and not trends["T-c"].tried


def heated(maker: Maker, thickness: float, held: bool, cement: float, bone: float) -> None:
    data = femur("CoCr", thickness)
    regions = {"cement": {"temperature_max": 100.0, "temperature_max_error": 0.1}, "bone": {}}
    bones = {"temperature_max_second": bone, "temperature_max_second_error": 0.1}
    thermal = {"regions": regions, "interfaces": {"cement_bone": bones}}
    name, more = f"{'held' if held else 'initial'} {thickness:g}", {"part": "slice"}
    overrides = {"heat.held": {"kind": "temperature"}} if held else {}
    run = maker.add(name, data, {"thermal": thermal}, overrides=overrides, **more)
    rows = [(5.0, 99.0), (10.0, cement), (11.0, cement - 1), (600.0, 40.0)]
    text = "seconds [s],cement temperature_max [degC],bone temperature_max [degC]\n"
    text += "".join(f"{s},{T},{bone - 1}\n" for s, T in rows)
    (run / "history.csv").write_text(text)


def test_paper_heat_is_judged_by_reading(maker: Maker) -> None:
    for t in (2.0, 5.0):
        heated(maker, t, False, 60 + 6 * t, 48 + t)
        heated(maker, t, True, 100.0, 84 - t)
    results = rs.read(maker.write())
    cases = paper.Cases(results)
    assert verdicts(results)["T-g (slice, initial)"] == AGREES
    assert verdicts(results)["T-g (slice, held)"] == DIFFERS
    rows = [r for r in compare.compare(cases) if r.fact.id == "25"]
    assert [(r.case, r.peak) for r in rows] == [("initial 2", 72.0), ("held 2", 100.0)]
    # 72 over 76 degC, above the 37 degC of the body.
    assert rows[0].ratios[0] == pytest.approx(35 / 39)
    assert rows[1].number == Number(100.0, 0.1)


def test_paper_tension_of_bonded_cement(maker: Maker) -> None:
    data = femur()
    data["interfaces"]["cement_bone"] = {"kind": "bonded"}
    summary = {
        "interfaces": {"stem_cement": {"pressure_max": 4.0}},
        "bonds": {"cement_bone": {"normal_max": 6.0}},
    }
    maker.add("bonded", data, summary, part="cooled")
    results = rs.read(maker.write())
    assert verdicts(results)["T-h"] == AGREES
    summary["bonds"]["cement_bone"]["normal_max"] = -1.0
    (maker.folder / "runs" / "r0" / "summary.json").write_text(json.dumps(summary))
    assert verdicts(rs.read(maker.folder))["T-h"] == DIFFERS


# The comparison


def test_paper_ratios_are_to_its_numbers(maker: Maker) -> None:
    results = sweep(maker, as_the_paper_says, 0.05)
    cases = paper.Cases(results)
    rows = compare.compare(cases)
    assert list(dict.fromkeys(r.fact.id for r in rows)) == [str(i) for i in range(1, 31)]
    slip = next(r for r in rows if r.fact.id == "1")
    assert slip.case == "titanium 4 1"
    assert slip.peak == pytest.approx(120.0)
    assert slip.number is not None
    assert (slip.number.value, slip.number.error) == pytest.approx((60.0, 3.0))
    assert slip.ratios == pytest.approx((120 / 67, 60 / 67))
    both = [(r.fact.stem, r.thickness) for r in rows if r.fact.id == "24"]
    assert both == [(stem, t) for stem in MODULI for t in (4.0, 5.0, 7.0)]
    bound = next(r for r in rows if r.fact.id == "7")
    assert bound.ratios == (None, None) and "40 % of the area" in bound.remark
    for id in ("23", "25", "29"):
        nothing = next(r for r in rows if r.fact.id == id)
        assert not nothing.case and nothing.remark


def test_paper_maxima_are_of_the_whole_interface(maker: Maker) -> None:
    """Peaks are compared over the whole interface. The page gives their Gruen zone."""
    numbers = contact(as_the_paper_says, "titanium", 4.0, 1.0, 0.05)
    numbers["cement_bone"]["rim"] = {"gap_max": 0.3}
    gruen = zones(0.003, ("cement_bone",))
    gruen["7"]["interfaces"] = {"cement_bone": {"gap_max": 0.3}}
    maker.stance("titanium", 4.0, 1.0, numbers, summary={"gruen": gruen})
    rows = compare.compare(paper.Cases(rs.read(maker.write())))
    gap = next(r for r in rows if r.fact.id == "2")
    assert gap.peak == pytest.approx(300.0) and gap.number == Number(30.0, 1.5)
    assert gap.remark == "mantle: largest proximal medial"
    assert "proximal medial" in gap.fact.remark


def test_paper_figures_and_tables_are_written(
    maker: Maker, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep(maker, as_the_paper_says, 1e-3)
    maker.stance("CoCr", 2.0, 1.0, None, status="failed", exit_code=3, unknowns=9)
    compare.main(maker.write())
    written = [maker.folder / f"figure{n}.png" for n in range(3, 8)] + [maker.folder / "paper.md"]
    assert capsys.readouterr().out.split() == [str(path) for path in written]
    text = written[-1].read_text()
    assert (
        "| T-a | At the cement-bone interface the stem's material does not matter | agrees |"
        in text
    )
    assert (
        "| 1 | titanium | 4 | cement-bone | slip | 67 µm | 120 | 60.000 ± 0.060 | 1.8 | 0.9 |"
        in text
    )
    assert "the case CoCr 2 1 failed" in text and "Over 20 peaks of single-limb stance" in text
