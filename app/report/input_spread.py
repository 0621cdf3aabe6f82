"""Spread of a run's numbers over inputs that are not known well, beside the ± of its mesh."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.campaigns import uncertainty
from app.case.quantities import TABLE, Quantity, numbers_of
from app.errors import InputError
from app.report.sweep_figures import title
from app.report.sweep_results import SweptCase, magnitude, read
from app.system.layout import plain

# Fewest samples of which the 5th and the 95th percentile are told.
FEWEST = 10
# Keys that may differ between a run and samples of its case: how it is solved, points that follow
# the geometry, and what goes with a changed value.
FREE = ("title", "mesh", "solver", "output", "at", "status", "source")
HEAD = ("", "", "value", "± of the mesh", "5 to 95 % over inputs", "follows most")


@dataclass(frozen=True)
class InputSpread:
    """Converged samples of the case of a run.

    Attributes:
        drawn: Number of samples, with those that failed.
        inputs: Value of each uncertain input in each sample, by key.
    """

    folder: Path
    samples: Sequence[SweptCase]
    drawn: int
    inputs: Mapping[str, Sequence[float]]

    def of(self, name: str) -> tuple[float, float, str] | None:
        """Percentiles of a number in its unit for people, and the input that it follows most.

        Numbers without relation reach a rank correlation of 2 / sqrt(samples) in one of 20 cases:
        below it no input is named. None if the number does not vary, or a sample lacks it.
        """
        found = [n.value for c in self.samples if (n := c.number(name))]
        if len(found) < len(self.samples):
            return None
        spread = uncertainty.spread(found, self.inputs)
        if spread["deviation"] <= uncertainty.NOTHING:
            return None
        rank, most = max(((r, key) for key, r in spread["correlation"].items()), key=_size)
        clear = abs(rank) > 2.0 / len(found) ** 0.5
        return spread["p5"], spread["p95"], f"{title(most)} ({rank:+.2f})" if clear else ""

    def cells(self, name: str, q: Quantity, numbers: Mapping[str, Any]) -> list[str]:
        """Cells of a number below `HEAD`, from its value on."""
        value, _, error = q.text(numbers).partition(" ± ")
        if (found := self.of(name)) is None:
            return [value, error or "-", "-", "-"]
        low, high = (f"{end:.{q.digits}f}" for end in found[:2])
        return [value, error or "-", f"{low} to {high}", found[2] or "none clearly"]

    @property
    def about(self) -> str:
        """What the samples are."""
        mesh, inputs = self.samples[0].data["mesh"], "; ".join(map(title, self.inputs))
        return (
            f"Inputs: {len(self.samples)} of {self.drawn} samples in {self.folder}, on meshes of "
            f"{mesh['size']} at order {mesh['order']}, of {inputs}. In brackets: rank correlation."
        )

    def sentence(self, run: SweptCase) -> str:
        """Which of mesh and inputs dominates the main numbers, and the input that does."""
        ratios, causes = list[float](), Counter[str]()
        for name in _headlines(run.summary):
            n, found = run.number(name), self.of(name)
            if n and found:
                causes.update([found[2].rpartition(" (")[0]] if found[2] else [])
                ratios += [0.5 * (found[1] - found[0]) / n.error] if n.error else []
        over = f"over {len(self.samples)} samples of {len(self.inputs)} inputs"
        top = causes.most_common(1)
        most = "".join(f"; {key} matters most, to {n} of the main numbers" for key, n in top)
        if not ratios:
            return f"Mesh and inputs cannot be compared, as no ± was estimated{most}."
        larger = sum(ratio > 1.0 for ratio in ratios)
        inputs = 2 * larger > len(ratios)
        first = "Inputs dominate the mesh" if inputs else "The mesh dominates the inputs"
        return (
            f"{first}: {over} half the range from 5 to 95 % exceeds "
            f"the ± of the mesh for {larger} of {len(ratios)} main numbers, and is "
            f"{statistics.median(ratios):.2g} times it in the median{most}."
        )


def of_run(folder: Path, run: SweptCase) -> InputSpread:
    """Read the samples of a run's case from the folder of a sweep.

    Raises:
        InputError: It is no such sweep, one of another case, or has too few samples.
    """
    sweep, where = read(folder), f"--spread {folder}"
    if len(sweep.uncertainty) != 1:
        text = f"{len(sweep.uncertainty)} parts with samples of uncertain inputs that converged"
        raise InputError(f"{where}: {text}; expected one (latin_hypercube)")
    ((part, spread),) = sweep.uncertainty.items()
    keys = dict.fromkeys(key for s in spread["numbers"].values() for key in s["correlation"])
    drawn = [c for c in sweep.cases if c.part == part]
    others = {c.name: next(_differences(run.data, c.data, keys), "") for c in drawn if c.done}
    samples = [c for c in drawn if c.done and not others[c.name]]
    if not samples:
        first = next(iter(others.values()))
        raise InputError(f"{where}: is of another case than {run.folder}: {first}")
    if len(samples) < FEWEST:
        text = f"{len(samples)} samples converged; the 5th and 95th percentile need {FEWEST}"
        raise InputError(f"{where}: {text}")
    inputs = {key: [magnitude(c.overrides[key]) or 0.0 for c in samples] for key in keys}
    return InputSpread(folder, samples, len(drawn), inputs)


def _differences(run: Any, sample: Any, inputs: Iterable[str], path: str = "") -> Iterator[str]:
    """Keys in which a sample differs from the run, but for its inputs, with both values."""
    if isinstance(run, dict) and isinstance(sample, dict):
        for key in (run | sample).keys() - set(FREE):
            below = f"{path}.{key}".removeprefix(".")
            yield from _differences(run.get(key), sample.get(key), inputs, below)
    elif run != sample and not any(
        f"{path}.".startswith(f"{k.partition('[')[0]}.") for k in inputs
    ):
        yield f"{path} is {plain(sample)} there, not {plain(run)}"


def _headlines(summary: Mapping[str, Any]) -> list[str]:
    """Names of the main numbers of a run that have an error."""
    return [
        f"{name}.{key}"
        for section, name, numbers in numbers_of(summary)
        for key, q in TABLE[section].items()
        if q.headline and q.order and key in numbers
    ]


def _size(ranked: tuple[float, str]) -> float:
    return abs(ranked[0])
