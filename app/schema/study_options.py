"""The ``study`` section of a case: what varies, what is measured, and against what."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from mantle.errors import InputError
from mantle.schema.fields import ITEMS, MAPPING, Name, Section, Text, did_you_mean, fail, show
from mantle.schema.units import Dimension, Plain, PositiveNumber, TemperatureDifference

# Keys of summary.json that are numbers, and their units.
INTERFACE_UNITS = {
    **{f"{what}_{how}": "mm" for what in ("gap", "slip") for how in ("max", "p99", "mean")},
    **{f"{what}_{how}": "MPa" for what in ("pressure", "shear") for how in ("max", "p99", "mean")},
    "slip_accumulated_max": "mm",
    "penetration_max": "mm",
    "penetration_sampled": "mm",
    "open_fraction": "-",
    "stick_fraction": "-",
    "slip_fraction": "-",
    "area_slip_over_30um": "mm^2",
    "area_gap_over_30um": "mm^2",
    "force.x": "N",
    "force.y": "N",
    "force.z": "N",
    "dissipation": "N mm",
}
REGION_UNITS = {
    "von_mises_max": "MPa",
    "von_mises_p99": "MPa",
    "hoop_p99": "MPa",
    "principal_max": "MPa",
    "principal_p99": "MPa",
    "principal_min": "MPa",
    "mean_stress_min": "MPa",
    "mean_stress_max": "MPa",
}
BOND_UNITS = {"strength_fraction": "-", "normal_mean": "MPa", "normal_max": "MPa"}
STEM_UNITS = {"subsidence": "mm", "retroversion": "deg", "varus": "deg"}
# Sections thermal and cure.
NECROSIS = ("47C_1min", "cem43_16", "cem43_60", "cem43_240", "henriques_moritz")
HEATED_REGION_UNITS = {
    **{f"temperature_{what}": "degC" for what in ("max", "min", "mean", "end_max")},
    "temperature_max_time": "s",
    **{f"seconds_over_{level}": "s" for level in (47, 50, 56)},
    **{f"volume_over_{level}": "mm^3" for level in (47, 50, 56)},
    "cem43_max": "min",
    "henriques_moritz_max": "-",
    **{f"necrosis_{rule}_volume": "mm^3" for rule in NECROSIS},
    **{f"necrosis_{rule}_depth": "mm" for rule in NECROSIS},
}
HEATED_INTERFACE_UNITS = {
    **{f"temperature_max_{side}": "degC" for side in ("first", "second")},
    **{f"temperature_max_{side}_time": "s" for side in ("first", "second")},
    "temperature_jump_max": "K",
    "heat_flux_max": "W/m^2",
    "entropy_production_min": "W/(m^2 K)",
    "entropy_production_max": "W/(m^2 K)",
}
CURE_UNITS = {
    "degree_min": "-",
    "degree_max": "-",
    "time_50": "s",
    "time_90": "s",
    "rate_max": "1/s",
}
# Whole names: what a run costs and how well it balances, which is no approximation of anything.
OF_RUN = {
    "solver.newton_iterations": "-",
    "solver.linear_iterations": "-",
    "solver.condition": "-",
    "balance.heat": "-",
    "balance.heat_quadrature": "-",
    "timing.solve": "s",
    "timing.total": "s",
}
EXAMPLES: dict[str, Dimension | Plain] = {
    "mm": Dimension("mm", "a length", "0.05 mm"),
    "mm^2": Dimension("mm^2", "an area", "20 mm^2"),
    "MPa": Dimension("MPa", "a pressure", "2 MPa"),
    "N": Dimension("N", "a force", "1800 N"),
    "N mm": Dimension("N*mm", "an energy", "2 N*mm"),
    "mm^3": Dimension("mm^3", "a volume", "500 mm^3"),
    "deg": Dimension("deg", "an angle", "0.1 deg"),
    "s": Dimension("s", "a time", "600 s"),
    "min": Dimension("min", "a time", "60 min"),
    "1/s": Dimension("1/s", "a rate", "0.1 1/s"),
    "degC": Dimension("degC", "a temperature", "50 degC"),
    "K": TemperatureDifference(),
    "W/m^2": Dimension("W/m^2", "a power per area", "200 W/m^2"),
    "W/(m^2 K)": Dimension("W/(m^2*K)", "an entropy production", "1 W/(m^2 K)"),
    "-": Plain(),
}


def unit(quantity: str) -> str:
    """The unit in which a quantity stands in ``summary.json``.

    Args:
        quantity: ``<interface or region>.<key>``, ``stem.<key>`` or one of `OF_RUN`.

    Raises:
        PydanticCustomError: There is no such key.
    """
    if quantity in OF_RUN:
        return OF_RUN[quantity]
    name, _, key = quantity.partition(".")
    known = INTERFACE_UNITS | REGION_UNITS | (STEM_UNITS if name == "stem" else {})
    known |= BOND_UNITS | HEATED_REGION_UNITS | HEATED_INTERFACE_UNITS | CURE_UNITS
    if key not in known:
        if name in ("solver", "timing", "balance"):
            fail(f"{show(quantity)} is not one of {', '.join(OF_RUN)}")
        hint = did_you_mean(key, tuple(known)) or f"; one of {', '.join(known)}"
        fail(f"{show(quantity)} is not <interface>.<key>, <region>.<key> or stem.<key>{hint}")
    return known[key]


def known_value(quantity: str, value: object) -> float:
    """A reference value in the unit of its quantity.

    Raises:
        PydanticCustomError: It has another dimension.
    """
    return float(EXAMPLES[unit(quantity)].read(value))


def _changes(value: object) -> dict[str, Any]:
    """Override keys with values."""
    if not isinstance(value, dict):
        fail(f"{show(value)} is not a mapping of keys to values, e.g. {{mesh.size: 3 mm}}")
    for key in value:
        if key.partition(".")[0] in ("study", ""):
            fail("is not what a run depends on", at=(key,))
    return value


def _runs(value: object) -> dict[str, Any]:
    """Override keys with values, of which lists vary together."""
    runs = _changes(value)
    lengths = {key: len(entry) for key, entry in runs.items() if isinstance(entry, list)}
    first = next(iter(lengths), "")
    for key, length in lengths.items():
        if not length:
            fail("is an empty list", at=(key,))
        if length != lengths[first]:
            fail(f"has {length} values where {first} has {lengths[first]}", at=(key,))
    check_ranks(runs)
    return runs


def check_ranks(changes: Mapping[str, Any], at: tuple[str, ...] = ()) -> None:
    """Refuse numbers of ranks that are none.

    Args:
        changes: Override keys with values or lists of them.
        at: Where they stand below the value under validation.
    """
    entry = changes.get("ranks", 1)
    for i, ranks in enumerate(entry if isinstance(entry, list) else [entry]):
        if not (type(ranks) is int and ranks > 0):
            item = (i,) if isinstance(entry, list) else ()
            text = f"{show(ranks)} is not a number of ranks; allowed: 1, 2, 3, ..."
            fail(text, at=(*at, "ranks", *item))


def _line(value: object) -> dict[str, Any]:
    """At least one of them a list."""
    runs = _runs(value)
    if not varying(runs):
        fail("varies nothing; expected a list for at least one key, e.g. mesh.size: [3 mm, 2 mm]")
    return runs


Changes = Annotated[dict[str, Any], BeforeValidator(_changes)]
Runs = Annotated[dict[str, Any], BeforeValidator(_runs)]
Line = Annotated[dict[str, Any], BeforeValidator(_line)]


def _quantity(value: object) -> object:
    """The name of a quantity, which has a unit."""
    if not isinstance(value, str):
        fail(f"{show(value)} is not <interface>.<key>, <region>.<key> or stem.<key>")
    unit(value)
    return value


def _values(value: object) -> object:
    """Values of quantities, each with its unit."""
    if not isinstance(value, dict):
        fail(f"{show(value)} is not a mapping of quantities to values")
    for quantity, entry in value.items():
        if quantity in OF_RUN:
            fail("is not compared with anything", at=(quantity,))
        try:
            known_value(quantity, entry)
        except PydanticCustomError as error:
            fail((error.context or {})["text"], at=(quantity,))
    return value


class Reference(Section):
    """What the runs are compared with: known values, or a finer ladder that is extrapolated."""

    values: Annotated[dict[str, str | int | float], BeforeValidator(_values)] | None = None
    """The exact value of each quantity."""
    run: Runs | None = None
    """Runs as in a line, finest last: two, or at least three to extrapolate. Without a list, one
    run that is the reference as it is."""

    @model_validator(mode="after")
    def _one(self) -> Reference:
        if (self.values is None) == (self.run is None):
            fail("expected either values or run")
        if self.run is not None and varying(self.run) and len(steps(self.run)) < 2:
            fail(
                "has a single run; expected at least two, or its error cannot be told; "
                "without a list the run is the reference as it is",
                at=("run",),
            )
        return self


class Study(Section):
    """Error against run time: what varies and what is measured."""

    quantities: Annotated[tuple[Annotated[str, BeforeValidator(_quantity)], ...], ITEMS]
    """Numbers of ``summary.json``: ``<interface or region>.<key>``, ``stem.<key>``, and what has a
    value but no error: ``solver.<key>``, ``timing.<key>``, penetrations."""
    target: PositiveNumber = 0.02
    """Relative error for which the fastest run is advised."""
    lines: Annotated[dict[Name, Line], MAPPING]
    """Curves by name: overrides as after ``--set`` (and ``ranks``); lists vary together."""
    reference: Reference
    """What the runs are compared with."""

    @model_validator(mode="after")
    def _complete(self) -> Study:
        for key in ("quantities", "lines"):
            if not getattr(self, key):
                fail("is empty", at=(key,))
        if (values := self.reference.values) is not None:
            missing = [q for q in self.quantities if q not in values and not _free(q)]
            if missing:
                fail(f"no value for {', '.join(missing)}", at=("reference", "values"))
        return self

    def compares(self, quantity: str) -> bool:
        """Whether a quantity is compared with the reference, or only shown."""
        return not _free(quantity) or quantity in (self.reference.values or {})


class StudyFile(Section):
    """A study that stands apart from its case."""

    base: Text
    """The case, relative to this file; a study of its own is not used."""
    set: Changes = Field(default_factory=dict)
    """Overrides of the case for every point, as after ``--set``."""
    study: Study
    """What varies and what is measured."""


def _free(quantity: str) -> bool:
    """Whether a quantity is no approximation of anything: counts, times, and penetrations."""
    return quantity in OF_RUN or ".penetration_" in quantity


def split_ranks(overrides: Sequence[str]) -> tuple[int | None, list[str]]:
    """The number of ranks among options, and the others, which are those of a case.

    Raises:
        InputError: It is no such number.
    """
    ranks, others = None, []
    for option in overrides:
        key, _, value = option.partition("=")
        if key.strip() != "ranks":
            others.append(option)
        elif re.fullmatch("[1-9][0-9]*", value.strip()):
            ranks = int(value)
        else:
            text = "is not a number of ranks; allowed: 1, 2, ..."
            raise InputError(f"--set ranks: {value.strip()} {text}")
    return ranks, others


def options(changes: Mapping[str, Any]) -> list[str]:
    """Overrides as options ``key=value``; JSON is YAML."""
    return [f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in changes.items()]


def steps(line: dict[str, Any]) -> list[dict[str, Any]]:
    """The overrides of each point of a line."""
    number = max((len(value) for value in line.values() if isinstance(value, list)), default=1)
    return [
        {key: value[i] if isinstance(value, list) else value for key, value in line.items()}
        for i in range(number)
    ]


def varying(line: dict[str, Any]) -> list[str]:
    """The keys that vary along a line, mesh.size first."""
    keys = [key for key, value in line.items() if isinstance(value, list)]
    return sorted(keys, key=lambda key: key != "mesh.size")
