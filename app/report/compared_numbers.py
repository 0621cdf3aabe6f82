"""Comparison of the numbers of several runs: which differ, by how much, and how surely.

Every number that two runs have in common is compared: of interfaces, regions, the stem, the femur,
its strains, Gruen zones, temperatures and added sections. Costs and balances of a run are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

from app.case import number_text, quantities, summary_numbers
from app.case.number_text import Number
from app.report.gruen import KJ
from app.report.sweep_results import Json, SweptCase, named

# Sections of a summary on the solution process; they hold no results.
NOT_COMPARED = quantities.RUN_SECTIONS
# Name of the group of numbers by Gruen zone.
ZONES = "Gruen zones"


@dataclass(frozen=True)
class ComparedNumber:
    """A number of several runs.

    Attributes:
        key: Full name: ``<interface or region>.<key>`` or ``gruen.<zone>.<place>.<key>``.
        group: Interface, region or section as printed, such as ``stem-cement``, ``Gruen zones``.
        label: Name as printed.
        unit: Unit as printed; empty for a number without unit.
        numbers: Value in each run, in the printed unit; None in a run without this number.
        rounding: Largest difference that counts as rounding, in the printed unit.
        exact: True if the number has no discretization error.
    """

    key: str
    group: str
    label: str
    unit: str
    numbers: tuple[Number | None, ...]
    rounding: float = 0.0
    exact: bool = False

    @property
    def title(self) -> str:
        """Label with the unit in brackets."""
        return number_text.with_brackets(self.label, self.unit)

    @property
    def changes(self) -> list[tuple[int, Number, Number]]:
        """Index of each run with the number, its reference (the first such run) and its number."""
        known_numbers = [(k, number) for k, number in enumerate(self.numbers) if number is not None]
        return [(k, known_numbers[0][1], number) for k, number in known_numbers[1:]]

    @property
    def known(self) -> bool:
        """True if the errors of all its values are known."""
        return all(error_of_difference(a, b) is not None for _, a, b in self.changes)

    def text(self, run: int) -> str:
        """Format its value in a run; 0 where it is rounding, a dash where it is missing."""
        number = self.numbers[run]
        return "-" if number is None else number.text(self.rounding)

    def difference(self, run: int) -> str:
        """Format the difference of a run from the first: with error, and relative to the first.

        A first number within its error or rounding is about zero; nothing is relative to it.
        """
        first_number, number = self.numbers[0], self.numbers[run]
        if first_number is None or number is None:
            return "-"
        change = number.value - first_number.value
        error = error_of_difference(first_number, number)
        is_beyond = differs(first_number, number, self.rounding)
        relative = ""
        if abs(first_number.value) > max(self.rounding, first_number.error or 0.0):
            relative = f" ({100 * change / abs(first_number.value):+.1f} %)"
        if error is None:
            return f"{Number(change)}{relative}, errors unknown" if is_beyond else "0"
        if self.exact:
            return f"{Number(change)}{relative}" if is_beyond else "0"
        change_text = f"{Number(change, error)}{relative}"
        return change_text if is_beyond else f"{change_text}, within the errors"

    @property
    def differs(self) -> bool:
        """True if a run differs from the first by more than rounding and the known errors."""
        return any(differs(a, b, self.rounding) for _, a, b in self.changes)

    @property
    def significance(self) -> float:
        """Largest difference over the error of this difference; infinite without error."""
        return max((_significance(a, b) for _, a, b in self.changes), default=0.0)

    @property
    def share(self) -> float:
        """Largest difference over the larger of both numbers."""
        return max((share(a, b) for _, a, b in self.changes), default=0.0)


def share(a: Number, b: Number) -> float:
    """Difference of two numbers over the larger one."""
    return abs(b.value - a.value) / (max(abs(a.value), abs(b.value)) or 1.0)


def error_of_difference(a: Number, b: Number) -> float | None:
    """Sum of the errors of two numbers; None if one of them is unknown."""
    return None if a.error is None or b.error is None else a.error + b.error


def differs(a: Number, b: Number, rounding: float) -> bool:
    """Return True if two numbers differ by more than rounding and than their known errors."""
    return abs(b.value - a.value) > max(error_of_difference(a, b) or 0.0, rounding)


def _significance(a: Number, b: Number) -> float:
    error = error_of_difference(a, b)
    if a.value == b.value:
        return 0.0
    return abs(b.value - a.value) / error if error else math.inf


def compared_numbers(cases: Sequence[SweptCase]) -> list[ComparedNumber]:
    """Return every number that at least two runs have, the most significant difference first.

    Numbers with known errors come first, ordered by difference over error. Those without follow,
    ordered by relative difference. Numbers that do not differ come last.
    """
    common = []
    for number in _all_numbers(cases):
        available_numbers = [value for value in number.numbers if value is not None]
        if len(available_numbers) > 1:
            common.append(number)
    return sorted(common, key=_order)


def _order(number: ComparedNumber) -> tuple[bool, bool, float, float]:
    certain = number.known and not number.exact
    significance = number.significance if certain else 0.0
    return not number.differs, not certain, -significance, -number.share


def unshared(names: Sequence[str], cases: Sequence[SweptCase]) -> list[str]:
    """Return a sentence for each run with numbers that no other run has."""
    only_here: dict[int, dict[str, list[str]]] = {}
    for number in _all_numbers(cases):
        runs_with_it = [k for k, value in enumerate(number.numbers) if value is not None]
        if len(runs_with_it) == 1:
            only_here.setdefault(runs_with_it[0], {}).setdefault(number.group, []).append(
                number.key
            )
    sentences = []
    for k, keys_by_group in sorted(only_here.items()):
        group_counts = ", ".join(f"{len(keys)} of {group}" for group, keys in keys_by_group.items())
        sentences.append(f"{names[k]} alone has {group_counts}.")
    return sentences


def _all_numbers(cases: Sequence[SweptCase]) -> Iterator[ComparedNumber]:
    """All numbers of the runs, in the order of the table of quantities, then by Gruen zone."""
    keys: dict[str, str] = {}
    for case in cases:
        for section, owner, owner_numbers in summary_numbers.numbers_of(case.summary, parts=True):
            if section not in NOT_COMPARED:
                for quantity in quantities.TABLE[section].values():
                    is_place_of_maximum = quantity.key.endswith("_at")
                    if owner_numbers.get(quantity.key) is not None and not is_place_of_maximum:
                        keys |= {f"{owner}.{name}": owner for name in quantity.names}
    for key, owner in keys.items():
        q = quantities.quantity_or_fail(key)
        label, unit = quantities.label_and_unit(key)
        values = tuple(case.number(key) for case in cases)
        if q.exact:
            values = tuple(n and Number(n.value, 0.0) for n in values)
        group = quantities.place_in_words(owner)
        yield ComparedNumber(key, group, label, unit, values, 10.0**-q.digits, q.exact)
    yield from _zones(cases)


def _zones(cases: Sequence[SweptCase]) -> Iterator[ComparedNumber]:
    """Numbers by Gruen zone: strain energy of the bones, and those of each interface."""
    all_zones = [case.summary.get("gruen") or {} for case in cases]
    for zone in dict.fromkeys(chain.from_iterable(all_zones)):
        zone_of_runs = [zones.get(zone, {}) for zones in all_zones]
        densities = [z.get("strain_energy_density", {}) for z in zone_of_runs]
        errors = [z.get("strain_energy_density_error", {}) for z in zone_of_runs]
        for bone in dict.fromkeys(chain.from_iterable(densities)):
            pairs = zip(densities, errors, strict=True)
            numbers = tuple(
                _scaled(_number(density, zone_errors, bone), KJ) for density, zone_errors in pairs
            )
            yield ComparedNumber(
                f"gruen.{zone}.{bone}.strain_energy_density",
                ZONES,
                f"zone {zone}: strain energy of {named(bone)}",
                "kJ/m³",
                numbers,
            )
        interfaces = [z.get("interfaces", {}) for z in zone_of_runs]
        for interface in dict.fromkeys(chain.from_iterable(interfaces)):
            numbers_of_interface = [numbers_of_run.get(interface) for numbers_of_run in interfaces]
            for key, q in quantities.TABLE["interfaces"].items():
                numbers = tuple(
                    _scaled(_number(n, n, key, "_error"), q.factor) for n in numbers_of_interface
                )
                if any(number is not None for number in numbers):
                    yield ComparedNumber(
                        f"gruen.{zone}.{interface}.{key}",
                        ZONES,
                        f"zone {zone}: {named(interface)} {q.label}",
                        number_text.printed(q.shown),
                        numbers,
                        10.0**-q.digits,
                        q.exact,
                    )


def _number(values: Json | None, errors: Json | None, key: str, suffix: str = "") -> Number | None:
    """Return the value of a key with its error from another mapping; None if it is missing."""
    value = (values or {}).get(key)
    if not isinstance(value, int | float):
        return None
    return Number(float(value), (errors or {}).get(f"{key}{suffix}"))


def _scaled(number: Number | None, factor: float) -> Number | None:
    """Return a number and its error times the factor to another unit."""
    if number is None:
        return None
    return Number(factor * number.value, None if number.error is None else factor * number.error)
