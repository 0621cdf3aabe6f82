"""Evidence for a referee or an authority: credibility factors of ASME V&V 40-2018, and methods.

Results of runs fill each factor. The applicant writes what a program cannot know.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypedDict

from app.case import quantities
from app.case.case import Case, load
from app.case.geometries import MeshFile
from app.case.library import ORIGIN
from app.case.quantities import TABLE
from app.case.summary import Summary
from app.foundation.errors import InputError
from app.foundation.verdict import Severity, recorded
from app.report import page
from app.report.page import PageSection
from app.results.reading import Results
from app.results.verdicts import CONTACT, EQUILIBRIUM, HEAT, PEAKS
from app.schema.section import Section
from app.system.folders import read_json, write_json, write_text
from app.system.layout import plain

if TYPE_CHECKING:
    from app.results.run_folder import Provenance

# Text of a factor without evidence.
APPLICANT = "the applicant writes this"
LEFT = (APPLICANT,)
# Names of the factors, in their order, and what they belong to.
FACTORS = {
    "code verification": ("software quality assurance", "numerical code verification"),
    "calculation verification": ("discretization error", "numerical solver error", "use error"),
    "validation: computational model": ("model form", "model inputs"),
    "validation: comparator": ("test samples", "test conditions"),
    "validation: assessment": ("equivalency of inputs", "output comparison"),
    "applicability": (
        "relevance of the quantities of interest",
        "relevance of the validation to the context of use",
    ),
}
PARTS = [(part, name) for part, names in FACTORS.items() for name in names]


class Check(TypedDict):
    """Outcome of a problem in ``verify.json``, as far as evidence needs it."""

    name: str
    group: str
    outcome: str
    value: float | None
    reference: float | None
    order: float | None
    expected_order: float | None
    note: str


class CredibilityFactor(NamedTuple):
    """A credibility factor: 1 to 13 in the order of the standard, its group, and sentences."""

    number: int
    part: str
    name: str
    evidence: tuple[str, ...]


def write(folders: Sequence[Path]) -> list[Path]:
    """Write ``evidence.html`` and ``evidence.json`` into the folder of the run.

    Args:
        folders: The folder of the run, then folders of ``mantle verify`` with verification and
            validation problems.

    Raises:
        InputError: The first folder has no finished run, or another one has no outcomes.
    """
    run = _finished(folders[0])
    checks = [check for folder in folders[1:] for check in _checks(folder)]
    case = load(run.folder / "case.yaml").config
    credibility = factors(case, run.summary, read_json(run.folder / "provenance.json"), checks)
    filled = sum(factor.evidence != LEFT for factor in credibility)
    head = {key: getattr(case, key) or APPLICANT for key in ("question", "context_of_use")}
    content = head | {"standard": "ASME V&V 40-2018", "factors": [f._asdict() for f in credibility]}
    write_json(run.folder / "evidence.json", content)
    rows = [[str(f.number), f.part, f.name, list(f.evidence)] for f in credibility]
    table = page.table(["", "part", "factor", "evidence"], rows)
    html = page.page(
        f"Evidence: {case.title or run.folder.name}",
        [
            PageSection("question", "Question", page.bullets([head["question"]])),
            PageSection("context", "Context of use", page.bullets([head["context_of_use"]])),
            PageSection("factors", "Credibility factors of ASME V&V 40-2018", table),
        ],
        page.bullets([f"{filled} of {len(credibility)} factors have evidence"]),
        facts=f"from {run.folder}",
        lead="Computed evidence for each factor. The applicant adds the rest.",
    )
    write_text(run.folder / "evidence.html", html)
    return [run.folder / "evidence.html", run.folder / "evidence.json"]


def factors(
    case: Case, summary: Summary, record: Provenance, checks: Sequence[Check]
) -> list[CredibilityFactor]:
    """Return the factors of a run, with outcomes of verification and validation problems."""
    validated = [c for c in checks if c["group"] == "validation"]
    verified = [c for c in checks if c["group"] != "validation"]
    measured = tuple(_outcome(c) for c in validated)
    sentences: tuple[tuple[str, ...], ...] = (
        tuple(_software(record)),
        tuple(_code(verified)),
        tuple(_discretization(summary)),
        tuple(v.text for v in recorded(summary) if v.where in SOLVED),
        tuple(_use(summary, record)),
        tuple(_form(case)),
        tuple(_inputs(case)),
        tuple(f"{c['name']}: {c['note']}" for c in validated if c["note"]) or LEFT,
        LEFT,
        LEFT,
        measured or LEFT,
        (f"the question: {case.question}",) if case.question else LEFT,
        (f"the context of use: {case.context_of_use}", *LEFT) if case.context_of_use else LEFT,
    )
    return [CredibilityFactor(k + 1, *PARTS[k], s) for k, s in enumerate(sentences)]


# Verdicts of a run that are about the solver.
SOLVED = (EQUILIBRIUM, CONTACT, HEAT)


def _finished(folder: Path) -> Results:
    if not (folder / "DONE").exists() or not (folder / "summary.json").exists():
        raise InputError(f"{folder}: holds no finished run; evidence begins with one")
    return Results(folder)


def _checks(folder: Path) -> list[Check]:
    files = sorted(folder.glob("verify*.json"))
    if not files:
        raise InputError(f"{folder}: holds no verify.json; mantle verify -o {folder} writes it")
    return [check for file in files for check in read_json(file)]


def _software(record: Provenance) -> Iterator[str]:
    parts = ", ".join(f"{name} {version}" for name, version in record["identity"].items())
    yield f"sources by digest and versions: {parts}"
    yield f"{record['ranks']} rank(s), {record['processor']}, {record['started'][:10]}"
    yield "mantle test checks this version: lint, types, tests, planted faults of its equations"


def _code(checks: Sequence[Check]) -> Iterator[str]:
    if not checks:
        yield f"no outcomes of mantle verify were given: {APPLICANT}"
        return
    passed = [c for c in checks if c["outcome"] in ("passed", "refused")]
    yield f"{len(passed)} of {len(checks)} problems with known answers are solved within tolerance"
    for check in checks:
        if check["outcome"] not in ("passed", "refused"):
            yield _outcome(check)
    shares = [
        c["order"] / c["expected_order"] for c in checks if c["order"] and c["expected_order"]
    ]
    if shares:
        least = min(shares)
        yield f"{len(shares)} orders of convergence, the least {least:.0%} of the theoretical one"


def _outcome(check: Check) -> str:
    value, reference = check["value"], check["reference"]
    numbers = f": {value:.4g}, reference {reference:.4g}" if value and reference else ""
    return f"{check['name']}: {check['outcome']}{numbers}"


def _discretization(summary: Summary) -> Iterator[str]:
    if "error" not in summary:
        yield f"not estimated; run with --error: {APPLICANT}"
        return
    for section, name, numbers in quantities.numbers_of(summary):
        shown = [q for q in TABLE[section].values() if q.headline and f"{q.key}_error" in numbers]
        if shown:
            texts = (f"{q.label} {q.text(numbers)} {quantities.printed(q.shown)}" for q in shown)
            yield f"{name}: {', '.join(texts)}"
    yield "the exact solution lies within ± for about 90 of 100 such numbers"
    yield from (v.text for v in recorded(summary) if v.where == PEAKS)


def _use(summary: Summary, record: Provenance) -> Iterator[str]:
    yield "the case was checked against its schema: units, names, ranges, balance of loads"
    yield f"input by digest: {record['case_sha256'][:16]}; case.yaml has every default"
    yield from (str(v) for v in recorded(summary) if v.severity is Severity.NOTE)


def _form(case: Case) -> Iterator[str]:
    laws = ", ".join(f"{name} {law.kind}" for name, law in case.interfaces.items())
    yield f"small strains and slips, linear elasticity, quasi-static loads; interfaces: {laws}"
    yield "no plasticity, creep, damage or remodelling"
    yield f"sensitivity to the form of the model: {APPLICANT}"


def _inputs(case: Case) -> Iterator[str]:
    for section, parts in (("regions", case.regions), ("loads", case.loads)):
        for name, part in parts.items():
            source = f", {part.source}" if part.source else ""
            yield f"{section}.{name}: {part.status or 'without status'}{source}"
    yield "spread over inputs: mantle report --spread shows it next to the error"


# Methods


def methods(folder: Path) -> Path:
    """Write ``methods.md``: a section on methods with every number from the run.

    Raises:
        InputError: The folder has no finished run.
    """
    run = _finished(folder)
    case, record = load(folder / "case.yaml").config, read_json(folder / "provenance.json")
    text = "\n\n".join(_paragraphs(case, run.summary, record))
    write_text(folder / "methods.md", text + "\n")
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
    made = f"was meshed by gmsh {record['identity']['gmsh']} with tetrahedra of"
    made = f"{made} {case.mesh.size:g} mm and order {order}"
    if isinstance(case.geometry, MeshFile) and not case.geometry.is_script:
        made = f"has the tetrahedra of {case.geometry.path.name}, of order {order}"
    yield f"The model ({case.geometry.kind}) {made}: {solver['dofs']} unknowns.{mantle}"
    for title in ("regions", "interfaces", "supports", "loads"):
        parts = getattr(case, title).items()
        lines = (f"- {name.replace('_', ' ')}: {_values(part)}" for name, part in parts)
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
    kept = {key: value for key, value in fields.items() if value not in ([], {}, "")}
    return ", ".join(f"{key.replace('_', ' ')} {plain(value)}" for key, value in kept.items())
