"""Every shipped case on 1 to 4 ranks, and on ranks that share it in the worst ways."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import support
from tests.command_line.test_run import COARSE

pytestmark = [pytest.mark.slow, pytest.mark.parallel]
# Residuals are below 1e-10 of the force scale (the default of `solver.tolerance`). A jump answers a
# residual at its own node by at most some thousand times what it answers the whole load by.
TOLERANCE = 1e-6
# What tells of the machine, or is nothing but rounding.
ASIDE = ("solver", "timing", "cpu", "memory", "balance", "units")
# Four ranks share two cores here: first order where the shipped second is tested elsewhere.
COARSER = {name: ["mesh.order=1"] for name in ("stance.yaml", "stance_cocr.yaml", "intact.yaml")}
Summaries = dict[str, dict[str, Any]]


def numbers(value: dict[str, Any], *path: str) -> Iterator[tuple[tuple[str, ...], float]]:
    """The numbers of a nested table with their places."""
    for key, inside in value.items():
        if isinstance(inside, dict):
            yield from numbers(inside, *path, key)
        elif key.endswith(("_at", "_time")):
            continue
        else:
            for k, one in enumerate(inside if isinstance(inside, list) else [inside]):
                if isinstance(one, int | float) and not isinstance(one, bool):
                    yield (*path, f"{key}" if k == 0 else f"{key}.{k}"), float(one)


def run(name: str, ranks: int, output: Path, way: str = "") -> Summaries:
    """Summaries of a coarsened case by folder: one, or that of each variation."""
    program = ["-m", "tests.parallel.divided"] if way else ["-m", "mantle"]
    overrides = COARSE[name] + COARSER.get(name, [])
    sets = [word for o in overrides for word in ("--set", o)]
    done = subprocess.run(
        support.mpirun(ranks, *program, "run", support.CONFIGS / name, "-o", output, *sets),
        env=support.environment() | {"DIVIDED": way},
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr
    assert (output / "DONE").exists() and ("divided: " in done.stdout) == bool(way)
    found = {}
    for path in output.glob("**/summary.json"):
        found[os.path.relpath(path.parent, output)] = json.loads(path.read_text())
    return found


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Summaries]:
    """Every case on one rank, as far as asked for."""
    folder = tmp_path_factory.mktemp("alone")

    class Found(dict[str, Summaries]):
        def __missing__(self, name: str) -> Summaries:
            self[name] = run(name, 1, folder / name)
            return self[name]

    return Found()


def compare(one: Summaries, other: Summaries, ranks: int, size: float) -> None:
    """The same numbers, each by the largest of its kind.

    Args:
        one: On one rank.
        other: On several.
        ranks: How many.
        size: Of the cells at interfaces [mm].
    """
    assert one.keys() == other.keys()
    for folder, expected in one.items():
        assert other[folder]["solver"]["ranks"] == ranks
        assert other[folder]["solver"]["dofs"] == expected["solver"]["dofs"]
        assert max(v for k, v in other[folder]["balance"].items() if k != "heat_quadrature") < 1e-8
        a, b = (
            dict(numbers({k: v for k, v in s.items() if k not in ASIDE}))
            for s in (expected, other[folder])
        )
        assert a.keys() == b.keys()
        largest: dict[tuple[str, str], float] = {}
        for path, value in a.items():
            kind = path[0], path[-1].partition("_")[0]
            largest[kind] = max(abs(value), largest.get(kind, 0.0))
        wrong = []
        for path, value in a.items():
            limit = TOLERANCE * largest[path[0], path[-1].partition("_")[0]]
            if abs(b[path] - value) > max(limit, 1e-12):
                wrong.append((".".join(path), value, b[path], limit))
        assert not wrong, (folder, wrong)


def size(name: str) -> float:
    (text,) = [o for o in COARSE[name] if o.startswith("mesh.size=")]
    return float(text.removeprefix("mesh.size=").removesuffix(" mm"))


@pytest.mark.parametrize("ranks", [2, 3, 4])
@pytest.mark.parametrize("name", COARSE)
def test_ranks(name: str, ranks: int, alone: dict[str, Summaries], tmp_path: Path) -> None:
    compare(alone[name], run(name, ranks, tmp_path / "out"), ranks, size(name))


@pytest.mark.parametrize(("way", "ranks"), [("board", 2), ("bodies", 3), ("far", 3)])
@pytest.mark.parametrize("name", COARSE)
def test_shares(
    name: str, way: str, ranks: int, alone: dict[str, Summaries], tmp_path: Path
) -> None:
    compare(alone[name], run(name, ranks, tmp_path / "out", way), ranks, size(name))
