"""Results of the shipped cases, frozen: a change that should move no number is compared with them.

    python3 -m tests.frozen write           run the shipped cases and freeze their numbers
    python3 -m tests.frozen compare 1e-10   run them again and print what moved by more

Names of cases after that choose some of them. `tests/verification/test_frozen.py` compares with a
tolerance that holds on every processor.

Frozen numbers are not known answers (`mantle verify` has those): they tell that something moved.
A change that moves them on purpose writes them anew and says in its commit which and why.
"""

from __future__ import annotations

import csv
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from tests import support

FROZEN = support.ROOT / "tests" / "reference" / "frozen"
CASES = ("blocks", "cylinders", "thermal_rings", "intact", "stance", "stance_cocr", "cure")
LONG = ("thermal_100C", "residual", "variations")
# What depends on the machine, on its load, or on rounding alone.
VOLATILE = ("timing", "cpu", "memory", "balance", "force_error", "solver", "mantle")
SECONDS = ("wall [s]", "step [s]")
TINY = 1e-9  # in the units of the summary: what is smaller is rounding


def numbers(folder: Path) -> dict[str, float]:
    """Read the numbers of a run: its summaries and the last row of its histories, by their path."""
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("summary.json")):
        prefix = path.parent.relative_to(folder).as_posix()
        found |= dict(leaves(json.loads(path.read_text("utf-8")), f"{prefix}:summary"))
    for path in sorted(folder.rglob("history.csv")):
        prefix = path.parent.relative_to(folder).as_posix()
        with path.open(encoding="utf-8", newline="") as file:
            last = list(csv.DictReader(file))[-1]
        for name, text in last.items():
            with suppress(ValueError):
                found[f"{prefix}:history.{name}"] = float(text)
    return {
        name: float(value)
        for name, value in found.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and not _volatile(name)
    }


def leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """The values inside a table of tables and lists, by their dotted path."""
    if not isinstance(value, dict | list):
        yield path, value
        return
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        yield from leaves(inner, f"{path}.{key}")


def moved(old: dict[str, float], new: dict[str, float], tolerance: float) -> list[str]:
    """Name the numbers that differ by more than a relative tolerance, or that only one side has."""
    lines = [f"{name}: only before" for name in sorted(old.keys() - new.keys())]
    lines += [f"{name}: only now" for name in sorted(new.keys() - old.keys())]
    for name in sorted(old.keys() & new.keys()):
        a, b = old[name], new[name]
        if not abs(a - b) <= TINY + tolerance * max(abs(a), abs(b)):
            lines.append(f"{name}: {a!r} became {b!r}")
    return lines


def solve(name: str) -> dict[str, float]:
    """Run a shipped case on one rank and read its numbers."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / name
        case = support.CONFIGS / f"{name}.yaml"
        support.python("-m", "mantle", "run", case, "-o", output, timeout=7200)
        return numbers(output)


def frozen(name: str) -> dict[str, float]:
    """Read the frozen numbers of a shipped case."""
    found: dict[str, float] = json.loads((FROZEN / f"{name}.json").read_text("utf-8"))
    return found


def _volatile(path: str) -> bool:
    parts = path.split(":", 1)[1].split(".")
    # Where a maximum is jumps between places that are equal but for rounding.
    volatile = any(part in VOLATILE or part.endswith("_at") for part in parts)
    return volatile or path.endswith(SECONDS)


def main(arguments: list[str]) -> int:
    """Write or compare; the exit code tells whether a number moved."""
    bad = 0
    for name in arguments[1 + (arguments[0] == "compare") :] or (*CASES, *LONG):
        found = solve(name)
        if arguments[0] == "write":
            text = json.dumps(found, indent=0, sort_keys=True)
            (FROZEN / f"{name}.json").write_text(text + "\n", "utf-8")
            print(f"{name}: {len(found)} numbers", flush=True)
            continue
        lines = moved(frozen(name), found, float(arguments[1]))
        print(f"{name}: {len(found)} numbers, {len(lines)} moved", *lines, sep="\n  ", flush=True)
        bad += len(lines)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
