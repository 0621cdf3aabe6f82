"""The numbers that a run publishes: one table, and a slot for more.

A quantity stands in a section of ``summary.json`` below the name of its interface or region. Its
row here serves the summary, history.csv, the closing tables, the estimate of errors, studies and
reports. Another package adds one of an interface or a region with `add` and a function that
computes it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any

from app.schema.section import did_you_mean, fail, show
from app.schema.units import Dimension, Plain

# Orders of convergence of P1 and P2 for estimates of errors (docs/verification.md): of
# displacements, of slip, of tractions, of stress, of temperature, of doses, times and cure.
MOTION = (0.8, 1.3)
SLIP = (0.8, 1.2)
TRACTION = (0.8, 0.8)
STRESS = (0.8, 1.0)
HEAT = (1.5, 1.5)
DOSE = (1.0, 1.0)
# Of what follows a power of stress, or is where it exceeds a level.
RISK = (0.8, 0.99)
# Dimension of each unit in summary.json, with its article.
UNITS = {
    "mm": "a length",
    "mm^2": "an area",
    "mm^3": "a volume",
    "N": "a force",
    "MPa": "a stress",
    "N mm": "an energy",
    "deg": "an angle",
    "s": "a time",
    "degC": "a temperature",
    "K": "a temperature difference",
    "W": "a power",
    "W/m^2": "a heat flux",
    "W/(m^2 K)": "an entropy production",
    "min": "a thermal dose",
    "1/year": "a rate",
    "1/s": "a rate",
    "-": "a number",
}
# Units of tables in terms of those of summary.json, and as printed.
FACTORS = {"um": 1e3, "%": 100.0, "um/m": 1e6}
PRINTED = {"um": "µm", "degC": "°C", "deg": "°", "^2": "²", "^3": "³"}
# Criteria of thermal necrosis of bone.
NECROSIS = {
    "47C_1min": "47 degC for 1 min",
    "cem43_16": "CEM43 of 16 min",
    "cem43_60": "CEM43 of 60 min",
    "cem43_240": "CEM43 of 240 min",
    "henriques_moritz": "Henriques-Moritz",
}


def printed(unit: str) -> str:
    """A unit as printed: µm, °C, mm²; empty for a plain number."""
    signs = PRINTED.items()
    return reduce(lambda text, sign: text.replace(*sign), signs, unit.removesuffix("-"))


def in_print(text: str) -> str:
    """Text with the units behind its numbers, or in brackets, as printed."""
    return re.sub(r"(?:(?<=\d )|(?<=\())(um|degC|deg|mm\^[23])\b", lambda m: printed(m[0]), text)


@dataclass(frozen=True)
class Quantity:
    """A published number.

    Attributes:
        section: Of summary.json, e.g. ``interfaces`` or ``thermal.regions``.
        key: Key there; its estimated error has the suffix ``_error``.
        unit: Unit in summary.json and history.csv, one of `UNITS`.
        shown: Unit in tables and figures; `unit` by default.
        digits: Decimals in the terminal, in unit `shown`.
        label: Name in tables and figures; the key by default.
        order: Orders of convergence of P1 and P2; None: its error is not estimated.
        peak: Whether it is a maximum, which may diverge with refinement.
        exact: Whether it has no discretization error: counts, run times, penetrations.
        vector: Whether it has three components, ``.x`` .. in a study.
        history: Whether history.csv has it; of interfaces and the stem.
        headline: Whether sweeps and variations compare runs by it.
        compute: Function of an added quantity, in `unit`. For an interface it takes the contact
            points (`ContactSamples`) and a mask of those of the interface (n,), and returns the
            same on every rank; for a region the stresses (`results.stresses.Stresses`) and the name
            of the region; collective.
    """

    section: str
    key: str
    unit: str
    shown: str = ""
    digits: int = 2
    label: str = ""
    order: tuple[float, float] | None = None
    peak: bool = False
    exact: bool = False
    vector: bool = False
    history: bool = False
    headline: bool = False
    compute: Callable[[Any, Any], float] | None = None

    def __post_init__(self) -> None:
        """Fill in the defaults."""
        object.__setattr__(self, "shown", self.shown or self.unit)
        object.__setattr__(self, "label", self.label or self.key.replace("_", " "))

    @property
    def factor(self) -> float:
        """Factor from `unit` to `shown`."""
        return 1.0 if self.shown == self.unit else FACTORS[self.shown]

    @property
    def names(self) -> list[str]:
        """Names in a study, after that of the interface or region."""
        return [f"{self.key}.{axis}" for axis in "xyz"] if self.vector else [self.key]

    def text(self, numbers: Mapping[str, Any]) -> str:
        """Format the number: ``41.3 ± 1.8`` with its error, a dash if it is missing.

        Errors show one digit at least; one below two decimals more than usual is left out.
        """
        value, error = numbers.get(self.key), self.factor * (numbers.get(f"{self.key}_error") or 0)
        if value is None:
            return "-"
        if error < 10.0 ** -(self.digits + 2):
            return f"{self.factor * value:.{self.digits}f}"
        digits = max(self.digits, -math.floor(math.log10(error)))
        text = f"{self.factor * value:.{digits}f} ± {error:.{digits}f}"
        return text + (" (not resolved)" if error > self.factor * abs(value) else "")


PLACES = {"cement_bone": "cement-bone", "stem_cement": "stem-cement"}
# Sections of numbers; the others map interfaces or regions to numbers.
RUN = ("solver", "balance", "timing")
WHOLE = ("stem", "femur", *RUN)
# Parts that are reported apart: of the interfaces of a hip, and of its stem.
PARTS = ("rim", "tip", "neck", "edge")
# Levels of tension of cement, over which its volume is known [MPa].
STRESSED = (3, 5, 7, 9, 11)
# Levels of strains of the cortex [mm] by name: from the lesser trochanter to the tip of a stem.
GAUGES = {"10": -10.0, "40": -40.0, "80": -80.0, "113": -113.0}
# By section and key, in the order in which they are shown.
TABLE: dict[str, dict[str, Quantity]] = {
    **{name: {} for name in ("interfaces", "regions", "fatigue", "stem", "femur", "bonds")},
    **{name: {} for name in ("thermal.regions", "thermal.interfaces", "cure", *RUN)},
}


def add_quantity(*quantities: Quantity) -> None:
    """Publish quantities.

    Raises:
        KeyError: Unknown section.
        ValueError: The key exists, the unit is unknown, or the section computes nothing.
    """
    for q in quantities:
        if q.key in TABLE[q.section] or q.unit not in UNITS:
            raise ValueError(f"{q.section}.{q.key} is there already, or has no known unit")
        if q.compute and q.section not in ("interfaces", "regions"):
            raise ValueError(f"nothing computes {q.section}.{q.key}")
        TABLE[q.section][q.key] = q


_interface, _region = partial(Quantity, "interfaces"), partial(Quantity, "regions")
_damage = partial(Quantity, "fatigue", digits=4)
for _key, _word, _unit, _shown, _digits, _order in (
    ("gap", "debonding", "mm", "um", 1, MOTION),
    ("slip", "slip", "mm", "um", 1, SLIP),
    ("slip_path", "path of slip", "mm", "um", 1, SLIP),
    ("motion", "motion", "mm", "um", 1, MOTION),
    ("pressure", "pressure", "MPa", "", 2, TRACTION),
    ("shear", "shear stress", "MPa", "", 2, TRACTION),
):
    _how = partial(_interface, unit=_unit, shown=_shown, digits=_digits)
    # Tractions at edges grow with refinement.
    _main = "p95" if _order is TRACTION else "p99"
    add_quantity(
        _how(f"{_key}_max", label=f"{_word}, max", peak=True, history=_key != "slip_path"),
        *(
            _how(
                f"{_key}_{part}",
                label=f"{_word}, {part}",
                order=_order,
                history=part == _main and _key != "slip_path",
                headline=part == _main and _key != "slip_path",
            )
            for part in ("p95", "p99")
        ),
        _how(f"{_key}_mean", label=f"{_word}, mean", order=SLIP if _order is SLIP else MOTION),
    )
add_quantity(
    _interface("penetration_max", "mm", "um", exact=True, history=True, headline=True),
    _interface("penetration_sampled", "mm", "um", exact=True),
    _interface("penetration_mean", "mm", "um", exact=True),
    _interface("open_fraction", "-", "%", 0, history=True, headline=True),
    _interface("stick_fraction", "-", "%", 0, history=True),
    _interface("slip_fraction", "-", "%", 0, history=True, headline=True),
    *(
        _interface(f"area_{key}_over_30um", "mm^2", label=f"area of {word} over 30 µm")
        for key, word in (("gap", "debonding"), ("slip", "slip"), ("motion", "motion"))
    ),
    _interface("force", "N", order=MOTION, vector=True),
    _interface("dissipation", "N mm", order=SLIP, history=True),
    _interface("dissipation_min", "N mm", history=True),
    _interface("contact_work", "N mm", history=True),
    # Of sides that slide far, at the end and over a cycle.
    _interface("torque", "N mm", vector=True, order=MOTION),
    *(
        _interface(
            f"torque_{key}",
            "N mm",
            digits=1,
            label=f"torque{words}",
            order=MOTION,
            headline=key == "max",
        )
        for key, words in (("size", ""), ("along", " along the motion"), ("max", ", max"))
    ),
    _interface("centre", "mm", vector=True, order=MOTION),
    _interface("eccentricity", "mm", "um", 1, order=MOTION),
    _interface("pressure_max_at", "mm", vector=True, exact=True),
    _interface("dissipation_cycle", "N mm", label="dissipation in a cycle", order=MOTION),
    *(
        _interface(f"slid_{key}", "mm", label=f"slid in a cycle, {words}", order=MOTION)
        for key, words in (("max", "max"), ("mean", "mean"), ("max_master", "max, master"))
    ),
    *(
        _interface(
            f"wear_{key}{times}",
            unit,
            digits=digits,
            label=f"wear in {of}, {words}",
            order=TRACTION if unit == "mm" else MOTION,
            peak="max" in key,
            headline=f"{key}{times}" in ("volume_million", "depth_p99_million"),
        )
        for times, of, digits in (("", "a cycle", 9), ("_million", "a million cycles", 2))
        for key, words, unit in (
            ("volume", "volume", "mm^3"),
            *(
                (f"depth_{how}{side}", f"depth, {how}{side.replace('_', ', ')}", "mm")
                for side in ("", "_master")
                for how in ("max", "p99")
            ),
        )
    ),
    _interface("uncovered_fraction", "-", "%", 1, exact=True),
    _interface("friction_power", "W", digits=3, order=MOTION),
    _interface("temperature_swing", "K", label="swing of the temperature", order=TRACTION),
    _interface("stored_energy", "N mm", history=True),
    _interface("unbonded_fraction", "-", "%", 1, exact=True),
    *(_interface(f"area_{how}", "mm^2", digits=1, history=True) for how in ("damaged", "broken")),
    _interface("damage_mean", "-", digits=4, order=MOTION, history=True),
    _interface("pressure_by_facets", "MPa", digits=2, exact=True),
    _interface("pressure_mean_max", "MPa", digits=2, label="pressure, largest mean at a point"),
    _interface("zone_length", "mm", digits=1, history=True),
    _interface("zone_elements", "-", digits=1),
    _region("von_mises_max", "MPa", label="von Mises max", peak=True),
    _region("von_mises_p99", "MPa", label="von Mises p99", order=STRESS, headline=True),
    _region("hoop_p99", "MPa", order=STRESS),
    _region("principal_max", "MPa", peak=True),
    _region("principal_p99", "MPa", order=STRESS),
    _region("principal_min", "MPa", peak=True),
    *(_region(f"mean_stress_{end}", "MPa") for end in ("min", "max")),
    _region("creep_strain_max", "-", "%", peak=True),
    _region("creep_strain_mean", "-", "%", order=STRESS, headline=True),
    *(_region(f"volume_over_{p}_MPa", "mm^3", digits=1, order=RISK) for p in STRESSED),
    _region("failure_risk", "-", digits=4, order=RISK, peak=True, headline=True),
    _region("failure_probability", "-", "%", order=RISK),
    _damage("damage_p99", "1/year", label="damage, p99", order=RISK, headline=True),
    _damage("damage_max", "1/year", label="damage, max", peak=True),
    _damage("stress_p99", "MPa", digits=2, label="equivalent stress, p99", order=STRESS),
    Quantity("stem", "subsidence", "mm", "um", 1, order=MOTION, history=True, headline=True),
    Quantity("stem", "retroversion", "deg", digits=3, order=MOTION, history=True, headline=True),
    Quantity("stem", "varus", "deg", digits=3, order=MOTION, history=True, headline=True),
    *(
        Quantity("stem", f"{end}_displacement", "mm", "um", 1, order=MOTION, vector=True)
        for end in ("tip", "top")
    ),
    Quantity("femur", "head_displacement", "mm", order=MOTION, vector=True),
    *(
        Quantity("femur", f"strain_{side}_{level}", "-", "um/m", 0, order=STRESS)
        for side in ("lateral", "medial")
        for level in GAUGES
    ),
    Quantity("bonds", "strength_fraction", "-", "%", 0, history=True),
    *(Quantity("bonds", f"normal_{how}", "MPa") for how in ("mean", "max")),
    *(Quantity("bonds", f"shear_{how}", "MPa") for how in ("mean", "max")),
    _interface("strength_fraction", "-", "%", 0, history=True),
)
for _section in ("interfaces", "bonds"):
    _index = partial(Quantity, _section, unit="-", digits=3)
    add_quantity(
        _index("failure_index_max", label="failure index, max", peak=True),
        _index("failure_index_p99", label="failure index, p99", order=TRACTION, history=True),
        _index("failure_load_factor", label="load factor of failure", order=TRACTION),
    )
_heated = partial(Quantity, "thermal.regions", order=HEAT, digits=1)
_dose = partial(Quantity, "thermal.regions", order=DOSE, digits=1)
_between = partial(Quantity, "thermal.interfaces", order=HEAT, digits=1)
_cure = partial(Quantity, "cure", order=DOSE, digits=4)
add_quantity(
    _heated("temperature_max", "degC", headline=True),
    *(_heated(f"temperature_{what}", "degC") for what in ("min", "mean", "end_max")),
    _dose("temperature_max_time", "s"),
    *(_dose(f"seconds_over_{level}", "s") for level in (47, 50, 56)),
    *(_dose(f"volume_over_{level}", "mm^3") for level in (47, 50, 56)),
    _dose("cem43_max", "min"),
    _dose("henriques_moritz_max", "-"),
    *(
        _dose(
            f"necrosis_{rule}_{key}", unit, digits=digits, label=f"dead by {in_print(words)}, {key}"
        )
        for key, unit, digits in (("volume", "mm^3", 1), ("depth", "mm", 2))
        for rule, words in NECROSIS.items()
    ),
    *(_between(f"temperature_max_{s}", "degC", headline=True) for s in ("first", "second")),
    *(_between(f"temperature_max_{side}_time", "s", order=DOSE) for side in ("first", "second")),
    _between("temperature_jump_max", "K"),
    _between("heat_flux_max", "W/m^2", digits=0),
    *(_between(f"entropy_production_{end}", "W/(m^2 K)", order=None) for end in ("min", "max")),
    *(_cure(f"degree_{end}", "-") for end in ("min", "max")),
    *(_cure(f"time_{p}", "s", digits=1, label=f"{p} % set everywhere") for p in (50, 90)),
    _cure("rate_max", "1/s"),
    *(Quantity("solver", f"{of}_iterations", "-", exact=True) for of in ("newton", "linear")),
    Quantity("solver", "condition", "-", exact=True),
    *(Quantity("balance", key, "-", exact=True) for key in ("heat", "heat_quadrature")),
    *(Quantity("timing", key, "s", exact=True) for key in ("solve", "total")),
)


def of_run() -> list[str]:
    """Full names of the numbers of the run: cost and balances."""
    return [f"{section}.{key}" for section in RUN for key in TABLE[section]]


def _tables(owner: str) -> Iterator[dict[str, Quantity]]:
    """Tables with quantities of an interface, a region, the stem or the run."""
    return (own for section, own in TABLE.items() if section not in WHOLE or section == owner)


def get(name: str) -> Quantity | None:
    """Quantity by its full name, ``<owner>.<key>`` or one of `of_run`; None if there is none."""
    owner, _, key = name.partition(".")
    return next((q for own in _tables(owner) for q in own.values() if key in q.names), None)


def find(name: str) -> Quantity:
    """A quantity as in `get`.

    Raises:
        PydanticCustomError: There is no such key.
    """
    if (q := get(name)) is not None:
        return q
    owner, _, key = name.partition(".")
    if owner in RUN:
        fail(f"{show(name)} is not one of {', '.join(of_run())}")
    known = dict.fromkeys(n for own in _tables(owner) for q in own.values() for n in q.names)
    hint = did_you_mean(key, tuple(known)) or f"; one of {', '.join(known)}"
    fail(f"{show(name)} is not <interface>.<key>, <region>.<key> or stem.<key>{hint}")


def in_words(name: str) -> tuple[str, str]:
    """A number's label, e.g. stem-cement slip, p99, and its unit as printed."""
    place, _, key = name.partition(".")
    words = PLACES.get(place, place.replace("_", " "))
    if (q := get(name)) is None:
        return f"{words} {key}".replace("_", " "), ""
    return f"{words} {key.replace(q.key, q.label)}", printed(q.shown)


