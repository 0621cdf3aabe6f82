"""Fields that can be written along paths: names, units, components."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

from app.case.case import Case
from app.case.paths import PathOptions
from app.case.quantities import INTERFACE_FIELDS
from app.foundation.errors import InputError
from app.scene.scene import Scene
from app.schema.section import did_you_mean


@dataclass(frozen=True)
class PathField:
    """A field along paths.

    Attributes:
        name: Name in the case, without the name of an interface.
        label: Name for people.
        unit: Unit in files.
        shown: Unit on pages; empty if it is the unit in files.
        axes: Names of the components: x, y, z of a vector, xx, yy, ... of a stress; empty for a
            scalar.
        by_cell: True if the field has one value in each cell.
        nearest: True if values are states. A point then has the value of the nearest node.
        interface: Interface of the field; empty for a field of bodies.
    """

    name: str
    label: str
    unit: str
    shown: str = ""
    axes: tuple[str, ...] = ()
    by_cell: bool = False
    nearest: bool = False
    interface: str = ""

    @property
    def file_name(self) -> str:
        """Name in the field file."""
        return f"{self.interface}_{self.name}" if self.interface else self.name


@dataclass(frozen=True)
class PathColumn:
    """A column of the file of a path.

    Attributes:
        field: Field of the column.
        component: Index of the component; None for a scalar and for the length of a vector.
    """

    field: PathField
    component: int | None = None

    @property
    def name(self) -> str:
        """Name in the case, such as ``von_mises`` or ``stress.zz``."""
        axis = "" if self.component is None else f".{self.field.axes[self.component]}"
        return f"{self.field.name}{axis}"

    @property
    def title(self) -> str:
        """Title in the file: the name with the unit."""
        return f"{self.name} [{self.field.unit}]"

    @property
    def label(self) -> str:
        """Name for people."""
        axis = "" if self.component is None else f" {self.field.axes[self.component]}"
        return f"{self.field.label}{axis}"


VECTOR = ("x", "y", "z")
# In the order of VTK.
STRESS = ("xx", "yy", "zz", "xy", "yz", "xz")
MECHANICAL = (
    PathField("displacement", "displacement", "mm", "um", VECTOR),
    PathField("stress", "stress", "MPa", axes=STRESS),
    PathField("von_mises", "von Mises stress", "MPa"),
    PathField("principal_max", "largest principal stress", "MPa"),
    PathField("principal_min", "smallest principal stress", "MPa"),
    PathField("youngs_modulus", "Young's modulus", "MPa", by_cell=True),
    PathField("density", "density of the bone", "g/cm^3", by_cell=True),
)
THERMAL = (
    PathField("temperature", "temperature", "degC"),
    PathField("temperature_peak", "highest temperature so far", "degC"),
)
DOSES = (
    PathField("seconds_over_47", "time at or above 47 °C", "s"),
    PathField("cem43", "CEM43", "min"),
    PathField("henriques_moritz", "Henriques-Moritz", "-"),
)
CURE = PathField("degree_of_cure", "degree of cure", "-")
CONTACT = (
    PathField("pressure", "contact pressure", "MPa"),
    PathField("shear", "shear stress", "MPa"),
    PathField("gap", "gap", "mm", "um"),
    PathField("slip_path", "path slid", "mm", "um"),
    PathField("status", "open 0, stick 1, slip 2", "-", nearest=True),
)
# Fields of interfaces whose sides share their nodes.
SMALL_SLIDING = (
    PathField("slip", "slip", "mm", "um", VECTOR),
    PathField("motion", "motion", "mm", "um", VECTOR),
)
MICROMOTION = PathField("micromotion", "micromotion", "mm", "um")
FAILURE = PathField("failure_index", "failure index", "-")
TEMPERATURE_JUMP = (
    PathField("temperature_jump", "temperature jump", "K"),
    PathField("heat_flux", "heat flux", "W/m^2"),
)
# Default columns of a path without `fields`, if the run has them.
IN_BODIES = ("displacement", "von_mises", "temperature")
ON_CONTACT = ("pressure", "shear", "slip", "gap", "temperature")
Source = Callable[[Case], Iterable[PathField]]
# Functions of other packages. They return further fields of the bodies of a case.
SOURCES: list[Source] = []


def path_fields(function: Source) -> Source:
    """Register a function that returns further fields of the bodies of a case."""
    SOURCES.append(function)
    return function


def field_of(name: str) -> PathField | None:
    """Field with a name; None if it is a field of a law or of another package."""
    all_fields = (
        *MECHANICAL,
        *THERMAL,
        *DOSES,
        CURE,
        *CONTACT,
        *SMALL_SLIDING,
        MICROMOTION,
        FAILURE,
    )
    return next((field for field in (*all_fields, *TEMPERATURE_JUMP) if field.name == name), None)


def available_path_fields(case: Case, scene: Scene, interface: str) -> dict[str, PathField]:
    """Fields that a run has in its bodies and on an interface, by name.

    ``interface`` is the interface of a path; empty for a path through bodies.
    """
    in_bodies: list[PathField] = []
    if scene.elastic:
        in_bodies += MECHANICAL
        for source in SOURCES:
            in_bodies += source(case)
    if scene.conductors:
        in_bodies += THERMAL
        in_bodies += DOSES if case.of_tissue("bone") else ()
        in_bodies += [CURE] if scene.cures else []
    fields = {field.name: field for field in in_bodies}
    on_interface = _of_interface(scene, interface) if interface else []
    return fields | {f.name: replace(f, interface=interface) for f in on_interface}


def _of_interface(scene: Scene, interface: str) -> list[PathField]:
    """Fields of an interface."""
    fields: list[PathField] = []
    for c in scene.parting_interfaces:
        if c.name != interface:
            continue
        fields += CONTACT
        fields += [
            PathField(name, name.replace("_", " "), "-", axes=VECTOR if shape else ())
            for name, shape in c.law.internal_variables.items()
        ]
        if c.press_fit:
            fields.append(MICROMOTION)
        if c.slides_finitely:
            fields += [PathField(f.name, f.label, f.unit) for f in INTERFACE_FIELDS.values()]
        else:
            fields += SMALL_SLIDING
    with_strength = [i.name for i in (*scene.parting_interfaces, *scene.bonds) if i.law.strength]
    if interface in with_strength:
        fields.append(FAILURE)
    if interface in [jump.name for jump in scene.thermal_contacts]:
        fields += TEMPERATURE_JUMP
    return fields


def columns(case: Case, scene: Scene, name: str) -> list[PathColumn]:
    """Columns of a path of a case, in the order of its key `fields`.

    Raises:
        InputError: The run has no such field, or a field has no such component.
    """
    path = case.output.paths[name]
    fields = available_path_fields(case, scene, path.interface_name)
    if path.fields:
        return [
            _column(f"output.paths.{name}.fields.{k}", field_text, fields, path)
            for k, field_text in enumerate(path.fields)
        ]
    usual_fields = ON_CONTACT if "pressure" in fields else IN_BODIES
    return [PathColumn(fields[key]) for key in usual_fields if key in fields]


def _column(
    key: str, field_text: str, fields: Mapping[str, PathField], path: PathOptions
) -> PathColumn:
    """Column with a name; ``key`` is the path of the name in the case."""
    name, _, axis = field_text.partition(".")
    field = fields.get(name)
    if field is None:
        interface_text = f" on {path.interface_name}" if path.interface_name else ""
        hint = did_you_mean(name, [*fields])
        field_list = ", ".join(fields) or "none"
        raise InputError(
            f"{key}: this run has no field '{name}'{interface_text}; it has {field_list}{hint}"
        )
    if axis and axis not in field.axes:
        axes = f"has the components {', '.join(field.axes)}" if field.axes else "has no components"
        raise InputError(f"{key}: {name} {axes}; expected {_example(field)}")
    if not axis and field.axes == STRESS:
        raise InputError(f"{key}: a stress is six numbers; expected {_example(field)}")
    return PathColumn(field, field.axes.index(axis) if axis else None)


def _example(field: PathField) -> str:
    """Example of a column of the field, for messages."""
    return f"e.g. {field.name}.{field.axes[-1]}" if field.axes else field.name
