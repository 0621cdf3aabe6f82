"""``mantle report`` on made-up sweeps: what it recognises, compares and judges, and its page."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from app.cli import main
from app.report import gruen, paper, paper_claims, paper_numbers, sweep_figures, sweep_report
from app.report import sweep_results as rs
from app.report.paper_claims import AGREES, DIFFERS, UNDECIDED
from app.report.sweep_results import PERCENTILES, Number
from app.schema import yaml_file

CONFIGS = Path(__file__).parents[2] / "configs"
MODULI = {"titanium": 110, "CoCr": 200}


def femur(stem: str = "titanium", thickness: float = 4.0, mu: float = 1.0) -> dict[str, Any]:
    """What reports read of a case."""
    return {
        "geometry": {"kind": "femur", "cement_thickness": f"{thickness:g} mm"},
        "mesh": {"size": "4 mm"},
        "regions": {"stem": {"youngs_modulus": f"{MODULI[stem]}000.0 MPa"}},
        "interfaces": {
            "stem_cement": {"kind": "contact", "friction_coefficient": 0.4},
            "cement_bone": {"friction_coefficient": mu, "conductance": "0.3 N/(mm s K)"},
        },
    }


class Maker:
    """Writes a sweep."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cases: list[dict[str, Any]] = []

    def add(
        self, name: str, data: dict[str, Any], summary: dict[str, Any] | None, **more: Any
    ) -> Path:
        run = self.folder / "runs" / f"r{len(self.cases)}"
        run.mkdir(parents=True)
        (run / "case.yaml").write_text(yaml_file.to_yaml(data))
        if summary is not None:
            (run / "summary.json").write_text(json.dumps(summary))
        entry = {"name": name, "part": "thickness", "overrides": {}, "status": "converged"}
        entry |= {"folder": f"runs/{run.name}", "exit_code": 0, "message": "", "seconds": 12.0}
        self.cases.append(entry | more)
        return run

    def stance(self, stem: str, thickness: float, mu: float, numbers: Any, **more: Any) -> Path:
        """A case of single-limb stance; numbers by interface."""
        name = more.pop("name", f"{stem} {thickness:g} {mu:g}")
        summary = None if numbers is None else {"interfaces": numbers} | more.pop("summary", {})
        return self.add(name, femur(stem, thickness, mu), summary, **more)

    def write(self, **more: Any) -> Path:
        content: dict[str, Any] = {"compare_with": "paper", "title": "made up", "file": "x.yaml"}
        content |= {"program": "0", "cores": 2, "seconds": 9, "cases": self.cases} | more
        (self.folder / "sweep.json").write_text(json.dumps(content))
        return self.folder


@pytest.fixture
def maker(tmp_path: Path) -> Maker:
    return Maker(tmp_path)


Law = Callable[[str, float, float, str], float]


def contact(law: Law, stem: str, t: float, mu: float, error: float) -> dict[str, Any]:
    """Numbers of both interfaces: the percentile by a law, the largest twice that."""
    found: dict[str, Any] = {}
    for place in ("cement_bone", "stem_cement"):
        found[place] = {"area": 100.0}
        found[place] |= {f"area_{q}_over_30um": 40.0 for q in ("slip", "motion")}
        found[place]["area_gap_over_30um"] = 1.0
        for quantity in PERCENTILES:
            unit = 1 if quantity in ("pressure", "shear") else 1e-3
            value = unit * law(stem, t, mu, f"{place}.{quantity}")
            part = PERCENTILES[quantity]
            found[place] |= {f"{quantity}_{part}": value, f"{quantity}_max": 2 * value}
            found[place][f"{quantity}_{part}_error"] = error * value
    return found


def as_the_paper_says(stem: str, t: float, mu: float, name: str) -> float:
    """Numbers for which every mechanical trend holds."""
    thin = 5.0 if t < 2.5 else 1.0
    name = name.replace("motion", "slip")
    return {
        "cement_bone.gap": 30 * thin * (0.5 + mu / 2),
        "cement_bone.slip": 60 * thin * (2 - mu),
        "cement_bone.pressure": 4 * (0.5 + mu / 2),
        "cement_bone.shear": 2.0,
        "stem_cement.gap": 60 * (2 - mu),
        "stem_cement.slip": 100 * (0.5 + mu / 2),
        "stem_cement.pressure": 7.0,
        "stem_cement.shear": 3.0,
    }[name]


