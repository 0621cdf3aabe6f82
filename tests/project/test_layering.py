"""The layers of the program by its source: packages, directions of imports, names, duties."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.project.sources import (
    FOLDERS,
    MODULES,
    ROOT,
    imported,
    module,
    named,
    sources,
    top,
    tree,
)

LAYERS = ("app", "forms", "meshes")

# Lowest first: a package imports only what stands before its row, and itself. Packages of one row
# do not know each other. `mantle.py` with the public functions and `app.cli` see everything.
ROWS = (
    ("foundation",),
    ("mesh_files",),
    ("configs", "forms", "meshes", "system"),
    ("schema", "interfaces", "numerics", "plots"),
    ("laws",),
    ("case",),
    ("scene",),
    ("mechanics", "heat"),
    ("soundness",),
    ("stepping",),
    ("results",),
    ("simulation",),
    ("bearing", "fatigue", "patient", "press_fit", "remodelling"),
    ("campaigns",),
    ("report", "validation", "verification"),
    ("command_line",),
)
TOP = ("mantle", "app.cli", "app.extensions")
# Packages that add to the core: only `app.extensions` knows them.
ROOMS = {"bearing", "fatigue", "patient", "press_fit", "remodelling"}
# What a package may not see although it stands lower.
HIDDEN = {
    "schema": {"forms", "meshes"},
    "numerics": {"configs", "forms", "meshes"},
    "case": {"forms", "numerics"},
}
# Modules of `meshes` that `case` sees: the bone of a femur, and the place of a stem in it.
SEEN_BY_CASE = {
    f"meshes.{name}"
    for name in (
        "best_position",
        "bone_layers",
        "femur_bone",
        "layered_surfaces",
        "placement",
        "room",
    )
}
STACK = {"dolfinx", "petsc4py", "ufl", "mpi4py", "basix", "ffcx", "gmsh", "h5py"}


def package_of(name: str) -> str:
    """The package of a module; empty for modules outside of packages."""
    parts = name.split(".")
    known = {package for row in ROWS for package in row}
    inner = parts[1] if parts[0] == "app" and len(parts) > 1 else parts[0]
    return inner if inner in known else ""


def all_of(*folders: str) -> object:
    return pytest.mark.parametrize("path", sources(*folders), ids=named)


@all_of(*LAYERS)
def test_layering_imports_point_down(path: Path) -> None:
    importer = package_of(module(path))
    seen = {package_of(name) for name in imported(path)} - {"", importer}
    if not importer:
        assert module(path) in ("app", *TOP)
        return
    row = next(k for k, packages in enumerate(ROWS) if importer in packages)
    below = {package for packages in ROWS[:row] for package in packages} - HIDDEN.get(
        importer, set()
    )
    assert seen <= below
    assert not {*TOP} & imported(path) - {"app.extensions"}
    assert not seen & ROOMS


@all_of("app/case")
def test_layering_case_knows_only_the_place_of_a_stem(path: Path) -> None:
    assert {name for name in imported(path) if package_of(name) == "meshes"} <= SEEN_BY_CASE
    assert "import_module" not in path.read_text(encoding="utf-8")


def test_layering_has_no_circular_imports() -> None:
    graph = {name: imported(path) & MODULES.keys() for name, path in MODULES.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


@all_of("tests", "docs")
def test_layering_modules_do_not_import_test_modules(path: Path) -> None:
    """Tests share plain modules and fixtures: see `tests/README.md`."""
    names = {part for name in imported(path) for part in name.split(".")}
    assert not {name for name in names if name == "conftest" or name.startswith("test_")}


# Folders in which a file is named after a behaviour that spans modules.
BEHAVIOURS = ("command_line", "demos", "parallel", "project", "robustness", "verification")


@all_of("tests")
def test_layering_tests_are_named_after_modules(path: Path) -> None:
    """`pytest -k krylov` finds the tests of `krylov.py`."""
    if not path.name.startswith("test_"):
        return
    package = path.parent.name
    modules = {file.stem for file in MODULES.values() if file.parent.name == package}
    if package not in BEHAVIOURS:
        subject = path.stem.removeprefix("test_")
        named_after = (name for name in (*modules, package) if f"{subject}_".startswith(f"{name}_"))
        assert list(named_after), "no module of this name in the package"
    tests = [
        node.name
        for node in ast.walk(tree(path))
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    ]
    assert [name for name in tests if not name.startswith(f"{path.stem}_")] == []


def test_layering_files_of_the_map_exist() -> None:
    """`app/README.md` names files from `app` or from the top."""
    text = (ROOT / "app" / "README.md").read_text(encoding="utf-8")
    names = set(re.findall(r"[\w*]+(?:/[\w*]+)+\.(?:py|md|csv)", text))
    assert len(names) > 40
    for name in names:
        assert any(any(folder.glob(name)) for folder in (ROOT, ROOT / "app")), name


def test_layering_class_names_are_unique() -> None:
    places = defaultdict(list)
    for name, path in MODULES.items():
        for node in tree(path).body:
            if isinstance(node, ast.ClassDef):
                places[node.name].append(name)
    assert {name: modules for name, modules in places.items() if len(modules) > 1} == {}


# Actions of a module on its own subject: `stl.read`, `blocks.build`. Callers name the module.
ACTIONS = {"build", "check", "draw", "read", "run", "write"}


def test_layering_public_functions_have_unique_names() -> None:
    """A search for the name of a function ends at one definition.

    Files of known problems are test modules of pytest, and import no functions of each other.
    """
    places = defaultdict(list)
    for path in sources(*LAYERS):
        if path.parent.name == "problems":
            continue
        for node in tree(path).body:
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                places[node.name].append(named(path))
    twice = {name: paths for name, paths in places.items() if len(paths) > 1}
    assert {name: paths for name, paths in twice.items() if name not in ACTIONS} == {}
    assert ACTIONS <= twice.keys()


def test_layering_constants_say_what_they_bound() -> None:
    """A constant of one word, such as ``MOST``, is defined in at most three modules."""
    places = defaultdict(list)
    for path in sources(*LAYERS):
        for node in tree(path).body:
            if not isinstance(node, ast.Assign | ast.AnnAssign):
                continue
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            is_type = isinstance(node.value, ast.Call) and ast.unparse(node.value.func) == "TypeVar"
            for name in ast.walk(ast.Tuple(elts=targets)):
                if isinstance(name, ast.Name) and re.fullmatch("[A-Z]+", name.id) and not is_type:
                    places[name.id].append(named(path))
    assert {name: where for name, where in places.items() if len(set(where)) > 3} == {}


def test_layering_packages_are_installed_with_a_docstring() -> None:
    """The docstring is short; pyproject.toml lists the package."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    packages = {name for name, path in MODULES.items() if path.name == "__init__.py"}
    assert set(settings["packages"]) == packages
    for name in packages - set(FOLDERS):
        text = ast.get_docstring(tree(MODULES[name]))
        assert text and len(text.splitlines()) <= 6, name