def titled(name: str) -> str:
    """A number's label with its unit in brackets, if it has one."""
    words, unit = in_words(name)
    return f"{words} ({unit})" if unit else words


def known_value(name: str, value: object) -> float:
    """A value in a file, in the unit of its quantity.

    Raises:
        PydanticCustomError: It has another dimension.
    """
    unit = find(name).unit
    plain, offset = unit == "-", unit != "K"
    kind = Plain() if plain else Dimension(unit, UNITS[unit], f"1 {unit}", offset)
    return float(kind.read(value))


def numbers_of(
    summary: Mapping[str, Any], parts: bool = False
) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Section, owner (with ``parts`` also ``stem_cement_rim``) and numbers in a summary."""
    for section in TABLE:
        found: Any = reduce(lambda part, key: part.get(key, {}), section.split("."), summary)
        named: dict[str, Any] = {section: found} if section in WHOLE else found
        for name, numbers in named.items():
            if numbers:
                yield section, name, numbers
            apart = [part for part in PARTS if parts and part in numbers]
            yield from ((section, f"{name}_{part}", numbers[part]) for part in apart)


def largest(numbers: Mapping[str, Any], key: str) -> float:
    """A maximum of an interface or a region with its parts; 0 if it is missing."""
    return max(part.get(key, 0.0) for part in (numbers, *(numbers.get(p, {}) for p in PARTS)))


def read(summary: Mapping[str, Any], name: str, suffix: str = "") -> float | None:
    """Number of ``summary.json`` in its unit, by name as in `get`; None if it is missing."""
    owner, _, key = name.partition(".")
    key, _, axis = key.partition(".")
    for _, found, numbers in numbers_of(summary, parts=True):
        value = numbers.get(key + suffix) if found == owner else None
        if axis and isinstance(value, list):
            value = value["xyz".index(axis)]
        if isinstance(value, int | float):
            return float(value)
    return None


def computed(section: str, state: Any, of: Any) -> dict[str, float]:
    """Added numbers of an interface or a region (`Quantity.compute`)."""
    return {q.key: float(q.compute(state, of)) for q in TABLE[section].values() if q.compute}
