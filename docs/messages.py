"""Catalogue of messages: every error, note, warning, verdict and remedy of the program.

Run ``python3 docs/messages.py`` in the root of the repository. It reads the source and the script
``mantle``. It writes one line for each message: file, line, the function that gives it and the
text. Values that a message shows are written in braces. Read the catalogue alone, as a user who
sees one message.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("app", "meshes", "forms", "configs")
LAUNCHER = "mantle"
# Messages of the launcher: its functions `say` and `die` with one or more texts.
SHELL_CALL = re.compile(r'\b(say|die)((?:\s+\\?\s*"(?:[^"\\]|\\.)*")+)')
SHELL_TEXT = re.compile(r'"((?:[^"\\]|\\.)*)"')
# Calls whose texts a user sees.
CALLS = {
    *("fail", "Fault", "BadYaml", "Verdict", "note", "replace", "error", "warning", "info"),
    *("print", "InputError", "GeometryError", "ConvergenceError", "EnvironmentProblem"),
    *("StoppedError", "UnusableError", "MantleError", "say", "warn", "debug", "complain"),
    "ValueError",
}
# Shortest text that is a message and not a word.
SHORTEST = 12


def main() -> int:
    """Print the catalogue."""
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            for line, call, text in messages(ast.parse(path.read_text(encoding="utf-8"))):
                sys.stdout.write(f"{path.relative_to(ROOT)}:{line}: {call}: {text}\n")
    for line, call, text in launcher_messages((ROOT / LAUNCHER).read_text(encoding="utf-8")):
        sys.stdout.write(f"{LAUNCHER}:{line}: {call}: {text}\n")
    return 0


def launcher_messages(script: str) -> Iterator[tuple[int, str, str]]:
    """Line, function and text of each message of a shell script, in order."""
    for match in SHELL_CALL.finditer(script):
        line = script.count("\n", 0, match.start()) + 1
        yield line, match[1], " ".join(SHELL_TEXT.findall(match[2]))


def messages(tree: ast.AST) -> list[tuple[int, str, str]]:
    """Line, call and text of each message of a module, in order."""
    catalogue: dict[tuple[int, str], str] = {}
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.Module)]
    for function in functions:
        calls = [n for n in _within(function) if isinstance(n, ast.Call) and _name(n) in CALLS]
        for call in calls:
            for argument in [*call.args, *(keyword.value for keyword in call.keywords)]:
                for text in _texts(argument):
                    catalogue.setdefault((call.lineno, text), _name(call))
        # Texts that are put together in variables before the call.
        used = {n.id for call in calls for n in ast.walk(call) if isinstance(n, ast.Name)}
        for node in _within(function):
            targets = node.targets if isinstance(node, ast.Assign) else []
            if isinstance(node, ast.AugAssign):
                targets = [node.target]
            names = {
                n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)
            }
            if names & used:
                for text in _texts(node.value):
                    catalogue.setdefault((node.lineno, text), "text")
            if (
                isinstance(node, ast.Return | ast.Yield)
                and node.value
                and isinstance(function, ast.FunctionDef)
            ):
                for text in _texts(node.value):
                    if " " in text and len(text) > 3 * SHORTEST:
                        catalogue.setdefault((node.lineno, text), "returned")
    rows = {(line, call, text) for (line, text), call in catalogue.items()}
    return sorted(rows)


def _within(function: ast.AST) -> Iterator[ast.AST]:
    """Nodes of a function without those of functions inside it."""
    for node in ast.iter_child_nodes(function):
        yield node
        if not isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield from _within(node)


def _name(call: ast.Call) -> str:
    function = call.func
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def _texts(node: ast.AST) -> Iterator[str]:
    """Texts in an expression with more than one word, values in braces."""
    if isinstance(node, ast.Constant):
        text = node.value if isinstance(node.value, str) else ""
    elif isinstance(node, ast.JoinedStr):
        text = "".join(
            str(part.value) if isinstance(part, ast.Constant) else f"{{{ast.unparse(part.value)}}}"
            for part in node.values
            if isinstance(part, ast.Constant | ast.FormattedValue)
        )
    else:
        for child in ast.iter_child_nodes(node):
            yield from _texts(child)
        return
    if len(text) >= SHORTEST and " " in text.strip():
        yield " ".join(text.split())


if __name__ == "__main__":
    sys.exit(main())
