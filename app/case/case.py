"""The configuration of a case: schema, reading, writing.

This is the one front for the rest of the program::

    case = load_case(Path("case.yaml"), ["mesh.size=2 mm"])

Everything downstream takes parts of the `Case`; dimensional values are floats in mm, N, MPa, s, K,
rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from app.case import checks, overlay, points
from app.case.case_parts import CaseParts
from app.case.geometries import (
    Geometry,
    MeshOptions,
)
from app.case.run_options import OutputOptions, SolverOptions, Stage
from app.case.variations import Variations, expand, title_with_changes
from app.errors import InputError
from app.laws.interface_laws import Bonded, Interface
from app.laws.loads import (
    Load,
    Support,
)
from app.laws.materials import (
    Region,
)
from app.laws.thermal import (
    HeatCondition,
    TimeOptions,
)
from app.schema import yaml_file
from app.schema.json_schema import json_schema, over_a_base
from app.schema.section import (
    ITEMS,
    MAPPING,
    RENEWALS,
    Name,
    Section,
    Text,
    Word,
)
from app.schema.validation import problems
from app.schema.yaml_file import CaseFile, Fault


class Case(Section):
    """Everything that a run needs to know."""

    title: Text = ""
    """A line for people."""
    geometry: Geometry
    """Bodies, interfaces and boundaries."""
    side: Annotated[Literal["left", "right"], Word()] = "left"
    """Side of the hip, z being proximal and y anterior: x is medial of a left one and lateral of a
    right one. It decides the signs of retroversion and varus, and nothing else. Parametric femurs
    are left, and nothing else: their numbers are those of the mirrored right one."""
    mesh: MeshOptions
    """Mesh size and order."""
    regions: Annotated[dict[Name, Region], MAPPING]
    """Material of every region of the geometry."""
    interfaces: Annotated[dict[Name, Interface], MAPPING] = Field(default_factory=dict)
    """Law of each interface; those not listed are bonded."""
    supports: Annotated[dict[Name, Support], MAPPING] = Field(default_factory=dict)
    """Supports of the bodies."""
    loads: Annotated[dict[Name, Load], MAPPING] = Field(default_factory=dict)
    """Loads on the bodies. `library: NAME` among them stands for all loads of that name in the
    library, in place of those of the base; further keys change them."""
    heat: Annotated[dict[Name, HeatCondition], MAPPING] = Field(default_factory=dict)
    """Sources, fluxes and given temperatures."""
    stages: Annotated[tuple[Stage, ...], ITEMS] = (Stage(name="load"),)
    """The loading history."""
    time: TimeOptions | None = None
    """How stages that take time are divided into steps; only where there is heat."""
    solver: SolverOptions = SolverOptions()
    """How the equations are solved."""
    output: OutputOptions = OutputOptions()
    """Results that are written."""
    variations: Variations = Field(default_factory=dict)
    """Runs of the case on one mesh with one stiffness, by name: overrides as after ``--set``. With
    it, only these are run."""
    base: Text | None = None
    """Case that this one is laid over: a file, relative to this one, or the name of a shipped case,
    such as `stance`. Mappings merge key by key, of another kind they replace; lists and values
    replace; `null` removes an entry."""
    library: Text | None = None
    """File of more materials and loads by name, relative to this one, such as `mine.yaml`;
    `mantle library` prints those that are known without it."""

    @property
    def conducts(self) -> bool:
        """Whether there is heat in it at all."""
        return any(region.thermal is not None for region in self.regions.values())

    def of_tissue(self, tissue: str) -> tuple[str, ...]:
        """Names of the regions of a tissue."""
        return tuple(name for name, region in self.regions.items() if region.tissue == tissue)


def load_case(path: Path, overrides: Sequence[str] = ()) -> Case:
    """Read, check and resolve a case.

    Args:
        path: The YAML file.
        overrides: ``a.b.c=value`` each, applied in order before anything is checked.

    Returns:
        The case, with every interface of the geometry listed and the tissue of every region.

    Raises:
        InputError: Anything wrong with the file; every defect at once, one line each.
    """
    path = Path(path)
    return resolve(overlay.read(path, overrides), path.parent)


def resolve(file: CaseFile, folder: Path) -> Case:
    """Check the content of a case file.

    Args:
        file: The content.
        folder: What relative paths in it are relative to.

    Raises:
        InputError: As `load`.
    """
    case = _resolved(file, folder)
    _varied(file, folder, case)
    return case


@dataclass(frozen=True)
class Varied:
    """A variation of a case.

    Attributes:
        name: Its name, and that of its folder.
        overrides: What makes it out of the case, as after ``--set``.
        changes: The same, as values.
        case: The whole of it.
    """

    name: str
    overrides: tuple[str, ...]
    changes: dict[str, Any]
    case: Case


def variations_of(path: Path, overrides: Sequence[str] = ()) -> list[Varied]:
    """The variations of a case, in the order of the file.

    Raises:
        InputError: As `load`.
    """
    path = Path(path)
    file = overlay.read(path, overrides)
    return _varied(file, path.parent, _resolved(file, path.parent))


def _varied(file: CaseFile, folder: Path, case: Case) -> list[Varied]:
    """The variations of a case.

    Raises:
        InputError: All that is wrong with any of them, each at its place in the section.
    """
    found: list[Varied] = []
    # The places of what options have set are their keys.
    options = [place for place in file.places.values() if isinstance(place, str)]
    faults: list[Fault] = []
    for name, changes in case.variations.items():
        keys = {full: key for key in changes for full in expand(key, file.data)}
        places: dict[str, yaml_file.Path] = {
            full: ("variations", name, key) for full, key in keys.items()
        }
        faults += yaml_file.clashes(options, ((place, full) for full, place in places.items()))
        overrides = tuple(points.as_overrides({full: changes[key] for full, key in keys.items()}))
        copy = yaml_file.changed(file, overrides)
        del copy.data["variations"]
        try:
            found.append(Varied(name, overrides, changes, _resolved(copy, folder)))
        except InputError as error:
            faults += [
                yaml_file.located(message, places) or Fault(("variations",), f"{name}: {message}")
                for message in error.messages
            ]
    file.raise_all(faults)
    return found


def _resolved(file: CaseFile, folder: Path) -> Case:
    """A case by itself, without its variations."""
    context: dict[str, Any] = {"folder": folder}
    parts = _parts(file.data, context)
    try:
        case = Case.model_validate(file.data, context=context)
    except ValidationError as error:
        file.raise_all([*problems(error, Case), *checks.cross_check(parts)])
        raise  # only if an error could not be told in words
    file.raise_all(checks.cross_check(parts))
    bonded = {name: Bonded() for name in case.geometry.interface_sides}
    interfaces = {name: case.interfaces.get(name, law) for name, law in bonded.items()}
    tissues = case.geometry.tissues
    regions = {
        name: region if region.tissue else region.model_copy(update={"tissue": tissues[name]})
        for name, region in case.regions.items()
    }
    mesh = case.mesh
    if mesh.curved is None:
        curved = mesh.order == 2 and case.geometry.has_curved_surfaces
        mesh = mesh.model_copy(update={"curved": curved})
    time = (case.time or TimeOptions()) if case.conducts else None
    return case.model_copy(
        update={
            "title": title_with_changes(case.title, file),
            "regions": regions,
            "interfaces": interfaces,
            "mesh": mesh,
            "time": time,
        }
    )


def geometry_of(data: dict[str, Any], folder: Path) -> Geometry | None:
    """The geometry in the content of a case file, whatever is wrong with the rest."""
    found: Geometry | None = _parts(data, {"folder": folder}).geometry
    return found


def plain(case: Case) -> dict[str, Any]:
    """A case alone, without variations, as mappings, lists and scalars."""
    return case.model_dump(mode="json", exclude_none=True, exclude={"variations"})


def dump_case(case: Case) -> str:
    """A case alone, as YAML in internal units; without variations reads back equal."""
    return yaml_file.written(plain(case))


def case_schema() -> dict[str, Any]:
    """JSON schema of a case file, for editors."""
    return over_a_base(json_schema(Case), "Case")


# Making an adapter takes far longer than using it.
_adapter = lru_cache(TypeAdapter)


def _renew() -> None:
    """Build the schema anew: there is another kind of something."""
    _adapter.cache_clear()
    Case.model_rebuild(force=True)


RENEWALS.append(_renew)


def _parts(data: dict[str, Any], context: dict[str, Any]) -> CaseParts:
    """Every part that is valid by itself, so that the rest can still be checked against it.

    The points that the geometry names are put into the context on the way: None if it is wrong.
    """

    def part(kind: Any, value: object) -> Any:
        try:
            return _adapter(kind).validate_python(value, context=context)
        except ValidationError:
            return None

    def table(key: str, kind: Any) -> dict[str, Any]:
        values = data.get(key, {})
        is_table = isinstance(values, dict)
        return {name: part(kind, value) for name, value in values.items()} if is_table else {}

    geometry = part(Geometry, data["geometry"]) if "geometry" in data else None
    context["points"] = None if geometry is None else geometry.points
    default: tuple[Stage, ...] = Case.model_fields["stages"].default
    return CaseParts(
        geometry=geometry,
        side=data.get("side"),
        mesh=part(MeshOptions, data["mesh"]) if "mesh" in data else None,
        regions=table("regions", Region) if isinstance(data.get("regions"), dict) else None,
        interfaces=table("interfaces", Interface),
        supports=table("supports", Support) if isinstance(data.get("supports", {}), dict) else None,
        loads=table("loads", Load),
        heat=table("heat", HeatCondition),
        time="time" in data,
        output=part(OutputOptions, data.get("output", {})),
        stages=part(Case.model_fields["stages"].annotation, data["stages"])
        if "stages" in data
        else default,
    )
