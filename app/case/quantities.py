"""The numbers that a run publishes: one table, one row for each.

A quantity stands in a section of ``summary.json`` below the name of its interface or region. Its
row here serves the summary, history.csv, the closing tables, the estimate of errors, studies and
reports. Another package adds rows with `add_quantity`, for an interface or a region with a function
that computes the number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from app.case.error_classes import (
    DOSE_ERRORS,
    MOTION_ERRORS,
    RISK_ERRORS,
    SLIP_ERRORS,
    STRESS_ERRORS,
    TEMPERATURE_ERRORS,
    TRACTION_ERRORS,
    ByOrder,
    ErrorClass,
)
from app.case.number_text import (
    FACTOR_OF_UNIT,
    NOT_RESOLVED,
    UNITS,
    in_print,
    printed,
    with_brackets,
)
from app.case.summary import TEMPERATURE_LEVELS, Numbers
from app.schema.section import did_you_mean, fail, show
from app.schema.units import Dimension, Plain

# Criteria of thermal necrosis of bone.
NECROSIS = {
    "47C_1min": "47 degC for 1 min",
    "cem43_16": "CEM43 of 16 min",
    "cem43_60": "CEM43 of 60 min",
    "cem43_240": "CEM43 of 240 min",
    "henriques_moritz": "Henriques-Moritz",
}


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
        order: Orders of convergence of P1 and P2; those of the class if there is one. None: its
            error is not estimated.
        error_class: Class with the factors of its error. With `order` alone the factor is that of
            Richardson's extrapolation.
        peak: True if it is a maximum, which may diverge with refinement.
        exact: True if it has no discretization error: counts, run times, penetrations.
        vector: True if it has three components, ``.x`` .. in a study.
        step_record: True if history.csv has it; only in the sections `STEP_RECORD_SECTIONS`.
        headline: True if sweeps and variations compare runs by it.
        curve: True if the page of a run draws its step record, as it does of headlines.
        on_page: True if the page of a run has it in a table, as it has the closing table.
        sentence: Of an interface: sentence below the closing table. It names quantities of the
            section in braces, and the interface as {name}.
        caption: Of an interface: caption with {name} of a large number at the head of the page.
        detail: Sentence below it, with quantities in braces.
        compute: Function of an added quantity, in `unit`; collective. For an interface it takes the
            contact points (`ContactSamples`) and the mask of its points (n,). For a region it takes
            the stresses (`results.stresses.Stresses`) and the name of the region. It returns the
            same number on every rank.
    """

    section: str
    key: str
    unit: str
    shown: str = ""
    digits: int = 2
    label: str = ""
    order: ByOrder | None = None
    error_class: ErrorClass | None = None
    peak: bool = False
    exact: bool = False
    vector: bool = False
    step_record: bool = False
    headline: bool = False
    curve: bool = False
    on_page: bool = False
    sentence: str = ""
    caption: str = ""
    detail: str = ""
    compute: Callable[..., float] | None = None

    def __post_init__(self) -> None:
        """Fill in the defaults."""
        object.__setattr__(self, "shown", self.shown or self.unit)
        object.__setattr__(self, "label", self.label or self.key.replace("_", " "))
        if self.error_class:
            object.__setattr__(self, "order", self.error_class.orders)
        elif self.order:
            object.__setattr__(self, "error_class", ErrorClass(self.key, self.order))

    @property
    def factor(self) -> float:
        """Factor from `unit` to `shown`."""
        return 1.0 if self.shown == self.unit else FACTOR_OF_UNIT[self.shown]

    @property
    def names(self) -> list[str]:
        """Names in a study, after that of the interface or region."""
        return [f"{self.key}.{axis}" for axis in "xyz"] if self.vector else [self.key]

    def text(self, numbers: Numbers) -> str:
        """Format the number: ``41.3 ± 1.8`` with its error, a dash if it is missing.

        Errors show one digit at least; one below two decimals more than usual is left out. Numbers
        that round to zero have no sign.
        """
        value = numbers.get(self.key)
        error = self.factor * (numbers.get(f"{self.key}_error") or 0)
        if value is None:
            return "-"
        if error < 10.0 ** -(self.digits + 2):
            return f"{self.factor * value:z.{self.digits}f}"
        digits = max(self.digits, -math.floor(math.log10(error)))
        number_text = f"{self.factor * value:z.{digits}f} ± {error:.{digits}f}"
        return number_text + (NOT_RESOLVED if error > self.factor * abs(value) else "")

    def with_unit(self, numbers: Numbers, unit: str) -> str:
        """Format the number with a unit: ``41.3 ± 1.8 um``, ``0.3 ± 0.5 um (not resolved)``."""
        value, not_resolved, _ = self.text(numbers).partition(NOT_RESOLVED)
        return f"{value} {unit}".removesuffix(" -") + not_resolved