def sweep(maker: Maker, law: Law, error: float) -> rs.SweepResults:
    for stem in MODULI:
        for t in (2.0, 3.0, 4.0, 5.0, 7.0):
            maker.stance(stem, t, 1.0, contact(law, stem, t, 1.0, error))
        for mu in (0.4, 0.7):
            maker.stance(stem, 4.0, mu, contact(law, stem, 4.0, mu, error))
    return rs.read(maker.write())


def verdicts(found: rs.SweepResults) -> dict[str, str]:
    return {t.name: t.verdict for t in paper_claims.judge(paper.Cases(found))}


# Numbers


@pytest.mark.parametrize(
    "number, text",
    [
        (Number(41.26, 1.83), "41.3 ± 1.8"),
        (Number(0.00123), "0.00123"),
        (Number(12345.6, 150.0), "12346 ± 150"),
        (Number(100.0, 3e-8), "100 ± 3e-08"),
        (Number(5.0, 0.0), "5"),
        (Number(0.01, 0.2), "0.01 ± 0.2"),
    ],
)
def test_a_number_is_as_long_as_its_error_allows(number: Number, text: str) -> None:
    assert str(number) == text


def test_a_statement_is_undecided_within_the_errors() -> None:
    assert paper_claims.exceeds(Number(3.0, 0.4), Number(2.0, 0.5)) == AGREES
    assert paper_claims.exceeds(Number(3.0, 0.5), Number(2.0, 0.5)) == UNDECIDED
    assert paper_claims.exceeds(Number(2.0, 0.4), Number(3.0, 0.5)) == DIFFERS
    assert paper_claims.exceeds(Number(3.0, 0.1), Number(2.0, 0.1), 2.0) == DIFFERS
    assert paper_claims.exceeds(Number(100.0), Number(100.0)) == DIFFERS
    assert paper_claims.exceeds(Number(100.0, 0.1), Number(100.0, 0.1)) == UNDECIDED
    assert paper_claims.alike(Number(1.0, 0.004), Number(1.01, 0.004), 0.02) == AGREES
    assert paper_claims.alike(Number(1.0, 0.02), Number(1.01, 0.02), 0.02) == UNDECIDED
    assert paper_claims.alike(Number(1.0, 0.02), Number(1.1, 0.02), 0.02) == DIFFERS


# The paper's cases


def test_the_papers_cases_are_those_of_the_parts_that_it_names(maker: Maker) -> None:
    """By stem, thickness and friction; of two that are alike the finer, then the first."""
    for t in (3.0, 4.0):
        maker.stance("titanium", t, 1.0, {})
    maker.add("finer", femur(), {}, unknowns=10)
    maker.add("again", femur(), {}, unknowns=10)
    maker.stance("CoCr", 4.0, 0.4, {}, part="friction")
    maker.stance("CoCr", 4.0, 1.0, {}, part="mine")
    found = paper.Cases(rs.read(maker.write()))
    names = {t: c.name for t, c in found.over("thickness", stem="titanium").items()}
    assert names == {3.0: "titanium 3 1", 4.0: "finer"}
    assert list(found.over("friction", stem="CoCr")) == [0.4]
    assert not paper.Cases(rs.read(maker.write(compare_with="")))


def test_shipped_parts_are_known(tmp_path: Path) -> None:
    """Every label is a part of the shipped sweep, and both readings are told by their override."""
    data = yaml_file.read(CONFIGS / "sweeps" / "paper.yaml").data["parts"]
    assert {*paper.MODELS, *paper.CAUSES} <= set(data)
    for part in ("hot", "slice"):
        assert [*data[part]["table"]["held"]] == ["heat.held"]


# Trends


