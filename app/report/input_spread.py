"""Spread of a run's numbers over uncertain inputs, next to the error of its mesh."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from app.campaigns import uncertainty
from app.case.quantities import Quantity, label_with_unit
from app.case.summary import Numbers
from app.case.summary_numbers import main_numbers
from app.foundation.errors import InputError
from app.foundation.layout import leaves, plain_text, two_digits
from app.report.sweep_keys import key_in_words
from app.report.sweep_results import SweptCase, read

# Fewest samples for a 5th and a 95th percentile.
FEWEST_SAMPLES = 10
# Keys in which a sample may differ from the run: numerical settings, and keys that the uncertain
# inputs determine.
FREE_KEYS = {"title", "mesh", "solver", "output", "at", "status", "source"}
HEAD_OF_SPREAD = (
    "",
    "value",
    "± of the mesh",
    "5 to 95 % over inputs",
    "follows most (rank correlation)",
)


@dataclass(frozen=True)
class InputSpread:
    """Samples of a run's case over uncertain inputs.

    Attributes:
        samples: The samples that converged.
        drawn: Number of all samples.
        inputs: Value of each input in the converged samples, by key.
    """

    samples: Sequence[SweptCase]
    drawn: int
    inputs: Mapping[str, Sequence[object]]

    def range_of(self, name: str) -> tuple[float, float, str] | None:
        """Return the 5th and 95th percentile of a number, and the input with most effect on it.

        Percentiles are in the printed unit. The input is empty if no rank correlation exceeds
        2 / sqrt(samples), which one of 20 unrelated inputs reaches by chance. None if a sample
        does not have the number or if it does not vary.
        """
        numbers = [sample.number(name) for sample in self.samples]
        values = [number.value for number in numbers if number]
        if len(values) < len(self.samples):
            return None
        spread = uncertainty.of_number(values, self.inputs)
        if spread["deviation"] <= uncertainty.ROUNDING_RANGE or not spread["correlation"]:
            return None
        strongest_input, rank = max(spread["correlation"].items(), key=lambda item: abs(item[1]))
        is_clear = abs(rank) > 2.0 / len(values) ** 0.5
        return (
            spread["p5"],
            spread["p95"],
            f"{key_in_words(strongest_input)} ({rank:+.2f})" if is_clear else "",
        )

    def cells(self, name: str, q: Quantity, numbers: Numbers) -> list[str]:
        """Return the cells of a number in a table with the head `HEAD_OF_SPREAD`."""
        value, _, error = q.text(numbers).partition(" ± ")
        lowest, highest, strongest = self.range_of(name) or (None, None, "-")
        range_text = "-" if lowest is None else f"{lowest:.{q.digits}f} to {highest:.{q.digits}f}"
        return [label_with_unit(name), value, error or "-", range_text, strongest or "none clearly"]

    def sentence(self, run: SweptCase) -> str:
        """Compare mesh and inputs as sources of uncertainty of the main numbers, in sentences."""
        ratios, causes = list[float](), Counter[str]()
        for name, q, _, _ in main_numbers(run.summary):
            spread = self.range_of(name) if q.order else None
            if spread:
                lowest, highest, cause = spread
                n = run.number(name)
                causes.update([cause.rpartition(" (")[0]])
                ratios += [0.5 * (highest - lowest) / n.error] if n and n.error else []
        del causes[""]
        strongest = "".join(f"; {c} matters most, to {k} of them" for c, k in causes.most_common(1))
        if not ratios:
            return (
                f"The ± of main numbers was not estimated, so the two are not compared{strongest}."
            )
        larger, middle = sum(ratio > 1.0 for ratio in ratios), statistics.median(ratios)
        comparison = "Inputs matter more than the mesh"
        if middle <= 1.0:
            comparison = "The mesh matters more than the inputs"
        size = self.samples[0].data["mesh"].get("size", "the file")
        return (
            f"{comparison}: half the range from 5 to 95 % over {len(self.inputs)} inputs exceeds "
            f"the ± for {larger} of {len(ratios)} main numbers; the median ratio is "
            f"{two_digits(middle)}{strongest}. The range is from {len(self.samples)} of"
            f" {self.drawn} samples on meshes of {size}."
        )


def input_spread_of_run(folder: Path, run: SweptCase) -> InputSpread:
    """Read the samples of a run's case from the folder of a sweep.

    Raises:
        InputError: The folder is not a sweep over uncertain inputs, the sweep is of another case,
            or it has too few samples.
    """
    sweep, option = read(folder), f"--spread {folder}"
    if len(sweep.uncertainty) != 1:
        raise InputError(f"{option}: expected one part with converged samples (latin_hypercube)")
    ((part, spread),) = sweep.uncertainty.items()
    keys: dict[str, None] = {}
    for number in spread["numbers"].values():
        keys |= dict.fromkeys(number["correlation"])
    drawn_cases = [c for c in sweep.cases if c.part == part]
    differences = {
        c.name: next(_differences(run.data, c.data, keys), "") for c in drawn_cases if c.done
    }
    samples = [c for c in drawn_cases if c.done and not differences[c.name]]
    if len(samples) < FEWEST_SAMPLES:
        too_few = (
            f"{len(samples)} samples converged; the 5th and 95th percentile need {FEWEST_SAMPLES}"
        )
        other_case = f"is of another case than {run.folder}: {next(iter(differences.values()))}"
        raise InputError(f"{option}: {too_few if samples else other_case}")
    inputs = {}
    for key in keys:
        inputs[key] = [sample.overrides[key] for sample in samples]
    return InputSpread(samples, len(drawn_cases), inputs)


def _differences(
    run: Mapping[str, object], sample: Mapping[str, object], inputs: Iterable[str]
) -> Iterator[str]:
    """Yield the keys other than inputs in which a sample differs from the run, with both values."""
    input_keys = [key.partition("[")[0] for key in inputs]
    of_run, of_sample = dict(leaves(run)), dict(leaves(sample))
    for key in of_run | of_sample:
        is_free = not FREE_KEYS.isdisjoint(key.split("."))
        is_input = any(f"{key}.".startswith(f"{input_key}.") for input_key in input_keys)
        value, other = of_run.get(key), of_sample.get(key)
        if value != other and not is_free and not is_input:
            yield f"{key} is {plain_text(other)} there, not {plain_text(value)}"
