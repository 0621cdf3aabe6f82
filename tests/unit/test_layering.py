"""Who may import, print and choose: the layers of the program, read from its source."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LAYERS = ("app", "forms", "meshes")


def sources(*folders: str) -> list[Path]:
    return sorted(p for folder in folders for p in (ROOT / folder).rglob("*.py"))


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imported(path: Path) -> Iterator[str]:
    """Dotted names of the modules that a file imports, wherever in it."""
    package = path.parent.relative_to(ROOT).as_posix().replace("/", ".")
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or "" if not node.level else f"{package}.{node.module or ''}"


def top(name: str) -> str:
    return name.split(".")[0]


def all_of(*folders: str) -> object:
    return pytest.mark.parametrize("path", sources(*folders), ids=named)


@all_of("forms")
def test_forms_import_only_ufl(path: Path) -> None:
    allowed = sys.stdlib_module_names | {"ufl", "forms"}
    assert {m for m in imported(path) if top(m) not in allowed} == set()


@all_of("meshes")
def test_meshes_know_nothing_of_the_application(path: Path) -> None:
    """Its errors and expressions apart, which need no stack and belong to no layer above."""
    allowed = {"mantle.errors"}
    assert {m for m in imported(path) if top(m) == "app"} - allowed == set()
    assert "forms" not in set(map(top, imported(path)))


@all_of("meshes")
def test_only_distribution_needs_the_solver(path: Path) -> None:
    """Meshing is serial and works without dolfinx."""
    if path.name == "distribute.py":
        return
    assert not {"dolfinx", "petsc4py", "ufl"} & set(map(top, imported(path)))


@all_of(*LAYERS)
def test_only_the_command_line_prints(path: Path) -> None:
    calls = [
        node.lineno
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "print"
    ]
    assert not calls or named(path) == "app/cli.py"


def config_patterns(path: Path) -> list[str]:
    """Names in patterns of `match` statements that belong to the configuration."""
    found = []
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.MatchClass):
            name = ast.unparse(node.cls)
            if name.startswith("config."):
                found.append(name)
    return found


@all_of("app")
def test_only_the_scene_chooses_by_configuration(path: Path) -> None:
    """Interfaces, supports, loads and materials become terms in one place."""
    if named(path) in ("app/scene/build.py", "app/scene/build_heat.py"):
        assert len(config_patterns(path)) > 8
        return
    assert config_patterns(path) == []
    chosen = {
        "Bonded",
        "Contact",
        "Penalty",
        "Isotropic",
        "TransverselyIsotropic",
        "Roller",
        "Fixed",
    }
    # The solver's side of the program does not even see the configuration's classes.
    solving = (
        "terms",
        "mechanics",
        "bodies",
        "jumps",
        "points",
        "problem",
        "solver",
        "systems",
        "motion",
        "stepping",
        "conduction",
        "cure_heat",
        "curing",
        "coupling",
        "expansion",
        "heat_forms",
        "heat_loads",
        "heat_matrices",
        "heat_system",
        "heating",
        "integrator",
        "monotone",
        "pointwise",
        "setting",
        "temperature_jumps",
        "thermal_nodes",
        "thermal_quantities",
    )
    if path.stem in (*solving, "balance", "heat_balance", "quantities", "diagnosis"):
        assert not {
            m
            for m in imported(path)
            if m.startswith(("mantle.schema.config", "mantle.schema.materials"))
        }
        text = ast.unparse(tree(path))
        assert not {c for c in chosen - {"Contact"} if f"config.{c}" in text}


@all_of("app")
def test_only_the_configuration_knows_yaml(path: Path) -> None:
    allowed = {"app/schema/config.py", "app/schema/case_file.py"}
    if any(top(m) == "ruamel" for m in imported(path)):
        assert named(path) in allowed


@all_of("app", "forms")
def test_no_communicator_of_the_whole_world_but_at_the_top(path: Path) -> None:
    """Everything below takes the communicator it is given."""
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


@all_of(*LAYERS)
def test_no_star_imports_and_no_leftovers(path: Path) -> None:
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ImportFrom):
            assert all(alias.name != "*" for alias in node.names), node.lineno
        if isinstance(node, ast.FunctionDef):
            defaults = [*node.args.defaults, *filter(None, node.args.kw_defaults)]
            mutable = [d for d in defaults if isinstance(d, ast.List | ast.Dict | ast.Set)]
            assert not mutable, f"{node.name} has a mutable default"
