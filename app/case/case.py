"""The configuration of a case: schema, reading, writing.

The rest of the program reads cases by ::

    case = load(Path("case.yaml"), ["mesh.size=2 mm"]).config

and takes parts of the `Case`; dimensional values are floats in mm, N, MPa, s, K, rad.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal, TypedDict, cast

from pydantic import (
    Field,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
)
from pydantic.config import JsonDict

from app.case import checks, overlay, points
from app.case.credibility import Credibility
from app.case.geometries import Geometry, MeshFile, MeshOptions
from app.case.merge_rules import MEASURED, at_common_table
from app.case.misplaced_keys import with_section
from app.case.points import Point
from app.case.run_options import OutputOptions, SolverOptions, Stage, TimeOptions
from app.case.shapes import Point3
from app.case.variations import Variations, expand, title_with_changes
from app.foundation.errors import InputError
from app.laws import contact_laws, traction_laws  # noqa: F401  (registers kinds of interfaces)
from app.laws.heat_conditions import HeatCondition
from app.laws.interface_laws import Bonded, Interface
from app.laws.loads import AnyLoad
from app.laws.materials import Region
from app.laws.motions import Motion
from app.laws.supports import AnySupport
from app.schema import section, yaml_file
from app.schema.section import ITEMS, MAPPING, Name, Section, Text
from app.schema.yaml_file import CaseFile, Fault, YamlMapping

# Sections whose entries are valid one by one.
TABLES = ("regions", "interfaces", "supports", "motions", "loads", "heat")

# Keys beside the names of loads, as the JSON schema has them.
LIBRARY_KEYS: JsonDict = {
    "library": {"type": ["string", "object"]},
    **{key: {"type": "string"} for key in MEASURED},
    "history": {"type": "array"},
    "cycle_table": {"type": ["object", "array", "string"]},
}


class Notes(TypedDict):
    """Context of the validation of a case."""

    # Folder of the case file, of which paths are relative.
    folder: Path
    # Named points of the geometry; None before it is read.
    points: dict[str, Point3] | None
    # Valid parts by name; None for the others.
    parts: YamlMapping
    faults: list[Fault]


class Case(Section):
    """Everything that a run needs to know."""

    mantle: Literal[1] = 1
    """Version of the format of case files; a file without this key has version 1. Later versions of
    mantle read the file with the meaning of its version. A format newer than the program is
    refused."""
    title: Text = ""
    """Title for logs and reports."""
    credibility: Credibility = Credibility()
    """Question, context of use and risk, for `mantle report --evidence`."""
    geometry: Geometry
    """Bodies, interfaces and boundaries."""
    side: Literal["left", "right"] = "left"
    """Side of the hip. With z proximal and y anterior, x is medial in a left hip and lateral in a
    right one. The key only sets the signs of retroversion and varus. Parametric femurs must be
    left; a mirrored right hip has the same numbers."""
    mesh: MeshOptions = Field(default_factory=MeshOptions)
    """Mesh size and order."""
    regions: Annotated[dict[Name, Region], MAPPING]
    """Material of every region of the geometry."""
    interfaces: Annotated[dict[Name, Interface], MAPPING] = Field(default_factory=dict)
    """Law of each interface; those not listed are bonded."""
    supports: Annotated[dict[Name, AnySupport], MAPPING] = Field(default_factory=dict)
    """Supports of the bodies."""
    motions: Annotated[dict[Name, Motion], MAPPING] = Field(default_factory=dict)
    """Regions with large rotations, prescribed by a cycle table for each cycle of the last
    stage."""
    loads: Annotated[dict[Name, AnyLoad], MAPPING] = Field(
        default_factory=dict,
        json_schema_extra={"properties": LIBRARY_KEYS},
    )
    """Loads on the bodies. `library: NAME` takes all loads of a set in the library, in place of
    those of the base; further keys change them. `library: {walking: [1, 0, 0], stairs_up: [0, 0,
    1]}` takes several sets, each with its history, here with a stage of rest between them. Their
    loads are called `walking_hip` and so on.
    `body_weight: 750 N` scales the forces. `history: [0, 1]` or `cycle_table: walking_cycle`
    applies to all of them. `sagittal_tilt: 8.4 deg` rotates them about x, from the frame of the
    measurement to that of the shaft. The angle is the backward tilt of the proximal shaft in the
    frame of the measurement."""
    heat: Annotated[dict[Name, HeatCondition], MAPPING] = Field(default_factory=dict)
    """Sources, fluxes and given temperatures."""
    stages: Annotated[tuple[Stage, ...], ITEMS] = (Stage(name="load"),)
    """The loading history."""
    time: TimeOptions | None = None
    """Division of stages that take time into steps; only if there is heat."""
    solver: SolverOptions = SolverOptions()
    """Options of the solver."""
    output: OutputOptions = OutputOptions()
    """Results that are written."""
    variations: Variations = Field(default_factory=dict)
    """Runs of the case that share mesh and stiffness, by name: overrides as after ``--set``. If
    given, only these runs are made."""
    base: Text | None = None
    """Case that this one changes: a file, relative to this one, or the name of a shipped case, such
    as `stance`. Mappings are merged key by key; a mapping of another kind, a list or a value
    replaces that of the base; `null` removes an entry."""
    library: Text | None = None
    """File of more materials, loads and contexts of use by name, relative to this one, such as
    `mine.yaml`; `mantle explain materials`, `loads` and `contexts` list those that are known
    without it."""

    @field_validator("*", mode="wrap")
    @classmethod
    def _noted(
        cls, value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo
    ) -> object:
        """Store the part or its errors in the context; continue without an invalid part."""
        name = str(info.field_name)
        notes = cast(Notes, info.context)
        part = None
        try:
            part = handler(value)
        except ValidationError as error:
            faults = [replace(f, path=(name, *f.path)) for f in section.faults(error)]
            notes["faults"] += faults
            if name in TABLES and isinstance(value, dict):
                wrong_names = {fault.path[1] for fault in faults}
                part = handler({k: v for k, v in value.items() if k not in wrong_names})
                part |= dict.fromkeys(wrong_names)
            elif name in ("interfaces", "motions", "loads", "heat"):
                part = {}
        notes["parts"][name] = part
        if name == "geometry" and part is not None:
            notes["points"] = part.points
        return part

    @property
    def conducts(self) -> bool:
        """Return True if heat is solved."""
        return any(region.thermal is not None for region in self.regions.values())

    @property
    def sliding_boundaries(self) -> dict[str, tuple[str, str]]:
        """Boundaries of the two sides of each interface with finite sliding, by name."""
        finitely_sliding = {
            name: law for name, law in self.interfaces.items() if law.finite_sliding
        }
        return {
            n: law.sliding_boundaries or self.geometry.sliding_boundaries[n]
            for n, law in finitely_sliding.items()
        }

    def of_tissue(self, tissue: str) -> tuple[str, ...]:
        """Names of the regions of a tissue."""
        return tuple(name for name, region in self.regions.items() if region.tissue == tissue)


@dataclass(frozen=True)
class PlannedRun:
    """A run to be made: a single one, or one of the runs of variations, sweeps, studies or suites.

    Attributes:
        file: The file of its case.
        overrides: ``key=value`` each, as after ``--set``.
        case: The case with the overrides.
        point: Name, which need not be unique, and the changes compared with other runs.
        ranks: Number of MPI ranks.
        needs_idle_machine: True if no other run may be active at the same time, because run times
            are compared.
        share: True if it may share a process with runs of the same mesh and stiffness.
    """

    file: Path
    overrides: tuple[str, ...]
    case: Case = field(compare=False, repr=False)
    point: Point
    ranks: int = 1
    needs_idle_machine: bool = False
    share: bool = False

    @property
    def name(self) -> str:
        """Name of its point; of a variation also its folder."""
        return self.point.name

    @classmethod
    def load(
        cls,
        name: str,
        file: Path,
        overrides: Sequence[str] = (),
        ranks: int = 1,
        needs_idle_machine: bool = False,
        share: bool = False,
    ) -> PlannedRun:
        """Plan a run of a file with overrides.

        Raises:
            InputError: As `load_case`.
        """
        case = load_case(file, overrides).config
        return cls(file, tuple(overrides), case, Point(name), ranks, needs_idle_machine, share)


@dataclass(frozen=True, repr=False)
class LoadedCase:
    """A case and its origin.

    Attributes:
        config: The checked case: ``case.config.mesh.size``, ``case.config.regions["stem"]``. Its
            values are floats in mm, N, MPa, s, K, rad; every interface of the geometry is listed,
            and the tissue of every region.
        overrides: Changes of the file, ``key=value`` each.
        file: Content and the place of each key, for messages.
        variations: In the order of the file.
    """

    config: Case
    path: Path
    overrides: tuple[str, ...]
    file: CaseFile
    variations: list[PlannedRun]

    def __repr__(self) -> str:
        """Title, file, geometry, mesh, interfaces and stages in five lines."""
        c = self.config
        size = f"{c.mesh.size:g} mm" if c.mesh.size else "of the file"
        laws = ", ".join(f"{name} {law.kind}" for name, law in c.interfaces.items())
        return (
            f"case {self.path}: {c.title or 'without title'}\n"
            f"  geometry {c.geometry.kind}: {', '.join(c.geometry.region_names)}\n"
            f"  mesh {size}, order {c.mesh.order}\n  interfaces {laws or 'none'}\n"
            f"  stages {', '.join(stage.name for stage in c.stages)}; all values in .config"
        )

    @property
    def output(self) -> Path:
        """Default folder of the results: ``out/<name of the file>``."""
        return Path("out") / self.path.stem

    @property
    def itself(self) -> PlannedRun:
        """The run of the case without its variations."""
        return PlannedRun(self.path, self.overrides, self.config, Point(self.path.stem))

    def runs(self, output: Path) -> dict[Path, PlannedRun]:
        """Run directories in a folder with their runs: of the variations, else of the case."""
        return {output / v.name: v for v in self.variations} or {output: self.itself}


def load_case(path: Path, overrides: Sequence[str] = (), option: str = "--set ") -> LoadedCase:
    """Read, check and resolve a case.

    Args:
        path: The YAML file.
        overrides: ``a.b.c=value`` each, applied in order before anything is checked.
        option: Text before the keys of overrides in messages.

    Raises:
        InputError: Every error of the file at once, one line each.
    """
    file = overlay.read(path, overrides, option)
    case = resolve(file, path.parent)
    loaded = LoadedCase(case, path, tuple(overrides), file, [])
    return replace(loaded, variations=_variations(loaded))


def _variations(loaded: LoadedCase) -> list[PlannedRun]:
    """The runs of the variations of a case.

    Raises:
        InputError: Every error of any of them, at its place in the section.
    """
    file = loaded.file
    runs: list[PlannedRun] = []
    # The place of a value set by an option is the key of the option.
    options = [place for place in file.places.values() if isinstance(place, str)]
    faults: list[Fault] = []
    for name, changed_values in loaded.config.variations.items():
        keys = {full_key: key for key in changed_values for full_key in expand(key, file.data)}
        path_of_key: dict[str, yaml_file.Path] = {
            full_key: ("variations", name, key) for full_key, key in keys.items()
        }
        faults += points.clashes(
            options, ((place, full_key) for full_key, place in path_of_key.items())
        )
        overrides = tuple(
            points.as_overrides({full_key: changed_values[key] for full_key, key in keys.items()})
        )
        changed_file = overlay.changed(file, overrides)
        del changed_file.data["variations"]
        try:
            case = resolve(changed_file, loaded.path.parent)
        except InputError as error:
            faults += [
                points.at_override(message, path_of_key)
                or Fault(("variations",), f"{name}: {message}")
                for message in error.messages
            ]
            continue
        point = Point(
            name, changed_values, path_of_key, ("variations", name), varied=tuple(changed_values)
        )
        runs.append(PlannedRun(loaded.path, (*loaded.overrides, *overrides), case, point))
    file.raise_all(faults)
    return runs


def resolve(file: CaseFile, folder: Path) -> Case:
    """Check a case without its variations, and fill in defaults; paths are relative to a folder.

    Raises:
        InputError: As `load_case`.
    """
    case, faults = valid_parts(file.data, folder)
    faults = [with_section(at_common_table(fault, file.common), Case) for fault in faults]
    if file.incomplete:
        file.raise_all([fault for fault in faults if fault.path[:1] not in file.incomplete])
    case = _with_tissues(case, file.tissues)
    file.raise_all([*faults, *checks.cross_check(case)])
    if isinstance(case.geometry, MeshFile):
        case = case.model_copy(update={"geometry": case.geometry.parted(case.sliding_boundaries)})
    laws = {name: case.interfaces.get(name, Bonded()) for name in case.geometry.interface_sides}
    mesh = case.mesh
    if mesh.curved is None:
        curved = mesh.order == 2 and case.geometry.has_curved_surfaces
        mesh = mesh.model_copy(update={"curved": curved})
    with file.placing():
        case.geometry.check_fit(mesh)
    time = (case.time or TimeOptions()) if case.conducts else None
    title = title_with_changes(case.title, file)
    resolved_parts = {"title": title, "interfaces": laws, "mesh": mesh, "time": time}
    return case.model_copy(update=resolved_parts)


def _with_tissues(case: Case, of_materials: Mapping[str, str]) -> Case:
    """Give regions without a tissue that of the geometry, else of the material."""
    if case.geometry is None or case.regions is None:
        return case
    tissue_of_region = {**of_materials, **case.geometry.tissues}
    regions = {
        name: region.model_copy(update={"tissue": tissue_of_region[name]})
        if region and region.tissue is None and name in tissue_of_region
        else region
        for name, region in case.regions.items()
    }
    return case.model_copy(update={"regions": regions})


def valid_parts(data: Mapping[str, object], folder: Path) -> tuple[Case, list[Fault]]:
    """A case whose missing or invalid parts are None, and their faults."""
    faults: list[Fault] = []
    parts: YamlMapping = dict.fromkeys(("geometry", "regions"))
    notes: Notes = {"folder": folder, "points": None, "parts": parts, "faults": faults}
    try:
        Case.model_validate(data, context=cast(YamlMapping, notes))
    except ValidationError as error:
        faults += section.faults(error)
    return Case.model_construct(**parts), faults


def read_geometry(data: Mapping[str, object], folder: Path) -> Geometry | None:
    """Geometry of a case file, even if other parts are invalid."""
    return valid_parts(data, folder)[0].geometry


def plain_data(case: Case) -> YamlMapping:
    """A case without its variations as mappings, lists and scalars."""
    return case.model_dump(mode="json", exclude_none=True, exclude={"variations"})


def dump(case: Case) -> str:
    """A case without its variations as YAML in internal units; it reads back equal."""
    return yaml_file.to_yaml(plain_data(case))


def named_files(case: Case) -> list[Path]:
    """Existing files that keys outside of the geometry name, sorted by path."""

    def paths(value: object) -> Iterator[Path]:
        if isinstance(value, Path):
            yield value
        elif isinstance(value, Mapping):
            for member in value.values():
                yield from paths(member)
        elif isinstance(value, list | tuple):
            for member in value:
                yield from paths(member)

    data = case.model_dump(exclude={"geometry", "variations"})
    return sorted({path for path in paths(data) if path.is_file()})


def _renew() -> None:
    """Build the schema anew if it was built."""
    if Case.__pydantic_complete__:
        Case.model_rebuild(force=True)


section.ON_NEW_KIND.append(_renew)
