"""What is told of Gruen zones on one rank and on two."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import support

COARSE = (
    *("mesh.size=6 mm", "mesh.order=1", "stages.0.increments=1", "solver.tolerance=1e-12"),
    *("output.error=false", "output.fields=false"),
)


def numbers(value: dict[str, Any], *path: str) -> Iterator[tuple[tuple[str, ...], float]]:
    """The numbers of a nested table with their places."""
    for key, inside in value.items():
        if isinstance(inside, dict):
            yield from numbers(inside, *path, key)
        else:
            yield (*path, key), float(inside)


@pytest.mark.parallel
def test_zones_do_not_depend_on_the_number_of_ranks(tmp_path: Path) -> None:
    overrides = [word for o in COARSE for word in ("--set", o)]
    found = []
    for ranks in (1, 2):
        output, case = tmp_path / str(ranks), support.CONFIGS / "stance.yaml"
        support.on_ranks(ranks, "-m", "mantle", "run", case, "-o", output, *overrides)
        summary = json.loads((output / "summary.json").read_text())
        found.append({key: dict(numbers(summary[key])) for key in ("gruen", "mantle")})
    one, two = found
    assert one["mantle"] == two["mantle"]
    one, two = one["gruen"], two["gruen"]
    assert one.keys() == two.keys() and len(one) > 200
    largest: dict[str, float] = {}
    for path, value in one.items():
        largest[path[-1]] = max(abs(value), largest.get(path[-1], 0.0))
    for path, value in one.items():
        assert abs(two[path] - value) <= 1e-6 * largest[path[-1]], path