@dataclass(frozen=True)
class InterfaceField:
    """A field on interfaces that another package writes, as pages show it.

    Attributes:
        name: Name in files, after that of the interface.
        label: Name in pages and pictures.
        unit: Unit there.
        factor: Factor from the value in files to this unit.
        loaded: True for the colours of tractions, False for those of motions.
    """

    name: str
    label: str
    unit: str
    factor: float = 1.0
    loaded: bool = False


# Fields of other packages, by name.
INTERFACE_FIELDS: dict[str, InterfaceField] = {}


def add_interface_field(*fields: InterfaceField) -> None:
    """Show fields on interfaces in pages and pictures.

    Raises:
        ValueError: The name is taken.
    """
    for field in fields:
        if field.name in INTERFACE_FIELDS:
            raise ValueError(f"there is a field '{field.name}' already")
        INTERFACE_FIELDS[field.name] = field


PLACES = {
    "cement_bone": "cement-bone",
    "stem_cement": "stem-cement",
    "stem_bone": "stem-bone",
    "collar_bone": "collar-bone",
}
# Sections of numbers; the others map interfaces or regions to numbers.
RUN_SECTIONS = ("solver", "balance", "timing")
SECTIONS_WITHOUT_OWNER = ("stem", "femur", *RUN_SECTIONS)
# Parts that are reported apart: of the interfaces of a hip, and of its stem.
PARTS = ("rim", "tip", "neck", "edge")
# Levels of tension of cement, over which its volume is known [MPa].
TENSION_LEVELS = (3, 5, 7, 9, 11)
# Levels of strains of the cortex [mm] by name: from the lesser trochanter to the tip of a stem.
GAUGES = {"10": -10.0, "40": -40.0, "80": -80.0, "113": -113.0}
# Sections whose numbers history.csv may have.
STEP_RECORD_SECTIONS = ("interfaces", "stem", "bonds", "probes")
# By section and key, in the order in which they are shown.
TABLE: dict[str, dict[str, Quantity]] = {
    **{name: {} for name in ("interfaces", "regions", "stem", "femur", "bonds")},
    **{name: {} for name in ("thermal.regions", "thermal.interfaces", "cure", *RUN_SECTIONS)},
}


def add_quantity(*quantities: Quantity) -> None:
    """Publish quantities.

    Raises:
        KeyError: Unknown section.
        ValueError: The key exists, the unit is unknown, the section computes nothing, or
            history.csv has no numbers of the section.
    """
    for q in quantities:
        if q.key in TABLE[q.section] or q.unit not in UNITS:
            raise ValueError(f"{q.section}.{q.key} exists already, or has no known unit")
        if q.compute and q.section not in ("interfaces", "regions"):
            raise ValueError(f"{q.section}.{q.key}: sections interfaces and regions have `compute`")
        if q.step_record and q.section not in STEP_RECORD_SECTIONS:
            sections = ", ".join(STEP_RECORD_SECTIONS)
            raise ValueError(f"{q.section}.{q.key}: only {sections} have `step_record`")
        TABLE[q.section][q.key] = q


@dataclass(frozen=True)
class NumberSection:
    """A section of ``summary.json`` with numbers by owner, such as one of another package.

    Attributes:
        name: Key of the section.
        title: Heading in pages.
        columns: Table in the terminal: keys of a cell by heading; none in the first.
        owners: Returns the owners of its numbers in a case.
        leads: True if its headlines precede those of interfaces in figures of many runs.
    """

    name: str
    title: str
    columns: Mapping[str, str]
    owners: Callable[..., Iterable[str]]
    leads: bool = False


# Sections that are shown by their columns, by name.
ADDED: dict[str, NumberSection] = {}


def add_section(section: NumberSection, *quantities: Quantity) -> None:
    """Publish a section with its quantities.

    Raises:
        ValueError: There is a section of this name, or as `add_quantity`.
    """
    if section.name in TABLE:
        raise ValueError(f"there is a section '{section.name}' already")
    ADDED[section.name] = section
    TABLE[section.name] = {}
    add_quantity(*quantities)