@all_of("app/schema", "app/patient", "meshes")
def test_layering_cases_are_read_and_meshed_without_the_solver(path: Path) -> None:
    unseen = STACK if package_of(module(path)) == "schema" else {"dolfinx", "petsc4py", "ufl"}
    assert path.name == "distribute.py" or not unseen & set(map(top, imported(path)))


@all_of("forms")
def test_layering_forms_import_only_ufl(path: Path) -> None:
    allowed = sys.stdlib_module_names | {"ufl"}
    assert {m for m in imported(path) if not m.startswith("forms")} <= {
        m for m in imported(path) if top(m) in allowed
    }


@all_of("meshes")
def test_layering_meshes_import_only_foundation_and_mesh_files(path: Path) -> None:
    of_app = {m for m in imported(path) if top(m) == "app"}
    assert {package_of(m) for m in of_app} <= {"foundation", "mesh_files"}


# Modules whose classes other packages ask by methods.
LAWS = tuple(
    f"app.laws.{name}"
    for name in ("interface_laws", "contact_laws", "traction_laws", "loads", "supports")
)


# Variables for a law, a load, a support or a heat condition in comparisons of kinds.
OF_KINDS = ("law", "load", "support", "s", "condition")


def kinds_compared(path: Path) -> list[int]:
    """Lines that compare the kind of a law, or collect kinds: ``{law.kind for law in laws}``."""
    lines = []
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Compare):
            operands = [node.left, *node.comparators]
            if any(ast.unparse(o) in {f"{name}.kind" for name in OF_KINDS} for o in operands):
                lines.append(node.lineno)
        elif isinstance(node, ast.SetComp | ast.ListComp | ast.GeneratorExp):
            element = node.elt
            if isinstance(element, ast.Attribute) and element.attr == "kind":
                lines.append(node.lineno)
    return lines


@all_of("app")
def test_layering_no_branches_by_class_or_kind_of_law(path: Path) -> None:
    """Laws, loads and supports answer by methods. Laws import UFL inside methods."""
    laws = {
        alias.asname or alias.name
        for node in ast.walk(tree(path))
        if isinstance(node, ast.ImportFrom) and node.module in LAWS
        for alias in node.names
    }
    names = (ast.unparse(n.cls) for n in ast.walk(tree(path)) if isinstance(n, ast.MatchClass))
    assert not laws.intersection(map(top, names))
    if module(path) != "app.simulation.calculix":  # which laws another program has
        assert not kinds_compared(path)


@all_of("app")
def test_layering_solver_does_not_import_the_case(path: Path) -> None:
    """The solver and the numbers of its states import laws and scene alone."""
    solving = {"numerics", "mechanics", "heat", "stepping"}
    if package_of(module(path)) in solving or module(path) in (
        "app.scene.bodies",
        "app.results.balance",
        "app.results.interface_numbers",
        "app.results.level_sets",
        "app.results.over_time",
        "app.results.thermal_record",
        "app.soundness.critical_friction",
        "app.soundness.failure",
        "app.soundness.floating_bodies_of_state",
    ):
        seen = {m for m in imported(path) if package_of(m) in ("schema", "case")}
        # Types of published numbers.
        allowed = {"app.case.summary"}
        if path.stem == "interface_numbers":
            allowed.add("app.case.quantities")
        assert seen <= allowed


