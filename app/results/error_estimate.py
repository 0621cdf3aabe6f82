r"""Estimated errors of the numbers of a run, from coarser companion runs.

A number X of a run on a mesh of size h has the estimated error

.. math:: e = \max(e_1,\; b\, m\, |X_h|), \qquad e_1 = a\, |X_h - X_{2h}| + |C| / n,

where :math:`X_{2h}` is the number of a companion on a mesh of size 2 h, C / n the error of n steps,
and m the median of :math:`e_1 / (a |X_h|)` over a group of numbers. The term with m is needed
because two meshes may agree by chance.

The factors a and b of each class are in `case.error_classes`. They were fitted to six hips and to
scenes with heat, and tested on other cases (docs/verification.md).

Each part of the estimate, with its exceptions, is in the docstring of its function:

- meshes and steps of the companions: `companions`;
- C / n: `_error`;
- the change to a mesh that is not of size 2 h, and to two meshes; a without a class: `_mesh_error`;
- the groups of the median, and b: `_raise_to_typical_errors`;
- numbers that are zero, which do not enter medians: `is_zero`;
- Gruen zones: `_size_in_zones`;
- press fits: `add_error_estimates`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from app.case.case import Case
from app.case.error_classes import STRESS_ERRORS, ErrorClass
from app.case.quantities import ADDED, TABLE, Quantity
from app.case.summary import Numbers, Summary
from app.case.summary_numbers import numbers_of
from app.foundation.arrays import Floats

# Mesh sizes of companions over that of the run [-]: the first for the error of the mesh, the second
# for that of the steps and, with temperatures, of the mesh too.
COARSENINGS = (2.0, 3.0)
# Power of the error of all time steps with which the tolerance of one step scales.
TOLERANCE_POWER = {"sdirk4": 1.0, "backward_euler": 2.0}
# A peak is unsettled if it changes by more than this fraction between the run and the next coarser
# mesh.
UNSETTLED = 0.1
# Fraction of the largest number of its unit to which errors of smaller numbers are relative.
NEGLIGIBLE = 0.1
# A number is rounding below this fraction of the largest number of its unit.
ROUNDING_OF_NUMBERS = 1e-6
# Below this fraction it is zero if it changes from mesh to mesh by at least its size.
SMALL_FRACTION = 0.01
# Smallest mesh size over that of the run with which a mesh is compared [-].
LEAST_COARSENING = 1.25
# Size of a number of a Gruen zone over the mean of all zones, at least.
LEAST_OF_MEAN = 0.25
# Share of the numbers of a hip whose true error is below the estimate, at first and second order.
SHARE_WITHIN_ERROR = (0.92, 0.91)
# Sections whose errors are raised to the typical error of their group.
SECTIONS_WITH_MEDIAN = {"interfaces", "regions", "stem", "femur", "cure"}
SECTIONS_WITH_MEDIAN |= {"thermal.regions", "thermal.interfaces"}
# The section of these whose numbers are not in the median: strains at points of the cortex.
OUTSIDE_MEDIAN = "femur"
# Peaks that are compared with each other.
PEAKS_OF_MOTION = ("gap_max", "slip_max")


@dataclass(frozen=True)
class Companion:
    """A coarser run that shows the error of a run.

    Attributes:
        coarsening: Mesh size of the companion over that of the run [-].
        step_ratio: Increments of the companion over those of the run [-]. For time steps, the
            factor on their error is the inverse.
    """

    case: Case
    coarsening: float
    step_ratio: float

    def __str__(self) -> str:
        """Mesh and steps of the companion, in words."""
        fewer = f", {self.step_ratio:g} times the steps" if self.step_ratio != 1 else ""
        size = f"{self.case.mesh.size:g} mm" if self.case.mesh.size else "of the file"
        return f"mesh {size}{fewer}"


@dataclass(frozen=True)
class Estimated:
    """An error that may be small by chance.

    Attributes:
        errors: Table with the error.
        key: Key of the error in it.
        error_class: Class of the number.
        size: Size of the number.
        of_part: True for a number of a part.
        in_median: True if the change of the number counts in the median.
    """

    errors: Numbers
    key: str
    error_class: ErrorClass
    size: float
    of_part: bool
    in_median: bool = True

    def change(self, degree_index: int) -> float:
        """Relative change to the companion [-]."""
        factor = self.error_class.change_factor(degree_index)
        return float(self.errors[self.key]) / (factor * self.size)

    @property
    def group(self) -> tuple[bool, str]:
        """Parts or not, and group of its class: numbers of a group have one median."""
        return self.of_part, self.error_class.median_group


# Companions with their sections, and with numbers of one owner.
Solved = Sequence[tuple[Companion, Summary]]
Others = Sequence[tuple[Companion, Numbers]]
ErrorValue = float | list[float]


@dataclass(frozen=True)
class _Table:
    """Numbers of an interface, a region or another owner.

    Attributes:
        section: Section of the summary.
        name: The owner.
        numbers: Its numbers in the run.
        others: Its numbers in the companions.
        of_part: True for a part, such as a rim.
    """

    section: str
    name: str
    numbers: Numbers
    others: Others
    of_part: bool

    @property
    def quantities(self) -> list[Quantity]:
        """Quantities that it has in the run."""
        return [q for q in TABLE[self.section].values() if self.numbers.get(q.key) is not None]


@dataclass(frozen=True)
class _Solution:
    """A number or vector in the run or a companion.

    Attributes:
        coarsening: Mesh size over that of the run [-].
        step_ratio: Steps over those of the run [-].
        value: The number.
    """

    coarsening: float
    step_ratio: float
    value: Floats


def companions(case: Case) -> tuple[Companion, ...]:
    """Companion runs that the error estimate of a case needs; none unless it asks for one.

    A mesh from a file cannot be made coarser, unless a ``.geo`` script makes it: only its step
    error is estimated.

    With friction or damage the solution depends on the load path. The companion of 2 h then takes
    half the steps, which is cheaper. One companion of 3 h takes half the steps, another one all
    steps. If the run takes one step, they take one and two. In transient stages, half the steps
    means a tolerance for which the error of the time steps is twice as large.
    """
    if not case.output.error:
        return ()
    most_increments = max(stage.increments for stage in case.stages)
    depends_on_path = any(
        law.largest_friction > 0 or law.dissipates for law in case.interfaces.values()
    )
    is_timed = any(stage.duration for stage in case.stages)
    if depends_on_path:
        step_ratio = most_increments // 2 / most_increments if most_increments > 1 else 1.0
    else:
        step_ratio = 0.5 if is_timed else 1.0
    # Mesh sizes over that of the run, as far as the geometry can be meshed.
    coarsest_size = case.geometry.coarsest_size
    coarsest_ratio = coarsest_size / case.mesh.size if coarsest_size else 0.0
    possible = dict.fromkeys(min(factor, coarsest_ratio) for factor in COARSENINGS)
    coarsenings = tuple(coarsening for coarsening in possible if coarsening > LEAST_COARSENING)
    meshes = tuple(_companion(case, coarsening, step_ratio) for coarsening in coarsenings)
    if not (depends_on_path or is_timed) or (len(meshes) == 1 and step_ratio < 1):
        # On one coarser mesh the difference itself shows half the steps well enough.
        return meshes[:1]
    largest_coarsening = (1.0, *coarsenings)[-1]
    steps = 2.0 if step_ratio == 1 else 1.0 if meshes else step_ratio
    return (*meshes, _companion(case, largest_coarsening, steps))


def _companion(case: Case, coarsening: float, steps: float) -> Companion:
    mesh = case.mesh.coarser(coarsening)
    stages = tuple(
        s.model_copy(update={"increments": max(1, round(s.increments * steps))})
        for s in case.stages
    )
    changed_keys: dict[str, object] = {"mesh": mesh, "stages": stages}
    if case.time is not None:
        tolerance = case.time.tolerance / steps ** TOLERANCE_POWER[case.time.method]
        changed_keys["time"] = case.time.model_copy(update={"tolerance": tolerance})
    return Companion(case.model_copy(update=changed_keys), coarsening, steps)


def error_sources(solved: Sequence[Companion]) -> str:
    """Name the error sources covered: "mesh and step", "time step" or "load step"."""
    if any(companion.coarsening > LEAST_COARSENING for companion in solved):
        return "mesh and step"
    return (
        "time step"
        if any(s.duration for companion in solved for s in companion.case.stages)
        else "load step"
    )


def add_error_estimates(run: Summary, case: Case, solved: Solved) -> dict[str, list[list[float]]]:
    """Add ``X_error`` next to each number X that has an order of convergence.

    In press fits slips and tractions have larger errors, and at first order motions and stresses
    too: errors get further factors, which were fitted to three such hips.

    Args:
        run: Sections interfaces, regions and stem of the run's summary, and thermal and cure where
            there are any; changed in place.
        case: Case of the run.
        solved: Companions of the run, with the same sections.

    Returns:
        Maxima that still change with the mesh, by names such as ``interface.pressure_max``, the
        largest change first. Each has pairs of mesh size [mm] and value, the finest mesh first.
    """
    degree_index = case.mesh.order - 1
    tables = _tables_with_companions(run, solved)
    for table in tables:
        classes = {q.key: q.error_class for q in table.quantities if q.error_class}
        _add_errors(table.numbers, classes, degree_index, table.others)
    estimated_numbers = _estimated_numbers(run, tables, degree_index)
    estimated_numbers += _zone_errors(run, degree_index, solved)
    _raise_to_typical_errors(estimated_numbers, degree_index)
    if any(law.is_press_fit for law in case.interfaces.values()):
        for number in estimated_numbers:
            number.errors[number.key] *= number.error_class.press_fit_factors[degree_index]
    return _unsettled_peaks(run, tables, case)


def _tables_with_companions(run: Summary, solved: Solved) -> list[_Table]:
    """Return the tables of a run, each with the same table of its companions."""
    tables_of_companions = [
        (companion, {(section, name): q for section, name, q in numbers_of(summary, parts=True)})
        for companion, summary in solved
    ]
    wholes = {(section, name) for section, name, _ in numbers_of(run)}
    return [
        _Table(
            section,
            name,
            numbers,
            others=[(c, tables.get((section, name), {})) for c, tables in tables_of_companions],
            of_part=(section, name) not in wholes,
        )
        for section, name, numbers in numbers_of(run, parts=True)
    ]


def _estimated_numbers(
    run: Summary, tables: Sequence[_Table], degree_index: int
) -> list[Estimated]:
    """Return the errors of a run that are compared with the typical one, without numbers of 0."""
    largest = largest_of_units(run)
    estimated_numbers: list[Estimated] = []
    for table in tables:
        if table.section not in SECTIONS_WITH_MEDIAN and table.section not in ADDED:
            continue
        for q in table.quantities:
            error, value = table.numbers.get(f"{q.key}_error"), table.numbers[q.key]
            if error is None or q.vector or not value:
                continue
            if q.error_class is None or q.error_class.change_factors is None:
                continue
            estimated = Estimated(
                table.numbers,
                f"{q.key}_error",
                q.error_class,
                abs(value),
                of_part=table.of_part,
                in_median=table.section != OUTSIDE_MEDIAN,
            )
            change = estimated.change(degree_index) * abs(value)
            if not is_zero(value, change, largest[q.unit]):
                estimated_numbers.append(estimated)
    return estimated_numbers


def _unsettled_peaks(
    run: Summary, tables: Sequence[_Table], case: Case
) -> dict[str, list[list[float]]]:
    """Return maxima that still change with the mesh, as `add_error_estimates`."""
    largest = largest_of_units(run)
    peaks = [(table, q) for table in tables for q in table.quantities if q.peak]
    largest_of_kind: dict[str, float] = {}
    for table, q in peaks:
        kind, value = _peak_kind(q.key), abs(table.numbers[q.key])
        largest_of_kind[kind] = max(largest_of_kind.get(kind, 0.0), value)
    unsettled: list[tuple[float, str, list[list[float]]]] = []
    for table, q in peaks:
        values = _values_on_meshes(q.key, table.numbers, case, table.others)
        # The value of the run itself if there is no coarser mesh.
        coarser_value = values[min(1, len(values) - 1)][1]
        largest_peak = largest_of_kind[_peak_kind(q.key)]
        change = _unsettled_change(values[0][1], coarser_value, largest_peak, largest[q.unit])
        if change is not None:
            unsettled.append((change, f"{table.name}.{q.key}", values))
    largest_first = sorted(unsettled, key=lambda peak: peak[0], reverse=True)
    return {name: values for _, name, values in largest_first}


def _peak_kind(key: str) -> str:
    """Return the kind of a maximum; all motions are of one kind."""
    return "motion" if key in PEAKS_OF_MOTION else key


def _unsettled_change(
    value: float, coarser_value: float, largest_peak: float, largest: float
) -> float | None:
    """Return the relative change of a maximum to a coarser mesh, None if it is small.

    Args:
        value: The maximum.
        coarser_value: The maximum on the next coarser mesh.
        largest_peak: Largest maximum of its kind; relative to it a maximum can be negligible.
        largest: Largest absolute value of the numbers of its unit.
    """
    size = max(abs(value), UNSETTLED * largest_peak)
    change = abs(value - coarser_value)
    if is_zero(value, change, largest) and abs(coarser_value) < SMALL_FRACTION * largest:
        return None
    return change / max(size, abs(coarser_value)) if change > UNSETTLED * size else None


def _raise_to_typical_errors(estimated_numbers: Sequence[Estimated], degree_index: int) -> None:
    """Raise errors that are small by chance to b m |X|, with the median m of their group.

    Numbers of parts (rim, tip, neck, surface zones, Gruen zones) change more from mesh to mesh than
    those of whole interfaces: they have a separate median and a separate factor b. The groups of
    classes are `ErrorClass.median_group`. For temperatures b is zero.

    Args:
        estimated_numbers: The errors.
        degree_index: Polynomial order of the displacement less one.
    """
    changes: dict[tuple[bool, str], list[float]] = {}
    for number in estimated_numbers:
        if number.in_median:
            changes.setdefault(number.group, []).append(number.change(degree_index))
    typical = {group: float(np.median(of_group)) for group, of_group in changes.items()}
    for number in estimated_numbers:
        factor = number.error_class.median_factor(degree_index, number.of_part)
        smallest_error = factor * typical[number.group] * number.size
        number.errors[number.key] = max(number.errors[number.key], smallest_error)


def largest_of_units(summary: Summary) -> dict[str, float]:
    """Return the largest absolute value of the numbers of a summary, by unit."""
    largest: dict[str, float] = {}
    for section, _, numbers in numbers_of(summary, parts=True):
        for key, q in TABLE[section].items():
            value = numbers.get(key)
            if value is not None and not q.vector:
                largest[q.unit] = max(largest.get(q.unit, 0.0), abs(float(value)))
    # A difference of temperatures is rounding compared with the temperatures.
    if "degC" in largest:
        largest["K"] = max(largest.get("K", 0.0), largest["degC"])
    return largest


def reference_size(value: float, q: Quantity, largest: Mapping[str, float]) -> float:
    """Return the size to which an error or a change of a number is relative.

    It is the number itself, or `NEGLIGIBLE` of the largest number of its unit if that is larger.
    """
    return max(abs(value), NEGLIGIBLE * largest[q.unit])


def is_zero(value: float, change: float, largest: float) -> bool:
    """Return True if a number is zero: rounding, or small and changing by its size or more.

    Args:
        value: The number.
        change: Change to a coarser mesh, or error of the number.
        largest: Largest absolute value of the numbers of its unit.
    """
    size = abs(value)
    return size <= ROUNDING_OF_NUMBERS * largest or (
        size < SMALL_FRACTION * largest and change >= size
    )


def _zone_errors(run: Summary, degree_index: int, solved: Solved) -> list[Estimated]:
    """Add errors to the means of interfaces and the strain energy of Gruen zones; return them."""
    zones = run.get("gruen", {})
    estimated_numbers: list[Estimated] = []
    for zone, numbers in zones.items():
        companion_numbers = [
            (companion, companion_summary.get("gruen", {}).get(zone, {}))
            for companion, companion_summary in solved
        ]
        for name, at_interface in numbers["interfaces"].items():
            classes = {
                q.key: q.error_class
                for q in TABLE["interfaces"].values()
                if q.error_class and q.key.endswith("_mean") and q.key in at_interface
            }
            numbers_of_companions = [
                (companion, companion_summary.get("interfaces", {}).get(name, {}))
                for companion, companion_summary in companion_numbers
            ]
            _add_errors(at_interface, classes, degree_index, numbers_of_companions)
            in_zones = [z["interfaces"].get(name, {}) for z in zones.values()]
            estimated_numbers += [
                Estimated(
                    at_interface,
                    f"{key}_error",
                    classes[key],
                    _size_in_zones(at_interface[key], key, in_zones),
                    of_part=True,
                )
                for key in classes
                if f"{key}_error" in at_interface
            ]
        density = numbers["strain_energy_density"]
        numbers_of_companions = [
            (companion, companion_summary.get("strain_energy_density", {}))
            for companion, companion_summary in companion_numbers
        ]
        errors = {
            region: _error(region, STRESS_ERRORS, degree_index, density, numbers_of_companions)
            for region in density
        }
        known_errors = {
            region: error for region, error in errors.items() if isinstance(error, float)
        }
        if known_errors:
            numbers["strain_energy_density_error"] = known_errors
        in_zones = [z["strain_energy_density"] for z in zones.values()]
        estimated_numbers += [
            Estimated(
                known_errors,
                region,
                STRESS_ERRORS,
                _size_in_zones(density[region], region, in_zones),
                of_part=True,
            )
            for region in known_errors
        ]
    return [number for number in estimated_numbers if number.size]


def _size_in_zones(value: float, key: str, in_zones: Sequence[Numbers]) -> float:
    """Size of a number of a Gruen zone: at least a part of the mean over all zones that have it."""
    sizes = [abs(numbers[key]) for numbers in in_zones if key in numbers]
    return max(abs(value), LEAST_OF_MEAN * float(np.mean(sizes)))


def _add_errors(
    numbers: Numbers,
    classes: Mapping[str, ErrorClass],
    degree_index: int,
    companion_numbers: Others,
) -> None:
    """Add errors to the numbers with these keys and classes."""
    errors = {
        key: _error(key, error_class, degree_index, numbers, companion_numbers)
        for key, error_class in classes.items()
    }
    numbers |= {f"{key}_error": error for key, error in errors.items() if error is not None}


def _values_on_meshes(
    key: str, run: Numbers, case: Case, companion_numbers: Others
) -> list[list[float]]:
    """Return mesh size [mm] and value on each mesh, the finest first.

    Of two companions on one mesh, the one with the steps of the run counts.
    """
    values = {case.mesh.size: run[key]}
    for companion, companion_values in sorted(
        companion_numbers, key=lambda entry: -abs(entry[0].step_ratio - 1)
    ):
        if companion.coarsening > LEAST_COARSENING and companion_values.get(key) is not None:
            values[companion.case.mesh.size] = companion_values[key]
    return [[size, values[size]] for size in sorted(values)]


def _error(
    key: str, error_class: ErrorClass, degree_index: int, run: Numbers, companion_numbers: Others
) -> ErrorValue | None:
    """Error of one number or vector by the equations above; None if it is unknown.

    The error of n load steps is taken as C / n, as for an implicit Euler method. Two companions on
    one mesh with different numbers of steps give C.
    """
    of_run = _Solution(1.0, 1.0, np.asarray(run[key]))
    of_companions = [
        _Solution(companion.coarsening, companion.step_ratio, np.asarray(numbers[key]))
        for companion, numbers in companion_numbers
        if numbers.get(key) is not None
    ]
    if not of_companions:
        return None
    # Two solutions on one mesh with different steps give C / n. One is the last companion.
    last = of_companions[-1]
    on_mesh_of_last = [
        s
        for s in (of_run, *of_companions[:-1])
        if s.coarsening == last.coarsening and s.step_ratio != last.step_ratio
    ]
    step_error = np.zeros(last.value.shape)
    if on_mesh_of_last:
        other = on_mesh_of_last[0]
        step_error += (other.value - last.value) / (1 / other.step_ratio - 1 / last.step_ratio)
    # If C / n is known, a companion with more steps than the run has no further use.
    on_coarser_meshes = [
        s
        for s in of_companions
        if s.coarsening > LEAST_COARSENING and (s.step_ratio <= 1 or not on_mesh_of_last)
    ]
    error = np.abs(step_error)
    if on_coarser_meshes:
        error = (
            _mesh_error(of_run, on_coarser_meshes, step_error, error_class, degree_index) + error
        )
    return cast(ErrorValue, np.asarray(error).tolist())


def _mesh_error(
    of_run: _Solution,
    on_coarser_meshes: Sequence[_Solution],
    step_error: Floats,
    error_class: ErrorClass,
    degree_index: int,
) -> Floats:
    """Error of the mesh.

    The change to a companion of another mesh size is scaled to 2 h by the order of convergence. A
    class with `ErrorClass.two_mesh_factors`, that of temperatures, has the larger of the scaled
    change to 3 h and the change to 2 h, each times its factor, if there are both companions. A
    number outside the fitted classes has the factor of Richardson's extrapolation,
    :math:`1 / (2^p - 1)` with the order p. The true error then exceeds the estimate more often,
    because contact begins and ends inside cells.

    Args:
        of_run: The number of the run.
        on_coarser_meshes: The number of the companions on coarser meshes, one or more.
        step_error: C / n, the error of the steps of the run.
        error_class: Class of the number.
        degree_index: Polynomial order of the displacement less one.
    """
    order = error_class.orders[degree_index]

    def change(other: _Solution) -> Floats:
        """Return the change to another mesh without the effect of its steps, scaled to 2 h."""
        without_steps = other.value - step_error * (1 / other.step_ratio - 1)
        return abs(of_run.value - without_steps) * (2**order - 1) / (other.coarsening**order - 1)

    finest = min(on_coarser_meshes, key=lambda s: s.coarsening)
    coarsest = max(on_coarser_meshes, key=lambda s: s.coarsening)
    if error_class.two_mesh_factors and coarsest.coarsening > finest.coarsening:
        finest_factor, coarsest_factor = error_class.two_mesh_factors
        return np.maximum(finest_factor * change(finest), coarsest_factor * change(coarsest))
    return error_class.change_factor(degree_index) * change(finest)
