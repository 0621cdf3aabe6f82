"""The manual: links resolve, commands parse, cases load, generated pages are up to date."""

from __future__ import annotations

import fnmatch
import importlib.util
import pkgutil
import re
import shlex
import tomllib
from collections.abc import Iterator
from functools import cache
from itertools import takewhile
from pathlib import Path
from types import ModuleType

import pytest
from ruamel.yaml import YAML

import mantle
from app.case import new_case
from app.case.case import Case, load_case
from app.case.fit import FitFile
from app.case.quantities import TABLE
from app.case.study import StudyFile
from app.case.sweep import Sweep
from app.command_line.parser import parser
from app.verification import suite
from tests import support

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md")])
# Commands of the launcher, which the program does not know.
LAUNCHER = {"test", "shell", "setup"}
CASE_KEYS = {"geometry", "mesh", "regions"}


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


@cache
def parts(page: Path) -> tuple[str, tuple[tuple[str, str], ...]]:
    """The text of a page without its fenced blocks, and the blocks with their languages."""
    text = page.read_text(encoding="utf-8")
    fence = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
    return fence.sub("", text), tuple(fence.findall(text))


def blocks(language: str) -> Iterator[tuple[Path, str]]:
    for page in PAGES:
        yield from ((page, text) for lang, text in parts(page)[1] if lang == language)