# What releases of DOLFINx call differently.
DIFFERENT = (
    *("gmshio", "dolfinx.io.gmsh", "compute_integration_domains", "create_cell_partitioner"),
    *("create_submesh", "element.interpolation_points", "create_expression_", "assemble_matrix_b"),
    *("LinearProblem", "tabulate_expression", "sub_topology_to_topology"),
)


@all_of("app", "forms", "meshes", "tests")
def test_layering_one_module_checks_features_of_dolfinx(path: Path) -> None:
    if named(path) not in ("app/foundation/dolfinx_features.py", "tests/project/test_layering.py"):
        text = path.read_text(encoding="utf-8")
        assert [name for name in DIFFERENT if name in text] == []


@all_of("app")
def test_layering_one_module_imports_yaml(path: Path) -> None:
    if any(top(m) == "ruamel" for m in imported(path)):
        assert named(path) == "app/schema/yaml_file.py"


@all_of("app", "forms")
def test_layering_comm_world_only_at_the_top(path: Path) -> None:
    """All other modules use the communicator that they get."""
    world = [
        node.lineno
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Attribute) and node.attr == "COMM_WORLD"
    ]
    assert not world or named(path) in (
        "app/cli.py",
        "app/simulation/session.py",
        "app/system/doctor.py",
    )


LAWS = {
    node.name
    for path in sources("app/laws")
    for node in tree(path).body
    if isinstance(node, ast.ClassDef)
}


def names_in(node: ast.AST) -> set[str]:
    """All names in an expression, the last part of each dotted one."""
    return {
        n.id if isinstance(n, ast.Name) else n.attr
        for n in ast.walk(node)
        if isinstance(n, ast.Name | ast.Attribute)
    }


def classes_asked_for(path: Path) -> set[str]:
    """Classes of laws by which a file branches: `isinstance`, `type(x) in` and `case`."""
    asked: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Call) and names_in(node.func) & {"isinstance", "issubclass"}:
            asked |= names_in(node.args[1])
        elif isinstance(node, ast.Compare) and "type" in names_in(node.left):
            asked |= set().union(*(names_in(c) for c in node.comparators))
        elif isinstance(node, ast.MatchClass):
            asked |= names_in(node.cls)
    return asked & LAWS


@all_of("app", "forms", "meshes")
def test_layering_no_branches_by_class_of_law(path: Path) -> None:
    """Laws, loads, supports, materials and heat conditions answer by methods and attributes."""
    if path.is_relative_to(ROOT / "app" / "laws"):
        return
    assert not classes_asked_for(path)


def test_layering_branch_by_class_is_detected(tmp_path: Path) -> None:
    file = tmp_path / "branch.py"
    file.write_text(
        "a = isinstance(load, Force)\nb = type(law) in (Bonded,)\n"
        "match s:\n    case supports.Fixed():\n        pass\nc = isinstance(x, str)\n"
    )
    assert classes_asked_for(file) == {"Force", "Bonded", "Fixed"}


def test_layering_comparison_of_kinds_is_detected(tmp_path: Path) -> None:
    file = tmp_path / "kinds.py"
    file.write_text(
        "a = law.kind == 'bonded'\nb = 'force' != load.kind\n"
        "c = {'contact'} & {law.kind for law in laws}\nd = f'{law.kind} of {name}'\n"
    )
    assert kinds_compared(file) == [1, 2, 3]


@all_of(
    "app/case",
    "app/fatigue",
    "app/laws",
    "app/mechanics",
    "app/press_fit",
    "app/remodelling",
    "app/report",
    "app/stepping",
)
def test_layering_fields_are_declared(path: Path) -> None:
    """`getattr` with a default hides a field that no class declares."""
    calls = (n for n in ast.walk(tree(path)) if isinstance(n, ast.Call))
    assert not [n.lineno for n in calls if names_in(n.func) == {"getattr"} and len(n.args) > 2]


def test_layering_saved_attributes_are_public() -> None:
    """Names in ``saved`` begin without an underscore: a checkpoint holds no private attribute."""
    private = []
    for path in sorted((ROOT / "app").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            targets = node.targets if isinstance(node, ast.Assign) else []
            if isinstance(node, ast.AnnAssign):
                targets = [node.target]
            if not any(isinstance(t, ast.Name) and t.id == "saved" for t in targets):
                continue
            assert isinstance(node, ast.Assign | ast.AnnAssign)
            texts = [n.value for n in ast.walk(node) if isinstance(n, ast.Constant)]
            private += [f"{path.name}: {t}" for t in texts if str(t).startswith("_")]
    assert private == []
