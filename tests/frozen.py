"""Ten numbers of each shipped case, frozen: a change that should move none is compared with them.

    python3 -m tests.frozen compare 1e-10   run the shipped cases, print the numbers that moved
    python3 -m tests.frozen write           run them and freeze their new numbers
    python3 -m tests.frozen all DIR         run them and write all of their numbers to DIR

Names of cases after these words choose some of them. `tests/reference/frozen.json` holds the
numbers of each case: to freeze one more, add its name with any value and write. The two stances
have the numbers of the table of the README, which `docs/outputs.py` reads.
`tests/verification/test_frozen.py` compares with a tolerance that holds on every processor.

Frozen numbers are not known answers (`mantle verify` has those): they show that a result moved.
A change that moves them on purpose writes the new ones. Its commit says which and why.
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

FROZEN = support.ROOT / "tests" / "reference" / "frozen.json"
CASES = (
    "blocks",
    "cylinders",
    "thermal_rings",
    "intact",
    "stance",
    "stance_cocr",
    "pressed",
    "collar",
    "cure",
)
LONG = ("thermal_100C", "residual", "variations")
# Numbers that depend on the machine, on its load, or on rounding alone.
VOLATILE = ("timing", "cpu", "memory", "balance", "force_error", "solver", "mantle")
SECONDS = ("wall [s]", "step [s]")
TINY = 1e-9  # rounding, in the units of the summary


def numbers(folder: Path) -> dict[str, float]:
    """Numbers of a run by their path: its summaries and the last row of its histories."""
    values: dict[str, Any] = {}
    for path in sorted(folder.rglob("summary.json")):
        prefix = path.parent.relative_to(folder).as_posix()
        values |= dict(leaves(json.loads(path.read_text("utf-8")), f"{prefix}:summary"))
    for path in sorted(folder.rglob("history.csv")):
        prefix = path.parent.relative_to(folder).as_posix()
        with path.open(encoding="utf-8", newline="") as file:
            last = list(csv.DictReader(file))[-1]
        for name, text in last.items():
            with suppress(ValueError):
                values[f"{prefix}:history.{name}"] = float(text)
    return {
        name: float(value)
        for name, value in values.items()
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
    """Name the old numbers that are missing or differ by more than a relative tolerance."""
    lines = []
    for name, before in sorted(old.items()):
        if name not in new:
            lines.append(f"{name}: missing")
            continue
        now = new[name]
        limit = TINY + tolerance * max(abs(before), abs(now))
        if not abs(before - now) <= limit:  # also if one of them is not a number
            lines.append(f"{name}: {before!r} became {now!r}")
    return lines


def solve(name: str) -> dict[str, float]:
    """Run a shipped case on one rank and read its numbers."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / name
        case = support.CONFIGS / f"{name}.yaml"
        support.python("-m", "mantle", "run", case, "-o", output, timeout=7200)
        return numbers(output)


def frozen() -> dict[str, dict[str, float]]:
    """Read the frozen numbers of the shipped cases."""
    cases: dict[str, dict[str, float]] = json.loads(FROZEN.read_text("utf-8"))
    return cases


def _volatile(path: str) -> bool:
    parts = path.split(":", 1)[1].split(".")
    # Where a maximum is jumps between places that are equal but for rounding.
    volatile = any(part in VOLATILE or part.endswith("_at") for part in parts)
    return volatile or path.endswith(SECONDS)


def main(action: str, arguments: list[str]) -> int:
    """Write or compare; the exit code shows if a number moved."""
    given = "" if action == "write" else arguments.pop(0)
    cases = frozen()
    bad = 0
    for name in arguments or (*CASES, *LONG):
        numbers = solve(name)
        if action == "all":
            folder = Path(given)
            folder.mkdir(parents=True, exist_ok=True)
            text = json.dumps(numbers, indent=1, sort_keys=True)
            (folder / f"{name}.json").write_text(text + "\n", "utf-8")
        elif action == "write":
            cases[name] = {key: numbers[key] for key in cases[name]}
            FROZEN.write_text(json.dumps(cases, indent=1) + "\n", "utf-8")
            print(f"{name}: {len(cases[name])} numbers", flush=True)
        else:
            lines = moved(cases[name], numbers, float(given))
            print(f"{name}: {len(lines)} of {len(cases[name])} numbers moved", *lines, sep="\n  ")
            bad += len(lines)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
