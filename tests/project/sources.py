"""The source of the program: its modules, and what each of them imports."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("app", "configs", "forms", "meshes")


def sources(*folders: str) -> list[Path]:
    """Return all modules in folders."""
    return sorted(p for folder in folders for p in (ROOT / folder).rglob("*.py"))


def named(path: Path) -> str:
    """Return the path of a file from the top folder."""
    return str(path.relative_to(ROOT))


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def module(path: Path) -> str:
    """Return the name of the module in a file."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


MODULES = {module(path): path for path in [ROOT / "mantle.py", *sources(*FOLDERS)]}


def run_time_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and all below it that a program runs, without imports for type checkers."""
    yield node
    is_for_types = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    for part in node.orelse if is_for_types else ast.iter_child_nodes(node):
        yield from run_time_nodes(part)


@cache
def imported(path: Path) -> frozenset[str]:
    """Return all modules that a file imports when it runs, also inside functions."""
    this = module(path)
    names_of_modules = set()
    for node in run_time_nodes(tree(path)):
        if isinstance(node, ast.Import):
            names_of_modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}:{node.lineno}: a relative import"
            base = str(node.module)
            names = {f"{base}.{alias.name}" for alias in node.names}
            names_of_modules |= {name if name in MODULES else base for name in names}
    return frozenset(names_of_modules - {this})


def top(name: str) -> str:
    """Return the top package of a module."""
    return name.split(".")[0]
