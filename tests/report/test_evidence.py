"""Evidence of a run by credibility factors, and its methods."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from app.case import library
from app.case.credibility import CREDIBILITY_FACTORS
from app.foundation.errors import InputError
from app.report import evidence
from app.results.reading import Run
from tests import support

CHECK = {"outcome": "passed", "value": 1.0, "reference": 1.0, "order": None, "note": ""}
PATCH = CHECK | {"name": "patch", "group": "patch"}
COOK = CHECK | {"name": "cook", "group": "cook", "order": 1.8, "expected_order": 2.0}
LAME = CHECK | {"name": "lame", "group": "lame"}
HERTZ = CHECK | {"name": "hertz", "group": "hertz", "outcome": "failed", "value": 1.2}
RODS = CHECK | {"name": "rods", "group": "validation", "note": "pushed out of cement, 1999"}
DISC = CHECK | {"name": "disc", "group": "validation", "outcome": "missed"}


def written(
    run: Run, folder: Path, checks: list[dict[str, Any]], credibility: str = ""
) -> dict[str, Any]:
    """``evidence.json`` of a run with outcomes of problems and a section of its case."""
    shutil.copytree(run.folder, folder / "run")
    folders = [folder / "run"]
    if credibility:
        file = folder / "run" / "case.yaml"
        kept = {k: v for k, v in run.case.items() if k != "credibility"}
        file.write_text(json.dumps(kept)[:-1] + f", credibility: {credibility}}}")
    if checks:
        (folder / "verify").mkdir()
        (folder / "verify" / "verify.json").write_text(json.dumps(checks))
        folders.append(folder / "verify")
    page, file = evidence.write(folders)
    content: dict[str, Any] = json.loads(file.read_text())
    text = page.read_text()
    assert all(f["name"] in text for f in content["factors"])
    return content | {"by_key": {f["key"]: f for f in content["factors"]}, "page": text}


def test_evidence_grades_every_factor_by_the_run_alone(
    stems: tuple[Run, Run], tmp_path: Path
) -> None:
    content = written(stems[0], tmp_path, [])
    factors = content["by_key"]
    assert [f["number"] for f in content["factors"]] == list(range(1, 26))
    assert content["question"] == evidence.APPLICANT
    assert content["context_of_use"] == evidence.APPLICANT
    assert content["risk"] is None and {f["goal"] for f in factors.values()} == {None}
    assert factors["software_quality_assurance"]["grade"] == "b"
    assert factors["numerical_code_verification"]["grade"] is None
    assert factors["discretization_error"]["grade"] == "a"
    assert factors["discretization_error"]["missing"] == "for b: a run with --error"
    assert factors["numerical_solver_error"]["grade"] == "b"
    assert factors["input_uncertainties"]["grade"] == "a"  # the inputs have no status
    assert factors["output_agreement"]["grade"] is None
    assert factors["output_agreement"]["missing"].startswith("for a grade: no experiment was given")


@pytest.mark.parametrize(
    ("checks", "grade", "missing"),
    [
        ([PATCH, LAME], "c", "observed orders"),
        ([PATCH, LAME, COOK], "d", ""),
        ([PATCH, COOK], "a", "problems with known answers on contact"),
        ([PATCH, LAME, COOK, HERTZ], "a", "solutions within tolerance"),
    ],
)
def test_evidence_code_verification_needs_problems_of_the_equations_of_the_case(
    checks: list[dict[str, Any]],
    grade: str,
    missing: str,
    stems: tuple[Run, Run],
    tmp_path: Path,
) -> None:
    factor = written(stems[0], tmp_path, checks)["by_key"]["numerical_code_verification"]
    assert factor["grade"] == grade
    assert missing in factor["missing"]
    if COOK in checks:
        assert any("90% of the theoretical one" in text for text in factor["evidence"])
    if HERTZ in checks:
        assert "hertz: failed: 1.2, reference 1" in factor["evidence"]


def test_evidence_grades_agreement_by_the_outcomes_of_experiments(
    stems: tuple[Run, Run], tmp_path: Path
) -> None:
    inside = written(stems[0], tmp_path / "inside", [RODS])["by_key"]
    assert inside["output_agreement"]["grade"] == "c"
    assert inside["output_quantity"]["grade"] == "a"
    assert inside["condition_quantity"]["grade"] == "a"
    assert "rods: passed: 1, reference 1; pushed out of cement, 1999" in str(
        inside["output_agreement"]["evidence"]
    )
    missed = written(stems[0], tmp_path / "missed", [RODS, DISC])["by_key"]
    assert missed["output_agreement"]["grade"] == "a"
    assert missed["output_quantity"]["grade"] == "b"
    assert missed["condition_quantity"]["grade"] == "b"


def test_evidence_goals_follow_the_risk_and_claims_replace_grades(
    stems: tuple[Run, Run], tmp_path: Path
) -> None:
    claims = {
        "use_error": {"grade": "c", "text": "reviewed by N. N.", "links": ["report-12.pdf"]},
        "output_agreement": {"grade": "none", "text": "another subject"},
        "model_form": {"text": "see the appendix", "missing": "runs with creep"},
    }
    section = {"question": "How far?", "influence": "high", "consequence": "low"}
    stated = json.dumps(section | {"evidence": claims})
    content = written(stems[0], tmp_path, [RODS], stated)
    factors = content["by_key"]
    assert (content["question"], content["risk"]) == ("How far?", 3)
    use = factors["use_error"]
    assert (use["grade"], use["goal"], use["state"]) == ("c", "c", "reached")
    assert use["claim"] == "reviewed by N. N." and use["links"][-1] == "report-12.pdf"
    assert factors["output_agreement"]["grade"] is None
    assert factors["output_agreement"]["state"] == "below"
    assert factors["model_form"]["grade"] == "a"
    assert factors["model_form"]["missing"] == "for b: runs with creep"
    below = sum(f["state"] == "below" for f in factors.values())
    assert f"{25 - below} of 25 factors reach the grade proposed for this risk" in content["page"]


@pytest.mark.parametrize(
    ("risk", "goals"), [(1, "aaa"), (2, "abb"), (3, "bbc"), (4, "bcd"), (5, "bcd")]
)
def test_evidence_goal_is_the_same_part_of_each_scale(risk: int, goals: str) -> None:
    factors = ("output_quantity", "model_form", "use_error")  # of two, three and four grades
    assert "".join(CREDIBILITY_FACTORS[key].goal(risk) for key in factors) == goals


def test_evidence_links_of_the_repository_exist() -> None:
    links = [link for names in evidence.LINKS.values() for link in names]
    for context in library.read().data["contexts"].values():
        for claim in context["evidence"].values():
            links += claim.get("links", [])
    assert len(links) > 40
    assert [link for link in links if not (evidence.REPOSITORY / link).exists()] == []


@pytest.mark.parametrize(
    ("name", "risk"), [("mantle_thickness", 2), ("stem_finish", 3), ("iso_7206_4", 5)]
)
def test_evidence_contexts_of_the_library_replace_that_of_the_base(name: str, risk: int) -> None:
    case = support.case("base: stance\n", f"credibility.library={name}")
    stated = case.credibility
    assert stated.risk == risk
    assert "stands on one leg" not in stated.question
    assert stated.evidence and stated.influence_reason and stated.consequence_reason
    changed = support.case("base: stance\ncredibility: {library: stem_finish, influence: low}\n")
    assert changed.credibility.risk == 2


def test_evidence_methods_have_the_numbers_of_the_run(
    stems: tuple[Run, Run], tmp_path: Path
) -> None:
    shutil.copytree(stems[0].folder, tmp_path / "run")
    text = evidence.methods(tmp_path / "run").read_text()
    summary = support.summary(tmp_path / "run")
    for number in (
        f"{summary['solver']['dofs']} unknowns",
        "friction coefficient 0.4",
        "[300, 0, -900] N",
    ):
        assert number in text


def test_evidence_needs_a_finished_run(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no finished run"):
        evidence.write([tmp_path])