# The table, one row for each number: key, unit, unit in tables, digits there.
_interface = partial(Quantity, "interfaces")
_region = partial(Quantity, "regions")
_stem = partial(Quantity, "stem")
_femur = partial(Quantity, "femur")
_bond = partial(Quantity, "bonds")
_heated_region = partial(Quantity, "thermal.regions")
_dose = partial(_heated_region, error_class=DOSE_ERRORS)
_heated_interface = partial(Quantity, "thermal.interfaces")
_cure = partial(Quantity, "cure")
_solver = partial(Quantity, "solver")
_balance = partial(Quantity, "balance")
_timing = partial(Quantity, "timing")


def _spread(
    key: str,
    label: str,
    unit: Mapping[str, Any],
    error_class: ErrorClass,
    class_of_mean: ErrorClass,
    headline: str = "",
    on_page: bool = False,
) -> Iterator[Quantity]:
    """Maximum, percentiles and mean of a field on an interface.

    Args:
        key: First part of their keys, before ``_max``.
        label: First part of their labels, before `, max`.
        unit: Their unit, and unit and digits in tables.
        error_class: Class of the percentiles.
        class_of_mean: Class of the mean.
        headline: Statistic that compares runs. history.csv has it and the maximum.
        on_page: True if the page of a run has them in a table.
    """
    for statistic in ("max", "p95", "p99", "mean"):
        classes = {"max": None, "mean": class_of_mean}
        yield Quantity(
            "interfaces",
            f"{key}_{statistic}",
            **unit,
            label=f"{label}, {statistic}",
            error_class=classes.get(statistic, error_class),
            peak=statistic == "max",
            step_record=bool(headline) and statistic in ("max", headline),
            headline=statistic == headline,
            on_page=on_page,
        )


def _failure(section: str) -> Iterator[Quantity]:
    """Failure index of a surface."""
    index = partial(Quantity, section, unit="-", digits=3)
    yield index("failure_index_max", label="failure index, max", peak=True)
    yield index(
        "failure_index_p99",
        label="failure index, p99",
        error_class=TRACTION_ERRORS,
        step_record=True,
    )
    yield index(
        "failure_load_factor",
        label="multiple of the load at which 1 % fails",
        error_class=TRACTION_ERRORS,
    )


_above_strength = partial(
    Quantity,
    key="strength_fraction",
    unit="-",
    shown="%",
    digits=0,
    label="fraction of the area above the strength",
    step_record=True,
)
MICROMETRES = {"unit": "mm", "shown": "um", "digits": 1}
_of_motion = partial(
    _spread, unit=MICROMETRES, error_class=MOTION_ERRORS, class_of_mean=MOTION_ERRORS
)
_of_slip = partial(_spread, unit=MICROMETRES, error_class=SLIP_ERRORS, class_of_mean=SLIP_ERRORS)
# Tractions at edges grow with refinement: their 95th percentile is the headline.
_of_traction = partial(
    _spread,
    unit={"unit": "MPa"},
    error_class=TRACTION_ERRORS,
    class_of_mean=MOTION_ERRORS,
    headline="p95",
)

