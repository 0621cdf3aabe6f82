"""Evidence for a referee or an authority: credibility factors of a run, and methods.

The factors, their grades and the goals for a risk are those of `app.case.credibility`. The program
grades what the run and the given folders show. Claims of the case add what only a person knows.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypedDict

import configs
from app.case import credibility, number_text, summary_numbers
from app.case.case import Case, load_case
from app.case.credibility import CREDIBILITY_FACTORS, RISKS, FactorName, Grade
from app.case.geometries import MeshFile
from app.case.library import ORIGIN
from app.case.quantities import TABLE
from app.case.summary import Summary
from app.foundation.errors import InputError
from app.foundation.layout import plain_text, several
from app.foundation.verdict import Severity, recorded
from app.laws.loads import AnyLoad
from app.laws.materials import Material
from app.report import input_spread, page
from app.report.input_spread import InputSpread
from app.report.page import Block, Link, PageSection
from app.report.sweep_results import CONVERGED, SweptCase
from app.results.reading import Results
from app.results.verdicts import CONTACT, EQUILIBRIUM, HEAT, PEAKS
from app.schema.section import Section
from app.system.folders import read_json, write_json, write_text

if TYPE_CHECKING:
    from app.results.run_folder import Provenance

APPLICANT = "the applicant writes this"
NO_COMPARATOR = "no experiment was given: mantle validate -o FOLDER, then FOLDER after the run"
# Outcome of a prediction without a measurement to compare with.
NOT_MEASURED = "predicted"
# Top folder of the repository. An installed program has only its packages there.
REPOSITORY = configs.FOLDER.parent
STANDARD = "ASME V&V 40-2018 with the guidance of the FDA of 17 November 2023"

_EXPERIMENTS = (
    "docs/validation/README.md",
    "docs/validation/predictions.json",
    "app/validation",
    "configs/validation",
)
# Files of the repository with evidence for a factor.
LINKS: Mapping[FactorName, tuple[str, ...]] = {
    "software_quality_assurance": (
        "CONTRIBUTING.md",
        "CHANGELOG.md",
        "tests/README.md",
        ".ci/run",
        "tests/project/test_layering.py",
        "tests/verification/test_mutations.py",
        "tests/robustness",
    ),
    "numerical_code_verification": (
        "docs/verification.md",
        "app/verification/problems",
        "configs/verification",
        "tests/verification/test_formulation_b.py",
        "tests/simulation/test_calculix.py",
    ),
    "discretization_error": (
        "docs/howto/error.md",
        "docs/error_estimate.py",
        "configs/studies/stance.yaml",
        "tests/results/test_error_estimate.py",
    ),
    "numerical_solver_error": (
        "tests/results/test_balance.py",
        "tests/mechanics/test_point_laws_augmentation.py",
        "tests/numerics/test_newton.py",
        "configs/studies/stance_penalty.yaml",
    ),
    "use_error": (
        "tests/command_line/bad_input.yaml",
        "tests/soundness/test_well_posedness.py",
        "tests/soundness/test_preview.py",
    ),
    "model_form": ("docs/theory.md", "docs/paper.md", "docs/notebook.md"),
    "input_sensitivities": ("configs/sweeps/inputs.yaml", "configs/sweeps/sobol.yaml"),
    "input_uncertainties": (
        "docs/sources.md",
        "configs/sweeps/inputs.yaml",
        "docs/howto/many-runs.md",
    ),
    "sample_quantity": _EXPERIMENTS,
    "condition_quantity": _EXPERIMENTS,
    "input_equivalency": _EXPERIMENTS,
    "output_agreement": _EXPERIMENTS,
    "relevant_quantities": ("docs/howto/evidence.md",),
    "relevant_validation": ("docs/howto/evidence.md",),
    "calibration": ("docs/sources.md", "docs/validation/README.md"),
    "result_uncertainty": ("docs/howto/error.md", "configs/sweeps/inputs.yaml"),
}


class Check(TypedDict):
    """Outcome of a problem in ``verify.json`` or ``validate.json``: the entries used here."""

    name: str
    group: str
    outcome: str
    value: float | None
    reference: float | None
    order: float | None
    expected_order: float | None
    note: str


@dataclass(frozen=True)
class Evidence:
    """The data from which factors are graded.

    Attributes:
        case: The case of the run.
        summary: Its ``summary.json``.
        record: Its ``provenance.json``.
        verified: Outcomes of problems with known answers.
        validated: Outcomes of comparisons with experiments.
        run: The run as a case of a sweep.
        spread: Numbers of the run over uncertain inputs; None if no sweep was given.
    """

    case: Case
    summary: Summary
    record: Provenance
    verified: Sequence[Check]
    validated: Sequence[Check]
    run: SweptCase
    spread: InputSpread | None


class Finding(NamedTuple):
    """Assessment of a factor by the program.

    Attributes:
        grade: Grade; None without evidence.
        evidence: Sentences on the evidence.
        missing: Evidence that is missing for the next grade.
    """

    grade: Grade | None
    evidence: Sequence[str]
    missing: str = ""


Grader = Callable[[Evidence], Finding]


@dataclass(frozen=True)
class AssessedFactor:
    """A credibility factor of a run.

    Attributes:
        number: 1 to 25.
        key: Its key below `credibility.evidence` of a case.
        group: Activity to which it belongs.
        name: Name in words.
        scale: Meaning of the grades from a on.
        grade: Grade that is reached; None without evidence.
        goal: Grade that is proposed for the risk; None if the risk is not stated.
        evidence: Sentences on the run and the given folders.
        claim: Sentence of the applicant or of the context of use; empty without one.
        links: Files of the repository, and of the claim.
        missing: Evidence that is missing for the next grade; empty at the highest.
    """

    number: int
    key: FactorName
    group: str
    name: str
    scale: tuple[str, ...]
    grade: Grade | None
    goal: Grade | None
    evidence: tuple[str, ...]
    claim: str
    links: tuple[str, ...]
    missing: str

    @property
    def state(self) -> str:
        """Text on the grade compared with the goal; empty if there is no goal."""
        if self.goal is None:
            return ""
        return "reached" if (self.grade or "") >= self.goal else "below"


def write(folders: Sequence[Path], spread: Path | None = None) -> list[Path]:
    """Write ``evidence.html`` and ``evidence.json`` into the folder of the run.

    Args:
        folders: The folder of the run, then folders of ``mantle verify`` and ``validate``.
        spread: Folder of a sweep over uncertain inputs of the run's case.

    Raises:
        InputError: The first folder has no finished run, another one has no outcomes, or the sweep
            is not one of this case.
    """
    run = _finished(folders[0])
    checks = []
    for folder in folders[1:]:
        checks += _checks(folder)
    swept = SweptCase(run.folder.name, run.folder, CONVERGED)
    basis = Evidence(
        load_case(run.folder / "case.yaml").config,
        run.summary,
        read_json(run.folder / "provenance.json"),
        [c for c in checks if c["group"] != "validation"],
        [c for c in checks if c["group"] == "validation"],
        swept,
        input_spread.input_spread_of_run(spread, swept) if spread else None,
    )
    factors = assessed(basis)
    write_json(run.folder / "evidence.json", _content(basis.case, factors))
    write_text(run.folder / "evidence.html", _page(run.folder, basis.case, factors))
    return [run.folder / "evidence.html", run.folder / "evidence.json"]


def assessed(basis: Evidence) -> list[AssessedFactor]:
    """Return the 25 factors of a run in their order."""
    stated = basis.case.credibility
    factors = []
    for number, (key, factor) in enumerate(CREDIBILITY_FACTORS.items(), 1):
        finding = GRADERS[key](basis)
        claim = stated.evidence.get(key)
        grade = finding.grade
        if claim and claim.grade:
            grade = None if claim.grade == "none" else claim.grade
        above = factor.next_grade(grade)
        missing = ""
        if above:
            by_program = finding.missing if grade == finding.grade else ""
            missing = (claim.missing if claim else "") or by_program or factor.meaning(above)
            missing = f"for {above if grade else 'a grade'}: {missing}"
        factors.append(
            AssessedFactor(
                number,
                key,
                factor.group,
                factor.name,
                factor.scale,
                grade,
                factor.goal(stated.risk) if stated.risk else None,
                tuple(finding.evidence),
                claim.text if claim else "",
                (*LINKS.get(key, ()), *(claim.links if claim else ())),
                missing,
            )
        )
    return factors


def _content(case: Case, factors: Sequence[AssessedFactor]) -> dict[str, object]:
    """Content of ``evidence.json``."""
    stated = case.credibility
    return {
        "standard": STANDARD,
        "question": stated.question or APPLICANT,
        "context_of_use": stated.context_of_use or APPLICANT,
        "influence": stated.influence,
        "consequence": stated.consequence,
        "risk": stated.risk,
        "factors": [vars(factor) | {"state": factor.state} for factor in factors],
    }


# Page


def _page(folder: Path, case: Case, factors: Sequence[AssessedFactor]) -> str:
    """HTML of the page."""
    groups = dict.fromkeys(factor.group for factor in factors)
    sections = [
        PageSection("context", "Question, context of use and risk", _context(case)),
        PageSection("overview", "The 25 factors", _overview(factors)),
    ]
    for group in groups:
        blocks: list[Block] = []
        for factor in factors:
            if factor.group == group:
                blocks += _blocks(folder, factor)
        anchor = "".join(c if c.isalnum() else "-" for c in group)
        sections.append(PageSection(anchor, f"{group[0].upper()}{group[1:]}", blocks))
    sections.append(PageSection("method", "How grades and goals are set", page.bullets(METHOD)))
    return page.page(
        f"Evidence: {case.title or folder.name}",
        sections,
        page.bullets(_gaps(factors)),
        facts=f"from {folder}, by {STANDARD}",
        lead=_lead(case, factors),
    )


def _lead(case: Case, factors: Sequence[AssessedFactor]) -> str:
    """Conclusion in sentences."""
    risk = case.credibility.risk
    if risk is None:
        return (
            "The case does not state its risk (influence and consequence), so no factor has a "
            "goal. The grades below are what the run and the given folders show."
        )
    reached_count = sum(factor.state == "reached" for factor in factors)
    level = f"Risk {risk} of 5 ({RISKS[risk - 1]})."
    if reached_count == len(factors):
        return f"{level} All {len(factors)} factors reach the grade proposed for this risk."
    return (
        f"{level} {reached_count} of {len(factors)} factors reach the grade proposed for this "
        f"risk. {len(factors) - reached_count} do not: the evidence is not sufficient for this "
        "context of use."
    )


def _gaps(factors: Sequence[AssessedFactor]) -> list[str]:
    """Factors below their goal, with grade and goal."""
    return [
        f"below: {f.number} {f.name}, grade {f.grade or 'none'}, goal {f.goal}"
        for f in factors
        if f.state == "below"
    ]


def _context(case: Case) -> list[Block]:
    """Question, context of use and risk, as a table."""
    stated = case.credibility
    rows = [
        ["question of interest", stated.question or APPLICANT],
        ["context of use", stated.context_of_use or APPLICANT],
        ["influence of the model", _reasoned(stated.influence, stated.influence_reason)],
        [
            "consequence of a wrong decision",
            _reasoned(stated.consequence, stated.consequence_reason),
        ],
        ["risk", f"{RISKS[stated.risk - 1]}, {stated.risk} of 5" if stated.risk else APPLICANT],
    ]
    if stated.source:
        rows.append(["source of this context", stated.source])
    return page.table(["", ""], rows)


def _reasoned(level: str | None, reason: str) -> str:
    if level is None:
        return APPLICANT
    return f"{level}. {reason}" if reason else level


def _overview(factors: Sequence[AssessedFactor]) -> list[Block]:
    """Table of all factors with grade and goal."""
    rows = []
    for f in factors:
        grade = f"{f.grade or 'none'} of a to {credibility.GRADES[len(f.scale) - 1]}"
        rows.append([str(f.number), f.group, f.name, grade, f.goal or "-", f.state or "-"])
    return page.table(["", "activity", "factor", "grade", "goal", ""], rows)


def _blocks(folder: Path, factor: AssessedFactor) -> list[Block]:
    """Heading and table of a factor."""
    scale = []
    for letter, meaning in zip(credibility.GRADES, factor.scale, strict=False):
        of_this_run = " (this run)" if letter == factor.grade else ""
        scale.append(f"{letter}: {meaning}{of_this_run}")
    goal = f", goal {factor.goal}: {factor.state}" if factor.goal else ""
    rows: list[list[page.Cell]] = [["grades", scale]]
    if factor.evidence:
        rows.append(["in this run and the given folders", list(factor.evidence)])
    if factor.claim:
        rows.append(["stated by the case", factor.claim])
    if factor.links:
        links = [Link(name, _address(folder, name)) for name in factor.links]
        rows.append(["in the repository", links])
    if factor.missing:
        rows.append(["missing", factor.missing])
    title = f"{factor.number} {factor.name}: grade {factor.grade or 'none'}{goal}"
    return page.titled(title, page.table(["", ""], rows))


def _address(folder: Path, name: str) -> str:
    """Address of a file of the repository, relative to the page; empty if it is not installed."""
    file = REPOSITORY / name
    return Path(os.path.relpath(file, folder)).as_posix() if file.exists() else ""


METHOD = (
    "Risk is 1 for low influence and low consequence, and one more for each step of either.",
    "The goal of a factor is the same part of its scale as the risk of 1 to 5: for risk 3 of 5, "
    "grade b of a to c, or grade c of a to d. It is a proposal of mantle. The standard leaves "
    "goals to the applicant.",
    "Factors 1 to 23 are the 13 factors of ASME V&V 40-2018 with their sub-factors, by Table 5 of "
    "Galappaththige et al. 2022, PLoS Comput Biol 18:e1010541. Scales are shortened.",
    "Factors 24 and 25 are evidence of the guidance of 2023 without a number in the standard. "
    "Their scales are mantle's.",
    "The program grades only what it has seen. A grade in `credibility.evidence` of the case "
    "replaces it, and the text is shown as stated by the case.",
)

# Factors


def _finished(folder: Path) -> Results:
    if not (folder / "DONE").exists() or not (folder / "summary.json").exists():
        raise InputError(f"{folder}: contains no finished run; give the folder of one first")
    return Results(folder)


def _checks(folder: Path) -> list[Check]:
    files = sorted([*folder.glob("verify*.json"), *folder.glob("validate.json")])
    if not files:
        remedy = f"mantle verify or mantle validate with -o {folder} writes one"
        raise InputError(f"{folder}: contains no verify.json or validate.json; {remedy}")
    checks: list[Check] = []
    for file in files:
        checks += read_json(file)
    return [check for check in checks if check["outcome"] != NOT_MEASURED]


def _software(basis: Evidence) -> Finding:
    versions = ", ".join(f"{name} {version}" for name, version in basis.record["identity"].items())
    ranks, processor = basis.record["ranks"], basis.record["processor"]
    return Finding(
        "b",
        (
            f"sources by digest and versions: {versions}",
            f"{several(ranks, 'rank')}, {processor}, {basis.record['started'][:10]}",
            "mantle test checks this version: lint, types, tests, planted faults of its equations",
        ),
        "an assessment of known anomalies for this context of use, and measures of quality",
    )


def _code(basis: Evidence) -> Finding:
    checks = basis.verified
    if not checks:
        finding_text = "no outcomes of mantle verify were given"
        return Finding(None, (finding_text,), "mantle verify -o FOLDER, then FOLDER after the run")
    unsolved = [c for c in checks if c["outcome"] not in ("passed", "refused")]
    solved_count = len(checks) - len(unsolved)
    sentences = [
        f"{solved_count} of {len(checks)} problems with known answers are solved within tolerance"
    ]
    sentences += map(_outcome, unsolved)
    order_ratios = [
        c["order"] / c["expected_order"] for c in checks if c["order"] and c["expected_order"]
    ]
    if order_ratios:
        lowest = min(order_ratios)
        sentences.append(
            f"{len(order_ratios)} orders of convergence, the least {lowest:.0%} of the"
            " theoretical one"
        )
    if unsolved:
        return Finding("a", sentences, "solutions within tolerance for every problem that was run")
    checked_groups = {check["group"] for check in checks}
    subjects = _subjects(basis.case)
    sentences.append(f"their groups: {', '.join(sorted(checked_groups))}")
    unproved = [
        subject for subject in subjects if not checked_groups.intersection(SUBJECTS[subject])
    ]
    if unproved:
        return Finding("a", sentences, f"problems with known answers on {', '.join(unproved)}")
    return Finding("d" if order_ratios else "c", sentences)


# Groups of problems of `mantle verify` that prove a part of the equations.
SUBJECTS: Mapping[str, tuple[str, ...]] = {
    "elasticity": ("patch", "uniaxial", "sine", "cook", "fibre"),
    "contact": ("lame", "hertz", "cattaneo", "incline", "foundation", "press", "oval"),
    "cohesion": ("cohesive",),
    "heat": ("heat",),
    "cure": ("cure",),
    "creep": ("creep",),
}


def _subjects(case: Case) -> list[str]:
    """Parts of the equations that a case uses, as in `SUBJECTS`."""
    laws = case.interfaces.values()
    thermal = [region.thermal for region in case.regions.values() if region.thermal]
    uses_by_subject = {
        "elasticity": True,
        "contact": any(law.is_contact for law in laws),
        "cohesion": any("damage" in law.internal_variables for law in laws),
        "heat": bool(thermal),
        "cure": any(thermal_keys.cure for thermal_keys in thermal),
        "creep": bool(_creeping(case)),
    }
    return [subject for subject, is_used in uses_by_subject.items() if is_used]


def _creeping(case: Case) -> list[str]:
    """Names of the regions that creep."""
    return [name for name, region in case.regions.items() if region.creep]


def _outcome(check: Check) -> str:
    value, reference = check["value"], check["reference"]
    numbers = f": {value:.4g}, reference {reference:.4g}" if value and reference else ""
    return f"{check['name']}: {check['outcome']}{numbers}"


def _discretization_error(basis: Evidence) -> Finding:
    sentences = tuple(_discretization(basis.summary))
    if "error" not in basis.summary:
        return Finding("a", sentences, "a run with --error")
    failed = basis.summary["error"].get("failed", [])
    if failed:
        return Finding("b", sentences, f"an estimate also for: {', '.join(failed)}")
    return Finding("c", sentences)


def _discretization(summary: Summary) -> Iterator[str]:
    if "error" not in summary:
        yield "not estimated"
        return
    for section, name, numbers in summary_numbers.numbers_of(summary):
        quantities_with_error = [
            q for q in TABLE[section].values() if q.headline and f"{q.key}_error" in numbers
        ]
        if quantities_with_error:
            number_texts = (
                f"{q.label} {q.text(numbers)} {number_text.printed(q.shown)}"
                for q in quantities_with_error
            )
            yield f"{name}: {', '.join(number_texts)}"
    yield "the exact solution lies within ± for about 90 of 100 such numbers"
    yield from (v.text for v in recorded(summary) if v.where == PEAKS)


# Verdicts of a run that are about the solver.
SOLVED = (EQUILIBRIUM, CONTACT, HEAT)


def _solver(basis: Evidence) -> Finding:
    verdicts = [v for v in recorded(basis.summary) if v.where in SOLVED]
    sentences = [v.text for v in verdicts]
    if any(v.severity is Severity.ERROR for v in verdicts):
        return Finding("a", sentences, "a run whose balances are within their limits")
    return Finding(
        "b", sentences, "runs with other tolerances of the solver, and their effect on the results"
    )


def _use(basis: Evidence) -> Finding:
    sentences = ["the case was checked against its schema: units, names, ranges, balance of loads"]
    sentences.append(f"digest of the input: {basis.record['case_sha256'][:16]}")
    sentences.append("case.yaml in the folder of the run has every default")
    doubtful_severities = (Severity.NOTE, Severity.WARNING)
    sentences += [str(v) for v in recorded(basis.summary) if v.severity in doubtful_severities]
    return Finding("a", sentences, "name and date of the person who verified inputs and outputs")


def _form(basis: Evidence) -> Finding:
    case = basis.case
    laws = ", ".join(f"{name} {law.kind}" for name, law in case.interfaces.items())
    creeping = _creeping(case)
    sentences = [
        f"small strains, linear elasticity, quasi-static loads; interfaces: {laws or 'none'}"
    ]
    sentences.append(f"creep: {', '.join(creeping)}" if creeping else "no creep")
    sentences.append("no plasticity")
    return Finding(
        "a", sentences, "runs of this case with other laws, geometry, loads and supports"
    )


def _sensitivities(basis: Evidence) -> Finding:
    if not basis.spread:
        return Finding("a", ("no sweep was given",), SWEEP)
    sentences = [_samples(basis.spread)]
    for name, q, _, _ in summary_numbers.main_numbers(basis.summary):
        values = basis.spread.range_of(name)
        if values and values[2]:
            owner = name.partition(".")[0]
            sentences.append(f"{owner}: {q.label} follows most {values[2]}")
    return Finding("b", sentences, "the same for every input of the case")


def _uncertainties(basis: Evidence) -> Finding:
    sentences = list(_inputs(basis.case))
    if not basis.spread:
        statuses = [keys.status for keys in _parts(basis.case).values()]
        return Finding("a" if None in statuses else "b", sentences, SWEEP)
    sentences.append(_samples(basis.spread))
    sentences += _bands(basis.summary, basis.spread)
    return Finding("b", sentences, "ranges of all inputs, propagated to the results")


SWEEP = "a sweep over uncertain inputs of this case (latin_hypercube), then --spread FOLDER"


def _samples(spread: InputSpread) -> str:
    return (
        f"{len(spread.samples)} samples of {len(spread.inputs)} inputs: {', '.join(spread.inputs)}"
    )


def _bands(summary: Summary, spread: InputSpread) -> Iterator[str]:
    """Ranges of the main numbers over uncertain inputs."""
    for name, q, _, _ in summary_numbers.main_numbers(summary):
        values = spread.range_of(name)
        if values:
            lowest, highest, _ = values
            range_text = (
                f"{lowest:.{q.digits}f} to {highest:.{q.digits}f} {number_text.printed(q.shown)}"
            )
            owner = name.partition(".")[0]
            yield f"{owner}: {q.label} {range_text} (5 to 95 % over the inputs)"


def _parts(case: Case) -> Mapping[str, Material | AnyLoad]:
    """Regions and loads by their paths."""
    regions = {f"regions.{name}": region for name, region in case.regions.items()}
    return regions | {f"loads.{name}": load for name, load in case.loads.items()}


def _inputs(case: Case) -> Iterator[str]:
    for path, keys in _parts(case).items():
        source = f", {keys.source}" if keys.source else ""
        yield f"{path}: {keys.status or 'without status'}{source}"


def _comparator(grade: Grade, sentence: str, missing: str, several: Grade | None = None) -> Grader:
    """Return the grader of a factor on samples or conditions of the shipped experiments.

    Args:
        grade: Grade with an experiment.
        sentence: Sentence on the experiments.
        missing: Evidence that is missing for the next grade.
        several: Grade with more than one experiment; None if it is the same.
    """

    def graded(basis: Evidence) -> Finding:
        if not basis.validated:
            return Finding(None, (), NO_COMPARATOR)
        count = len(basis.validated)
        reached_grade = several if several and count > 1 else grade
        return Finding(
            reached_grade, (f"{count} comparison(s) with experiments", sentence), missing
        )

    return graded


def _outputs(basis: Evidence) -> Finding:
    if not basis.validated:
        return Finding(None, (), NO_COMPARATOR)
    count = len(basis.validated)
    return Finding("b" if count > 1 else "a", (f"{count} output(s) were compared",))


def _rigor(basis: Evidence) -> Finding:
    if not basis.validated:
        return Finding(None, (), NO_COMPARATOR)
    sentence = "the measured range is the limit; the error of the mesh is in the note"
    missing = "the band of the model over its inputs, next to the scatter of the measurement"
    return Finding("c", (sentence,), missing)


def _agreement(basis: Evidence) -> Finding:
    if not basis.validated:
        return Finding(None, (), NO_COMPARATOR)
    inside = [c for c in basis.validated if c["outcome"] == "passed"]
    sentences = [f"{len(inside)} of {len(basis.validated)} outputs are inside the measured range"]
    for check in basis.validated:
        note = f"; {check['note']}" if check["note"] else ""
        sentences.append(f"{_outcome(check)}{note}")
    if len(inside) == len(basis.validated):
        return Finding("c", sentences)
    return Finding("a", sentences, "a statement which outputs are key, all of them inside")


def _relevance(basis: Evidence) -> Finding:
    if not basis.validated:
        return Finding(None, (), NO_COMPARATOR)
    return Finding(None, (), "the applicant compares the experiments with the context of use")


def _calibration(basis: Evidence) -> Finding:
    unstated = [path for path, keys in _parts(basis.case).items() if keys.status is None]
    sentences = ["no input was fitted to the experiments of docs/validation"]
    if unstated:
        sentences.append(f"inputs of unknown origin: {', '.join(unstated)}")
        return Finding("b", sentences, "`status` and `source` of these inputs")
    return Finding("c", sentences)


def _result_uncertainty(basis: Evidence) -> Finding:
    sentences = []
    if "error" in basis.summary:
        sentences.append("the error of mesh and step is estimated (factor 3)")
    if basis.spread:
        sentences.append(basis.spread.sentence(basis.run))
    grades: tuple[Grade, ...] = ("a", "b", "c")
    missing_options = {"error": "--error", "spread": "--spread FOLDER"}
    if "error" in basis.summary:
        del missing_options["error"]
    if basis.spread:
        del missing_options["spread"]
    missing = f"a report with {' and '.join(missing_options.values())}" if missing_options else ""
    return Finding(grades[len(sentences)], sentences, missing)


ABSTRACTS = "the sources are abstracts; most give neither sizes nor numbers of samples"

GRADERS: Mapping[FactorName, Grader] = {
    "software_quality_assurance": _software,
    "numerical_code_verification": _code,
    "discretization_error": _discretization_error,
    "numerical_solver_error": _solver,
    "use_error": _use,
    "model_form": _form,
    "input_sensitivities": _sensitivities,
    "input_uncertainties": _uncertainties,
    "sample_quantity": _comparator(
        "a", ABSTRACTS, "numbers of samples, from the papers or from tests of your own"
    ),
    "sample_range": _comparator("a", ABSTRACTS, "samples of several sizes and materials"),
    "sample_measurements": _comparator(
        "b",
        "finish of rods, height of discs, share of contact are known; sizes are assumed",
        "measured sizes and materials of the samples",
    ),
    "sample_uncertainty": _comparator("a", ABSTRACTS, "uncertainty of sizes and materials"),
    "condition_quantity": _comparator(
        "a", "an experiment with its conditions is one comparison", "more conditions", several="b"
    ),
    "condition_range": _comparator(
        "a", "each experiment was compared as published", "loads and temperatures in a range"
    ),
    "condition_measurements": _comparator(
        "b",
        "loads or moulds are known; friction, room and air are assumed",
        "measured friction, temperatures and supports of the tests",
    ),
    "condition_uncertainty": _comparator("a", ABSTRACTS, "accuracy of loads and temperatures"),
    "input_equivalency": _comparator(
        "b",
        "models have the type of load and support of the tests; ranges of inputs are assumed",
        "inputs with the ranges of the tests",
    ),
    "output_quantity": _outputs,
    "output_equivalency": _comparator(
        "c", "the compared numbers are those that were measured: force, temperature, motion", ""
    ),
    "output_rigor": _rigor,
    "output_agreement": _agreement,
    "relevant_quantities": _relevance,
    "relevant_validation": _relevance,
    "calibration": _calibration,
    "result_uncertainty": _result_uncertainty,
}


# Methods


def methods(folder: Path) -> Path:
    """Write ``methods.md``: a section on methods with every number from the run.

    Raises:
        InputError: The folder has no finished run.
    """
    run = _finished(folder)
    case, record = load_case(folder / "case.yaml").config, read_json(folder / "provenance.json")
    methods_text = "\n\n".join(_paragraphs(case, run.summary, record))
    write_text(folder / "methods.md", methods_text + "\n")
    return folder / "methods.md"


def _paragraphs(case: Case, summary: Summary, record: Provenance) -> Iterator[str]:
    yield f"## Methods: {case.title}"
    order = case.mesh.order
    solver = summary["solver"]
    mantle = ""
    cement = summary.get("mantle", {}).get("thickness")
    if cement:
        mantle = (
            f" Its cement mantle is {cement['mean']:.2f} mm thick in the mean, "
            f"{cement['min']:.2f} mm at the least (nominal {cement['nominal']:g} mm)."
        )
    mesh_text = f"was meshed by gmsh {record['identity']['gmsh']} with tetrahedra of"
    mesh_text = f"{mesh_text} {case.mesh.size:g} mm and order {order}"
    if isinstance(case.geometry, MeshFile) and not case.geometry.is_script:
        mesh_text = f"has the tetrahedra of {case.geometry.path.name}, of order {order}"
    yield f"The model ({case.geometry.kind}) {mesh_text}: {solver['dofs']} unknowns.{mantle}"
    for title in ("regions", "interfaces", "supports", "loads"):
        section_items = getattr(case, title).items()
        lines = (f"- {name.replace('_', ' ')}: {_values(part)}" for name, part in section_items)
        yield "\n".join([f"{title.capitalize()}:", "", *lines])
    stages = ", ".join(stage.name for stage in case.stages)
    balance = ", ".join(f"{key} {value:.1g}" for key, value in summary["balance"].items())
    yield (
        f"Stages: {stages}. They were solved by an augmented Lagrangian and Newton's method "
        f"(mantle {record['mantle']}, DOLFINx {record['identity']['dolfinx']}, PETSc "
        f"{record['identity']['petsc']}) in {solver['steps']} steps and "
        f"{solver['newton_iterations']} iterations; relative imbalance: {balance}."
    )
    yield "Errors of mesh and step: " + "; ".join(_discretization(summary)) + "."


def _values(part: Section) -> str:
    """Keys and values of a part of a case, with units."""
    fields = part.model_dump(mode="json", exclude_none=True, exclude={"tissue", *ORIGIN})
    given_fields = {key: value for key, value in fields.items() if value not in ([], {}, "")}
    return ", ".join(
        f"{key.replace('_', ' ')} {plain_text(value)}" for key, value in given_fields.items()
    )