@cache
def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as forges make them."""
    headings = re.findall(r"^#+ (.*)$", parts(page)[0], re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading) for heading in headings]
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in plain}


def commands(text: str) -> Iterator[list[str]]:
    """The commands of mantle in a block of shell, as words."""
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        for i, word in enumerate(words):
            starts = i == 0 or words[i - 1] == "&&" or "mpirun" in words[:i]
            if starts and word in ("mantle", "./mantle"):
                end = words.index("&&", i) if "&&" in words[i:] else len(words)
                yield words[i + 1 : end]


@cache
def script(name: str) -> ModuleType:
    """A module of the manual's folder, which is no package."""
    spec = importlib.util.spec_from_file_location(f"manual_{name}", DOCS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_docs_relative_links_resolve(page: Path) -> None:
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", parts(page)[0]):
        if re.match("[a-z]+:", link):
            continue
        target, _, anchor = link.partition("#")
        path = (page.parent / target).resolve() if target else page
        if not path.exists() or (anchor and anchor not in anchors(path)):
            broken.append(link)
    assert not broken


def test_docs_pages_are_reached_from_the_readme() -> None:
    seen: set[Path] = set()
    waiting = [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        if page in seen:
            continue
        seen.add(page)
        for link in re.findall(r"\]\(([^)\s#]+)", parts(page)[0]):
            path = (page.parent / link).resolve()
            path = path / "README.md" if path.is_dir() else path
            if path.suffix == ".md" and path.is_file():
                waiting.append(path)
    assert {named(p) for p in PAGES} - {named(p) for p in seen} <= {"docs/index.md"}


def test_docs_pages_are_in_the_contents_of_the_site() -> None:
    listed = {DOCS / "index.md"}
    for page, contents in script("conf").CONTENTS.items():
        listed |= {(DOCS / page).parent / f"{name}.md" for name in contents.split()}
    assert listed == set(DOCS.rglob("*.md"))


@pytest.mark.parametrize(
    ("page", "command"),
    [(page, command) for page, text in blocks("sh") for command in commands(text)],
    ids=lambda value: named(value) if isinstance(value, Path) else " ".join(value),
)
def test_docs_commands_parse(page: Path, command: list[str]) -> None:
    if command[0] in LAUNCHER:
        return
    options = parser().parse_args(list(takewhile(lambda word: word not in (">", "--"), command)))
    file = getattr(options, "case", None) or getattr(options, "sweep", None)
    assert file is None or not str(file).startswith("configs/") or (ROOT / file).is_file()


@pytest.mark.parametrize(
    ("page", "text"), list(blocks("yaml")), ids=lambda v: named(v) if isinstance(v, Path) else ""
)
def test_docs_yaml_blocks_are_cases_or_parts(page: Path, text: str, tmp_path: Path) -> None:
    data = YAML(typ="safe", pure=True).load(text)
    if CASE_KEYS <= data.keys():
        (tmp_path / "case.yaml").write_text(text, encoding="utf-8")
        assert load_case(tmp_path / "case.yaml").config.geometry
    elif "base" in data and data.keys() & CASE_KEYS:
        (tmp_path / "case.yaml").write_text(text, encoding="utf-8")
        new_case.write(tmp_path / "hip", "femur")
        if page.stem == "your_hip":
            script("parametric_hip").write(tmp_path)
        if "image: labels.nii.gz" in text:
            script("synthetic_ct").main(tmp_path)
        assert load_case(tmp_path / "case.yaml").config.loads
    elif "base" in data:
        kinds = {"study": StudyFile, "fit": FitFile}
        assert next((kinds[key] for key in kinds if key in data), Sweep).model_validate(data)
    else:
        assert data.keys() <= Case.model_fields.keys()


GLOSSARY = (DOCS / "glossary.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "name", sorted(set(re.findall(r"`((?:app|forms|meshes)\.[\w.]+)`", GLOSSARY)))
)
def test_docs_glossary_names_existing_code(name: str) -> None:
    assert pkgutil.resolve_name(name)


def test_docs_glossary_has_each_term_once() -> None:
    terms = re.findall(r"^\| ([^|]+?) \| [^|]*\| [^|]+\| [^|]*\| [^|]*\|$", GLOSSARY, re.MULTILINE)
    terms = [term for term in terms if term != "term"]
    assert len(terms) > 100
    assert sorted(terms) == sorted(set(terms))


@pytest.mark.parametrize("page", ["README.md", "docs/tutorial.md"])
def test_docs_first_case_is_that_of_init(page: str) -> None:
    """README and tutorial show the file that `mantle init hip` writes."""
    shown = next(text for path, text in blocks("yaml") if path == ROOT / page)
    assert shown == (ROOT / "configs" / "start" / "femur.yaml").read_text(encoding="utf-8")


GENERATED = ("case.md", "campaigns.md", "commands.md", "python.md", "former_keys.md")


@pytest.mark.parametrize("name", GENERATED)
def test_docs_generated_pages_are_up_to_date(name: str) -> None:
    module = script("reference")
    committed = (DOCS / "reference" / name).read_text(encoding="utf-8")
    assert committed == module.pages()[name], f"run: {module.COMMAND}"


def test_docs_predictions_are_those_of_the_files() -> None:
    module = script("predictions")
    assert module.PAGE.read_text(encoding="utf-8") == module.page(), "run docs/predictions.py"


def test_docs_readme_shows_the_output_of_a_run() -> None:
    outputs, page = script("outputs"), ROOT / "README.md"
    text = page.read_text(encoding="utf-8")
    assert outputs.tabled(text) == text, "run docs/outputs.py"
    assert outputs.words(outputs.written(page, size="10 mm")) == outputs.words(text)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["README.md", "docs/tutorial.md"])
def test_docs_numbers_are_those_of_runs(name: str) -> None:
    outputs, page = script("outputs"), ROOT / name
    shown = page.read_text(encoding="utf-8")
    assert list(outputs.differences(shown, outputs.written(page))) == []


def test_docs_results_page_names_every_quantity() -> None:
    page = (DOCS / "reference" / "results.md").read_text(encoding="utf-8")
    keys = {name for quantities in TABLE.values() for q in quantities.values() for name in q.names}
    assert [key for key in sorted(keys) if not re.search(rf"[`.]{re.escape(key)}`", page)] == []


def test_docs_verification_page_names_existing_tests() -> None:
    """The last column names problems of verify, rows of stress and files of tests."""
    table = parts(DOCS / "verification.md")[0].partition("| quantity or property |")[2]
    rows = re.findall(r"^\|[^|]*\|[^|]*\|([^|]*)\|$", table.partition("\n\n")[0], re.MULTILINE)
    named = [name for row in rows for name in re.findall("`([^`]*)`", row)]
    known = {p.row.name for p in suite.planned("verify", "long")}
    known |= {p.row.group for p in suite.planned("stress", "long")}
    for name in named:
        if "/" in name:
            folder = ROOT if name.startswith("configs") else ROOT / "tests"
            assert list(folder.glob(name)), name
        else:
            assert fnmatch.filter(known, name), name


def test_docs_citation_has_this_version() -> None:
    citation = YAML(typ="safe", pure=True).load(ROOT / "CITATION.cff")
    assert citation["version"] == mantle.__version__
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["license"] == project["license"]


def test_docs_readme_has_measured_errors_by_mesh_size() -> None:
    """Worst error, size, unknowns and CPU seconds are those of the table of the manual, rounded."""
    line = r"^\| ([\d.]+) % \| (\d+) mm[^|]*\| ([\d,]+) \| (\d+) \|$"
    claimed = re.findall(line, (ROOT / "README.md").read_text(encoding="utf-8"), re.M)
    row = r"^\| (\d+) \| \d+ \| ([\d,]+) \| ([\d.]+) \| ([\d.]+) \|"
    rows = re.findall(row, (DOCS / "verification.md").read_text(encoding="utf-8"), re.M)
    measured = {size: (unknowns, cpu, worst) for size, unknowns, cpu, worst in rows}
    assert len(claimed) == 4
    for worst, size, unknowns, cpu in claimed:
        exact = [float(text.replace(",", "")) for text in measured[size]]
        assert float(unknowns.replace(",", "")) == pytest.approx(exact[0], rel=0.01)
        assert float(cpu) == pytest.approx(exact[1], abs=0.51)
        assert float(worst) == pytest.approx(exact[2], abs=0.5 if exact[2] >= 2 else 0.05)


def test_docs_readme_compares_programs_by_measured_rows() -> None:
    rows = re.findall(
        r"^\| (?:program|mantle|GetFEM|CalculiX)\b.*$", parts(ROOT / "README.md")[0], re.M
    )
    measured = parts(DOCS / "verification.md")[0].splitlines()
    assert len(rows) == 4 and set(rows) <= set(measured)


def test_docs_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 156


@pytest.mark.slow
def test_docs_site_is_built(tmp_path: Path) -> None:
    pytest.importorskip("myst_parser")
    support.python("-m", "sphinx", "-q", "-W", "--keep-going", DOCS, tmp_path)
    assert (tmp_path / "searchindex.js").is_file()


def test_docs_sources_page_names_every_file_with_constants_from_memory() -> None:
    page = (ROOT / "docs/sources.md").read_text(encoding="utf-8")
    # Files about the mark itself, or about values whose file is named.
    without = {"app/laws/values.py", "app/soundness/preview.py", "app/fatigue/findings.py"}
    files = [
        path.relative_to(ROOT).as_posix()
        for folder in ("app", "meshes", "forms", "configs")
        for path in sorted((ROOT / folder).rglob("*.*"))
        if path.suffix in (".py", ".yaml")
        and "from memory" in path.read_text(encoding="utf-8").lower()
    ]
    assert [name for name in files if name not in without and name not in page] == []