@pytest.mark.parametrize(("error", "verdict"), [(1e-3, AGREES), (0.8, UNDECIDED)])
def test_trends_hold_where_numbers_are_as_the_paper_says(
    maker: Maker, error: float, verdict: str
) -> None:
    """Undecided where errors are as large; of heat there are no numbers."""
    found = verdicts(sweep(maker, as_the_paper_says, error))
    mechanical = dict.fromkeys(["T-a", "T-b", "T-c", "T-d", "T-e", "T-f"], verdict)
    assert found == mechanical | dict.fromkeys(["T-g", "T-h"], UNDECIDED)


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
def test_a_trend_does_not_hold_where_numbers_say_otherwise(
    maker: Maker, trend: str, factor: Law
) -> None:
    found = sweep(maker, lambda *of: as_the_paper_says(*of) * factor(*of), 1e-3)
    assert verdicts(found)[trend] == DIFFERS


def test_a_trend_that_differs_is_judged_again_where_a_cause_was_tried(maker: Maker) -> None:
    """Room in the canal makes thin mantles slip as the paper says; a smoother stem does not."""

    def shipped(stem: str, t: float, mu: float, name: str) -> float:
        return as_the_paper_says(stem, t, mu, name) * (0.3 if t < 2.5 and "slip" in name else 1.0)

    for part, law in (("canal", as_the_paper_says), ("interface", shipped)):
        for t in (2.0, 5.0):
            maker.stance("titanium", t, 1.0, contact(law, "titanium", t, 1.0, 1e-3), part=part)
    found = sweep(maker, shipped, 1e-3)
    trends = {t.name: t for t in paper_claims.judge(paper.Cases(found))}
    assert trends["T-b"].tried == (
        "causes tried: room in the canal (agrees), a smoother stem (differs)"
    )
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


def test_heat_is_judged_by_reading_and_told_after_ten_seconds(maker: Maker) -> None:
    for t in (2.0, 5.0):
        heated(maker, t, False, 60 + 6 * t, 48 + t)
        heated(maker, t, True, 100.0, 84 - t)
    found = rs.read(maker.write())
    cases = paper.Cases(found)
    assert verdicts(found)["T-g (slice, initial)"] == AGREES
    assert verdicts(found)["T-g (slice, held)"] == DIFFERS
    rows = [r for r in paper_numbers.compare(cases) if r.fact.id == "25"]
    assert [(r.case, r.peak) for r in rows] == [("initial 2", 72.0), ("held 2", 100.0)]
    # 72 over 76 degC, above the 37 degC of the body.
    assert rows[0].ratios[0] == pytest.approx(35 / 39)
    assert rows[1].number == Number(100.0, 0.1)


def test_tension_is_looked_for_where_the_cement_is_bonded(maker: Maker) -> None:
    data = femur()
    data["interfaces"]["cement_bone"] = {"kind": "bonded"}
    summary = {
        "interfaces": {"stem_cement": {"pressure_max": 4.0}},
        "bonds": {"cement_bone": {"normal_max": 6.0}},
    }
    maker.add("bonded", data, summary, part="cooled")
    found = rs.read(maker.write())
    assert verdicts(found)["T-h"] == AGREES
    summary["bonds"]["cement_bone"]["normal_max"] = -1.0
    (maker.folder / "runs" / "r0" / "summary.json").write_text(json.dumps(summary))
    assert verdicts(rs.read(maker.folder))["T-h"] == DIFFERS


# The comparison


def test_ratios_are_to_the_papers_numbers(maker: Maker) -> None:
    found = sweep(maker, as_the_paper_says, 0.05)
    cases = paper.Cases(found)
    rows = paper_numbers.compare(cases)
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


def test_peaks_are_of_the_whole_interface(maker: Maker) -> None:
    """As the paper's are; where they are stands beside the places that it names."""
    numbers = contact(as_the_paper_says, "titanium", 4.0, 1.0, 0.05)
    numbers["cement_bone"]["rim"] = {"gap_max": 0.3}
    gruen = zones(0.003, ("cement_bone",))
    gruen["7"]["interfaces"] = {"cement_bone": {"gap_max": 0.3}}
    maker.stance("titanium", 4.0, 1.0, numbers, summary={"gruen": gruen})
    rows = paper_numbers.compare(paper.Cases(rs.read(maker.write())))
    gap = next(r for r in rows if r.fact.id == "2")
    assert gap.peak == pytest.approx(300.0) and gap.number == Number(30.0, 1.5)
    assert gap.remark == "mantle: largest proximal medial"
    assert "proximal medial" in gap.fact.remark