add_quantity(
    *_of_motion("gap", "gap", headline="p99"),
    *_of_slip("slip", "slip", headline="p99"),
    *_of_slip("slip_path", "path of slip"),
    *_of_motion("motion", "motion", headline="p99"),
    # Of a press fit: motion since its gap last changed.
    *_of_motion("micromotion", "micromotion", headline="p99", on_page=True),
    *_of_traction("pressure", "pressure"),
    *_of_traction("shear", "shear stress"),
    # Contact: overlap of the sides, state of the points, forces and energies.
    _interface(
        "penetration_max",
        "mm",
        "um",
        label="penetration, max",
        exact=True,
        step_record=True,
        headline=True,
    ),
    _interface("compression_max", "mm", "um", label="compression of the layer, max", exact=True),
    _interface(
        "penetration_sampled", "mm", "um", label="penetration between nodes, max", exact=True
    ),
    _interface("penetration_mean", "mm", "um", label="penetration, mean", exact=True),
    _interface(
        "open_fraction",
        "-",
        "%",
        0,
        label="open fraction of the area",
        step_record=True,
        headline=True,
    ),
    _interface(
        "stick_fraction", "-", "%", 0, label="sticking fraction of the area", step_record=True
    ),
    _interface(
        "slip_fraction",
        "-",
        "%",
        0,
        label="slipping fraction of the area",
        step_record=True,
        headline=True,
    ),
    *(
        _interface(
            f"area_{field}_over_{level}um",
            "mm^2",
            label=f"area of {words} over {level} µm",
            on_page=True,
        )
        for field, words, levels in (
            ("gap", "a gap", (30,)),
            ("slip", "slip", (30,)),
            ("motion", "motion", (30,)),
            ("micromotion", "micromotion", (40, 150)),
            ("inducible", "inducible motion", (40, 150)),
        )
        for level in levels
    ),
    _interface("force", "N", error_class=MOTION_ERRORS, vector=True),
    _interface("dissipation", "N mm", error_class=SLIP_ERRORS, step_record=True, curve=True),
    _interface(
        "dissipation_min",
        "N mm",
        label="smallest dissipation of a point in a step",
        step_record=True,
    ),
    _interface("contact_work", "N mm", label="work of the contact pressure", step_record=True),
    # Layers, and cohesive interfaces that break.
    _interface("stored_energy", "N mm", step_record=True),
    _interface(
        "unbonded_fraction", "-", "%", 1, label="fraction of the area that never bonded", exact=True
    ),
    _interface("area_damaged", "mm^2", digits=1, label="damaged area", step_record=True),
    _interface("area_broken", "mm^2", digits=1, label="broken area", step_record=True),
    _interface(
        "damage_mean",
        "-",
        digits=4,
        label="damage, mean",
        error_class=MOTION_ERRORS,
        step_record=True,
    ),
    _interface("pressure_by_facets", "MPa", label="pressure caused by facets, max", exact=True),
    _interface("pressure_mean_max", "MPa", label="mean pressure of a point, max"),
    _interface("zone_length", "mm", digits=1, label="length of the process zone", step_record=True),
    _interface("zone_elements", "-", digits=1, label="elements in the process zone"),
    _above_strength("interfaces"),
    *_failure("interfaces"),
)
add_quantity(
    _region("von_mises_max", "MPa", label="von Mises stress, max", peak=True),
    _region(
        "von_mises_p99",
        "MPa",
        label="von Mises stress, p99",
        error_class=STRESS_ERRORS,
        headline=True,
    ),
    _region("hoop_p99", "MPa", label="hoop stress, p99", error_class=STRESS_ERRORS),
    _region("principal_max", "MPa", label="tension, max", peak=True),
    _region("principal_p99", "MPa", label="tension, p99", error_class=STRESS_ERRORS),
    _region("principal_min", "MPa", label="smallest principal stress", peak=True),
    _region("mean_stress_min", "MPa", label="mean stress, min"),
    _region("mean_stress_max", "MPa", label="mean stress, max"),
    _region("creep_strain_max", "-", "%", label="creep strain, max", peak=True),
    _region(
        "creep_strain_mean",
        "-",
        "%",
        label="creep strain, mean",
        error_class=STRESS_ERRORS,
        headline=True,
    ),
    *(
        _region(
            f"volume_over_{level}_MPa",
            "mm^3",
            digits=1,
            label=f"volume with tension over {level} MPa",
            error_class=RISK_ERRORS,
        )
        for level in TENSION_LEVELS
    ),
)
add_quantity(
    _stem("subsidence", "mm", "um", 1, error_class=MOTION_ERRORS, step_record=True, headline=True),
    _stem(
        "retroversion", "deg", digits=3, error_class=MOTION_ERRORS, step_record=True, headline=True
    ),
    _stem("varus", "deg", digits=3, error_class=MOTION_ERRORS, step_record=True, headline=True),
    _stem(
        "insertion_subsidence",
        "mm",
        "um",
        1,
        label="subsidence during the insertion",
        error_class=MOTION_ERRORS,
        on_page=True,
    ),
    _stem(
        "tip_displacement",
        "mm",
        "um",
        1,
        label="displacement of the tip",
        error_class=MOTION_ERRORS,
        vector=True,
    ),
    _stem(
        "top_displacement",
        "mm",
        "um",
        1,
        label="displacement of the top",
        error_class=MOTION_ERRORS,
        vector=True,
    ),
    _stem(
        "collar_force",
        "N",
        digits=0,
        label="force on the collar",
        error_class=MOTION_ERRORS,
        on_page=True,
    ),
    _stem("flank_force", "N", digits=0, label="force on the flanks", error_class=MOTION_ERRORS),
    _stem(
        "collar_share",
        "-",
        "%",
        0,
        label="part of the axial force on the collar",
        error_class=MOTION_ERRORS,
        on_page=True,
    ),
)
add_quantity(
    _femur(
        "head_displacement",
        "mm",
        label="displacement of the head",
        error_class=MOTION_ERRORS,
        vector=True,
    ),
    # Strains of the cortex.
    *(
        _femur(
            f"strain_{side}_{gauge}",
            "-",
            "um/m",
            0,
            label=f"{side} strain at z = {z:g} mm",
            error_class=STRESS_ERRORS,
        )
        for side in ("lateral", "medial")
        for gauge, z in GAUGES.items()
    ),
)
add_quantity(
    _above_strength("bonds"),
    _bond("normal_mean", "MPa", label="normal traction, mean"),
    _bond("normal_max", "MPa", label="normal traction, max"),
    _bond("shear_mean", "MPa", label="shear stress, mean"),
    _bond("shear_max", "MPa", label="shear stress, max"),
    *_failure("bonds"),
)
add_quantity(
    _heated_region(
        "temperature_max",
        "degC",
        digits=1,
        label="highest temperature",
        error_class=TEMPERATURE_ERRORS,
        headline=True,
    ),
    _heated_region(
        "temperature_min",
        "degC",
        digits=1,
        label="lowest temperature",
        error_class=TEMPERATURE_ERRORS,
    ),
    _heated_region(
        "temperature_mean",
        "degC",
        digits=1,
        label="mean temperature at the end",
        error_class=TEMPERATURE_ERRORS,
    ),
    _heated_region(
        "temperature_end_max",
        "degC",
        digits=1,
        label="highest temperature at the end",
        error_class=TEMPERATURE_ERRORS,
    ),
    _heated_region(
        "temperature_max_time",
        "s",
        digits=1,
        label="time of the highest temperature",
        error_class=DOSE_ERRORS,
    ),
    *(
        _dose(f"seconds_over_{level}", "s", digits=1, label=f"time over {level} °C")
        for level in TEMPERATURE_LEVELS
    ),
    *(
        _dose(f"volume_over_{level}", "mm^3", digits=1, label=f"volume over {level} °C")
        for level in TEMPERATURE_LEVELS
    ),
    _heated_region("cem43_max", "min", digits=1, label="dose CEM43, max", error_class=DOSE_ERRORS),
    _heated_region(
        "henriques_moritz_max",
        "-",
        digits=1,
        label="damage by Henriques-Moritz, max",
        error_class=DOSE_ERRORS,
    ),
    # Dead bone.
    *(
        _dose(f"necrosis_{key}_volume", "mm^3", digits=1, label=f"dead by {in_print(rule)}, volume")
        for key, rule in NECROSIS.items()
    ),
    *(
        _dose(f"necrosis_{key}_depth", "mm", label=f"dead by {in_print(rule)}, depth")
        for key, rule in NECROSIS.items()
    ),
)
add_quantity(
    *(
        _heated_interface(
            f"temperature_max_{side}",
            "degC",
            digits=1,
            label=f"highest temperature, {side} side",
            error_class=TEMPERATURE_ERRORS,
            headline=True,
        )
        for side in ("first", "second")
    ),
    *(
        _heated_interface(
            f"temperature_max_{side}_time",
            "s",
            digits=1,
            label=f"time of the maximum, {side} side",
            error_class=DOSE_ERRORS,
        )
        for side in ("first", "second")
    ),
    _heated_interface(
        "temperature_jump_max",
        "K",
        digits=1,
        label="temperature jump, max",
        error_class=TEMPERATURE_ERRORS,
    ),
    _heated_interface(
        "heat_flux_max", "W/m^2", digits=0, label="heat flux, max", error_class=TEMPERATURE_ERRORS
    ),
    _heated_interface(
        "entropy_production_min", "W/(m^2 K)", digits=1, label="entropy production, min"
    ),
    _heated_interface(
        "entropy_production_max", "W/(m^2 K)", digits=1, label="entropy production, max"
    ),
)
add_quantity(
    _cure("degree_min", "-", digits=4, label="degree of cure, min", error_class=DOSE_ERRORS),
    _cure("degree_max", "-", digits=4, label="degree of cure, max", error_class=DOSE_ERRORS),
    _cure(
        "time_50",
        "s",
        digits=1,
        label="time until 50 % has set everywhere",
        error_class=DOSE_ERRORS,
    ),
    _cure(
        "time_90",
        "s",
        digits=1,
        label="time until 90 % has set everywhere",
        error_class=DOSE_ERRORS,
    ),
    _cure("rate_max", "1/s", digits=4, label="rate of cure, max", error_class=DOSE_ERRORS),
)
add_quantity(
    _solver("newton_iterations", "-", label="Newton iterations", exact=True),
    _solver("linear_iterations", "-", label="Krylov iterations", exact=True),
    _solver("condition", "-", label="condition number", exact=True),
)
add_quantity(
    _balance("heat", "-", exact=True),
    _balance("heat_quadrature", "-", exact=True),
)
add_quantity(
    _timing("solve", "s", exact=True),
    _timing("total", "s", exact=True),
)