# Zones and mantles


def zones(density: float, places: tuple[str, ...]) -> dict[str, Any]:
    numbers = {"gap_max": 0.02, "gap_mean": 0.01}
    return {
        str(z): {
            "strain_energy_density": {"cortical_bone": z * density},
            "interfaces": dict.fromkeys(places, numbers),
        }
        for z in range(1, 15)
    }


def test_stress_shielding_is_against_the_femur_without_a_stem(maker: Maker) -> None:
    both = ("stem_cement", "cement_bone")
    for stem, density in (("titanium", 0.003), ("CoCr", 0.002)):
        summary = {"gruen": zones(density, both)}
        for t in (3.0, 4.0):
            maker.stance(stem, t, 1.0, {}, summary=summary)
    data = femur()
    del data["regions"]["stem"]
    maker.add("intact", data, {"gruen": zones(0.004, ())})
    found = rs.read(maker.write())
    without = gruen.intact(found.cases)
    assert without is not None and without.name == "intact"
    change = gruen.shielding(found.cases[1], without)
    assert set(change) == {"cortical_bone"}
    assert list(change["cortical_bone"].values()) == pytest.approx([-0.25] * 14)
    head, rows = gruen.table(found.cases[0])
    assert len(rows) == 14 and len(head) == len(rows[0]) == 1 + 10 + 1
    assert rows[6][:2] == ["7 (frontal)", "20.0 / 10.0"] and rows[7][0] == "8 (lateral)"
    page = sweep_report.run(maker.folder)[0][0].read_text()
    assert "Stress shielding" in page and "14 (lateral)" in page


def test_mantles_are_told_once_each_by_thickness(maker: Maker) -> None:
    for stem in MODULI:
        for t in (5.0, 3.0):
            thickness = {"nominal": t, "min": 0.5, "median": t, "clipped_fraction": 0.25}
            summary = {"mantle": {"thickness": thickness, "volume": 1e4 * t, "cortex_min": 2.5}}
            maker.stance(stem, t, 1.0, {}, summary=summary)
    head, rows = gruen.mantles(rs.read(maker.write()).cases)
    assert [row[2] for row in rows] == ["3", "5"] and {row[0] for row in rows} == {"femur"}
    assert dict(zip(head, rows[0], strict=True))["cement (cm³)"] == "30"
    assert "25 %" in rows[0] and "-" in rows[0] and rows[0][-1] == "2.5"


# The page


def test_the_pages_need_nothing_else(maker: Maker, capsys: pytest.CaptureFixture[str]) -> None:
    sweep(maker, as_the_paper_says, 1e-3)
    assert main(["report", str(maker.folder)]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^T-a +agrees \(by maxima agrees\) ", said, re.M)
    assert "14 of 14 cases have results" in said
    assert f"{maker.folder / 'report.html'}, and 6 files in" in said
    page = (maker.folder / "paper.html").read_text()
    written = {f.name for f in (maker.folder / "report").iterdir()}
    figures = {f"figure{n}.{kind}" for n in range(3, 8) for kind in ("png", "svg", "pdf")}
    assert written == figures
    first = (maker.folder / "report.html").read_text()
    assert "paper.html" in first and "Rakotomanana" not in first
    sources = re.findall(r'<img[^>]* src="([^"]{0,30})', page)
    assert len(sources) == 5 and all(s.startswith("data:image/png;base64,") for s in sources)
    text = re.sub(r'data:image/png;base64,[^"]*', "", page)
    # The one script opens what is folded before the page is printed.
    assert not re.search(r"https?:|<script(?!>addEventListener\(.beforeprint)|<link", text)
    assert all(href.startswith("#") for href in re.findall(r'href="([^"]*)"', text))
    assert '<td class="n">120</td>' in text  # the largest slip, beside the paper's 67 µm
    assert "figure 8: no case of hot cement" in text


def test_a_partial_sweep_is_reported_with_what_is_missing(maker: Maker) -> None:
    numbers = contact(as_the_paper_says, "titanium", 4, 1, 0.1)
    maker.stance("titanium", 4.0, 1.0, numbers)
    maker.stance("titanium", 3.0, 1.0, numbers)
    maker.stance("titanium", 2.0, 1.0, None, status="stopped", exit_code=5)
    maker.stance("CoCr", 4.0, 1.0, None, status="failed", exit_code=3, message="<b>no</b>")
    gone = {"name": "gone", "folder": "runs/none", "status": "converged"}
    gone["numbers"], gone["errors"] = {"cement_bone.slip_p99": 0.05}, {"cement_bone.slip_p99": 0.01}
    maker.cases.append(gone)
    files, _, cases = sweep_report.run(maker.write())
    page = files[0].read_text()
    assert (sum(c.done for c in cases), len(cases)) == (3, 5)
    assert "Without results: titanium 2 1, CoCr 4 1" in page
    assert "its folder has no summary.json" in page and "50 ± 10" in page
    papers = files[1].read_text()
    assert "figure 6: no stem at two frictions" in papers and "the case CoCr 4 1 failed" in papers
    assert "it wrote no fields" in page and "Gruen" not in page
    assert "&lt;b&gt;no&lt;/b&gt;" in page and "<b>" not in page


def test_another_sweep_is_drawn_over_what_varies(maker: Maker) -> None:
    """And not compared with the paper, though its cases are the paper's: nobody asked."""
    data = femur()
    for taper in (1.0, 2.0, 3.0):
        numbers = contact(lambda *a, x=taper: x, "", 0, 0, 0.1)
        keys = {"geometry.taper": f"{taper:g} deg", "title": "x", "mesh.size": "4 mm"}
        more = {"overrides": keys}
        maker.add(f"taper {taper:g}", data, {"interfaces": numbers}, **more)
    files, trends, _ = sweep_report.run(maker.write(compare_with=""))
    assert [f.name for f in files] == ["report.html", "over_geometry_taper.png"]
    page = files[0].read_text()
    assert not trends and "Rakotomanana" not in page
    assert "Numbers over taper" in page and "cement-bone slip, p99" in page
    assert "taper (°): 1, 2, 3." in page and "mesh.size" not in page  # the same in all
    assert page.count('role="img"') == 10 and "data:image" not in page
    run = rs.read(maker.folder).cases[1].folder
    (run / "report.html").touch()
    sweep_report.run(maker.folder)
    assert f'<a href="runs/{run.name}/report.html">taper 2</a>' in files[0].read_text()
    assert page.index("What varies") < page.index("All cases")
    for name in ("over_old.png", "mine.png"):
        (maker.folder / "report" / name).write_text("")
    sweep_report.run(maker.folder)
    left = {f.name for f in (maker.folder / "report").glob("*.png")}
    assert left == {"over_geometry_taper.png", "mine.png"}


def test_mantles_are_compared_by_what_they_achieve_within_a_part(maker: Maker) -> None:
    """Whatever keys of the geometry make them: here canals and stems."""
    for part, key, means in (
        ("clipped", "taper", (2.0, 2.6)),
        ("cavity", "stem_width", (2.1, 4.0)),
    ):
        for mu in (0.4, 1.0):
            for nominal, mean in zip((2, 4), means, strict=True):
                own = {f"geometry.{key}": nominal, "geometry.cement_thickness": f"{nominal} mm"}
                own["interfaces.cement_bone.friction_coefficient"] = mu
                thickness = {"nominal": nominal, "mean": mean, "clipped_fraction": 4.0 - mean}
                more = {
                    "part": part,
                    "overrides": own,
                    "summary": {"mantle": {"thickness": thickness}},
                }
                numbers = contact(lambda *a, x=mean: x, "", 0, 0, 0.1)
                maker.stance("titanium", nominal, mu, numbers, name=f"{part}{mean}{mu}", **more)
    cases = rs.read(maker.write()).cases
    groups = sweep_figures._groups(cases, sweep_figures.ACHIEVED)
    assert [(name.split(":")[0], [*own]) for name, own in groups] == [
        *[("clipped", [2.0, 2.6])] * 2,
        *[("cavity", [2.1, 4.0])] * 2,
    ]
    drawn = str(sweep_figures.multiples(cases, None)[0])
    assert "Numbers over achieved mean thickness" in drawn
    for case in cases:
        case.summary["mantle"]["thickness"]["clipped_fraction"] = 0.0
    assert "achieved" not in str(sweep_figures.multiples(cases, None)[0])


@pytest.mark.parametrize(
    ("key", "written", "words", "numbers"),
    [
        ("geometry.cement_thickness", ["4 mm", "2 mm"], "cement thickness (mm): 4, 2", [4, 2]),
        ("geometry.length", ["500 um", "0.2 cm"], "length (mm): 0.5, 2", [0.5, 2]),
        ("interfaces.a_b.gap", ["5 um", "20 um"], "gap, a b (µm): 5, 20", [5, 20]),
        ("heat.a.T", ["0 degC", "300 K"], "a temperature (K): 273.15, 300", [273.15, 300]),
        ("interfaces.a_b.gap", [0.2, 1], "gap, a b (mm): 0.2, 1", [0.2, 1]),
        ("interfaces.a_b.gap", ["0.02 * z", "1 mm"], "gap, a b: 0.02 * z, 1 mm", [None, 1]),
        ("mesh.curved", [True, False], "mesh curved: True, False", [None, None]),
        ("a.b", [{"kind": "c", "m": m} for m in (1, 2)], "a b: 2 of c", [None, None]),
    ],
)
def test_levels_are_numbers_in_one_unit(
    key: str, written: list[Any], words: str, numbers: list[float | None]
) -> None:
    """That of the schema where the sweep has several."""
    key = key.replace(".T", ".temperature")
    cases = [rs.SweptCase(str(x), Path(), "converged", "", {key: x}) for x in written]
    assert sweep_figures.axes_in_words(cases) == [f"{words}."]
    assert sweep_figures.levels(cases, key)[1] == pytest.approx(numbers)


def test_rank_correlations_find_the_key_that_matters(maker: Maker) -> None:
    """Slip that grows with the taper alone: +1 with it in any unit, nothing with the length."""
    data = femur()
    for taper, written in ((1.0, "1 deg"), (2.0, "2 deg"), (3.0, "0.05236 rad")):
        for length in (20.0, 30.0):
            numbers = contact(lambda *a, x=taper: x**3, "", 0, 0, 0.1)
            keys = {"geometry.taper": written, "geometry.length": f"{length:g} mm"}
            name = f"{taper:g} {length:g}"
            maker.add(name, data, {"interfaces": numbers}, overrides=keys)
    head, rows = sweep_figures.sensitivity(rs.read(maker.write(compare_with="")).cases)
    assert len(head) == 2 and rows
    for name, words in rows:
        assert name.startswith("thickness: ")
        assert words == ["+1.00 taper", "+0.00 length"]
    for case in (cases := rs.read(maker.folder).cases):  # the same without numbers
        case.overrides["geometry.taper"] = {"kind": case.overrides["geometry.taper"]}
    assert sweep_figures.sensitivity(cases)[1][0][1] == ["+1.00 taper", "+0.00 length"]
    # With one key alone a curve says it.
    assert sweep_figures.sensitivity(rs.read(maker.folder).cases[::2])[1] == []
    # The page begins with the range of the first numbers and with what they depend on.
    page = sweep_report.run(maker.folder)[0][0].read_text()
    lead = page[page.index('"lead">') : page.index('class="summary"')]
    assert "Over all cases: cement-bone debonding, p99 from 1 µm (1 20) to 27 µm (3 30); " in lead
    assert "(+1.00) thickness: cement-bone debonding, p99 depends most on taper." in lead


# What is no sweep


@pytest.mark.parametrize(
    "content, complaint",
    [
        (None, "has no sweep.json"),
        ('{"cases": [', "sweep.json: cannot be read: JSONDecodeError"),
        ('{"cases": []}', "sweep.json: has no cases"),
        ('{"cases": [{"name": "a", "status": "failed"}]}', "cannot be read: KeyError('folder')"),
    ],
)
def test_what_is_no_sweep_is_refused(
    tmp_path: Path, content: str | None, complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / "sweep.json").write_text(content)
    assert main(["report", str(tmp_path)]) == 2
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "report.html").exists()