add_section(
    NumberSection(
        name="probes",
        title="Probes and strain gauges",
        columns={"gauge": "", "strain": "strain"},
        owners=lambda case: (case.output and case.output.probes) or (),
    ),
    Quantity(
        "probes",
        "strain",
        "-",
        "um/m",
        0,
        error_class=STRESS_ERRORS,
        step_record=True,
        headline=True,
    ),
    Quantity(
        "probes", "displacement", "mm", error_class=MOTION_ERRORS, vector=True, step_record=True
    ),
)


def names_of_run_numbers() -> list[str]:
    """Full names of the numbers of the run: cost and balances."""
    return [f"{section}.{key}" for section in RUN_SECTIONS for key in TABLE[section]]


def _tables(owner: str) -> Iterator[dict[str, Quantity]]:
    """Tables with quantities of an interface, a region, the stem or the run."""
    return (
        rows
        for section, rows in TABLE.items()
        if section not in SECTIONS_WITHOUT_OWNER or section == owner
    )


def quantity_of(name: str) -> Quantity | None:
    """Quantity by its name, ``<owner>.<key>`` or one of `names_of_run_numbers`; None if unknown."""
    owner, _, key = name.partition(".")
    return next((q for rows in _tables(owner) for q in rows.values() if key in q.names), None)


def quantity_or_fail(name: str) -> Quantity:
    """A quantity as in `quantity_of`.

    Raises:
        PydanticCustomError: There is no such key.
    """
    q = quantity_of(name)
    if q is not None:
        return q
    owner, _, key = name.partition(".")
    if owner in RUN_SECTIONS:
        fail(f"{show(name)} is not one of {', '.join(names_of_run_numbers())}")
    known_names = dict.fromkeys(
        n for rows in _tables(owner) for q in rows.values() for n in q.names
    )
    hint = did_you_mean(key, tuple(known_names)) or f"; one of {', '.join(known_names)}"
    fail(f"{show(name)} is not <interface>.<key>, <region>.<key> or stem.<key>{hint}")


def place_in_words(place: str) -> str:
    """An interface, a region, a part or a zone of one for people: ``stem-cement rim``."""
    if place in PLACES:
        return PLACES[place]
    wholes = [whole for whole in PLACES if place.startswith(f"{whole}_")]
    whole = max(wholes, key=len, default="")
    part = place.removeprefix(whole).strip("_").replace("_", " ")
    return f"{PLACES[whole]} {part}" if whole else part


def label_and_unit(name: str) -> tuple[str, str]:
    """A number's label, e.g. stem-cement slip, p99, and its unit as printed."""
    place, _, key = name.partition(".")
    place_words = place_in_words(place)
    q = quantity_of(name)
    if q is None:
        return f"{place_words} {key}".replace("_", " "), ""
    return f"{place_words} {key.replace(q.key, q.label)}", printed(q.shown)


def label_with_unit(name: str) -> str:
    """A number's label with its unit in brackets, if it has one."""
    return with_brackets(*label_and_unit(name))


def known_value(name: str, value: object, difference: bool = False) -> float:
    """A value in a file, in the unit of its quantity; or a difference of two values.

    Raises:
        PydanticCustomError: It has another dimension.
    """
    unit = quantity_or_fail(name).unit
    if difference and unit == "degC":
        unit = "K"
    kind: Plain | Dimension
    if unit == "-":
        kind = Plain()
    else:
        kind = Dimension(unit, UNITS[unit], f"1 {unit}", unit != "K")
    return float(kind.read(value))


def computed(section: str, samples: object, target: object) -> dict[str, float]:
    """Added numbers of an interface or a region (`Quantity.compute`)."""
    return {q.key: float(q.compute(samples, target)) for q in TABLE[section].values() if q.compute}
