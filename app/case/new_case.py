"""New cases, short and complete, for ``mantle init``."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import configs
from app.case import mesh_names
from app.case.geometries import MeshFile, MeshOptions
from app.foundation.errors import InputError, MantleError
from app.system.folders import writing

# Pairs of regions of a mesh that meet, and its interior surfaces.
Meeting = Callable[[Any, Any], tuple[list[tuple[str, str]], list[str]]]
# Writer of a case by a segmentation: file, labels, CT, side, label, and True for a stem without
# cement. It returns the file and lines on what is assumed.
FromLabels = Callable[
    [Path, Path, Path | None, str | None, str | None, bool], tuple[Path, list[str]]
]
_FROM_LABELS: list[FromLabels] = []
FOLDER = configs.FOLDER / "start"
STEMS = {"titanium": "Ti-6Al-4V", "cocr": "CoCrMo", "steel": "316L"}
SCHEMA = f"# yaml-language-server: $schema={configs.FOLDER / 'schema.json'}\n"
LAW = "{kind: bonded} # or, where they may part: {kind: contact, friction_coefficient: 0.3}"
MISSING = """\
  # It is not there yet. Name its physical volumes under `regions`, two physical surfaces as
  # `boundary` below; once it is there `mantle check` lists those it has.
"""


def write(
    path: Path,
    kind: str,
    stem: str = "",
    meeting: Meeting | None = None,
    cementless: bool = False,
) -> Path:
    """Write a new case that runs as it is, and return its file.

    Args:
        path: The new file.
        kind: Kind of its geometry.
        stem: Material of its stem, one of `STEMS`; by default titanium.
        meeting: Function that returns the pairs of regions of a mesh that meet
            (`meshes.meeting`); by default none meet.
        cementless: True for a stem without cement.

    Raises:
        InputError: The file exists, its folder does not, or the kind has no stem.
        StoppedError: The file cannot be written.
    """
    if stem and kind not in ("femur", "cylinders"):
        raise InputError(f"--stem {stem}: geometries of kind {kind} have no stem; leave --stem out")
    if cementless and kind != "femur":
        raise InputError(
            f"--cementless: only femora have such a stem, not kind {kind}; leave one of them out"
        )
    path = new_file(path)
    if kind == "file":
        case_text = _of_mesh_file(path.with_suffix(".msh"), meeting)
    else:
        name = "femur_cementless" if cementless else kind
        case_text = (FOLDER / f"{name}.yaml").read_text(encoding="utf-8")
        case_text = case_text.replace(STEMS["titanium"], STEMS[stem or "titanium"])
    save_case_text(path, case_text)
    return path


def new_file(path: Path) -> Path:
    """Return the file of a new case by its name, with or without its suffix.

    Raises:
        InputError: The file exists, or its folder does not.
    """
    file = path if path.suffix in (".yaml", ".yml") else path.with_name(f"{path.name}.yaml")
    if file.exists():
        raise InputError(f"{file}: exists already and was not changed; choose another name")
    if not file.parent.is_dir():
        raise InputError(f"{file}: folder {file.parent} does not exist; make it first")
    return file


def save_case_text(path: Path, text: str) -> None:
    """Write a new file of a case.

    Raises:
        StoppedError: It cannot be written.
    """
    with writing(path), path.open("x", encoding="utf-8") as file:
        file.write(SCHEMA + text)


def add_from_labels(proposal: FromLabels) -> None:
    """Register the function that writes a new case from a segmentation."""
    _FROM_LABELS.append(proposal)


def labels_writer() -> FromLabels:
    """Return the function that writes a new case of the femur in a segmentation.

    Raises:
        InputError: No package of this installation reads segmentations.
    """
    if not _FROM_LABELS:
        raise InputError("--labels: this installation has no package that reads segmentations")
    return _FROM_LABELS[-1]


def _of_mesh_file(mesh: Path, meeting: Meeting | None) -> str:
    """Case on a mesh file beside it, with its regions and boundaries if it exists."""
    regions: tuple[str, ...] = ("NAME_OF_A_REGION",)
    boundaries: tuple[str, ...] = ("NAME_OF_A_SURFACE", "NAME_OF_ANOTHER")
    description, pairs = MISSING, list[tuple[str, str]]()
    if mesh.is_file():
        try:
            regions, surfaces = (mesh_names.physical_names(mesh, d) for d in (3, 2))
        except (OSError, ValueError) as error:
            raise InputError(f"{mesh}: {error}") from error
        if not regions:
            raise InputError(f"{mesh}: has no named region; name its physical volumes in gmsh")
        boundary_note = f"its boundaries: {', '.join(surfaces) or 'none, which a case needs'}"
        description = (
            textwrap.indent(textwrap.fill(boundary_note, 90, break_on_hyphens=False), "  # ") + "\n"
        )
        inside: list[str] = []
        # `check --mesh` reports a mesh that cannot be read here.
        with suppress(MantleError, ModuleNotFoundError, ValueError):
            if meeting:
                file = MeshFile(kind="file", path=mesh)
                pairs, inside = meeting(file, MeshOptions.model_validate({"size": "3 mm"}))
        boundaries = tuple(s for s in surfaces if s not in inside) or boundaries
    lines = (f"  {_word(r)}: {{material: cortical_bone}}\n" for r in regions)
    return (
        (FOLDER / "file.template")
        .read_text(encoding="utf-8")
        .format(
            title=_word(mesh.stem),
            path=_word(mesh.name),
            about=description,
            regions="".join(lines),
            sides=_section("  interfaces:", (f"    {a}_{b}: [{a}, {b}]" for a, b in pairs)),
            laws=_section("interfaces:", (f"  {a}_{b}: {LAW}" for a, b in pairs)),
            first=_word(boundaries[0]),
            last=_word(boundaries[-1]),
        )
    )


def _section(head: str, lines: Iterable[str]) -> str:
    entry_lines = list(lines)
    return "\n".join([head, *entry_lines, ""]) if entry_lines else ""


def _word(text: str) -> str:
    """Text as a YAML scalar, quoted if necessary."""
    return text if re.fullmatch(r"[A-Za-z_/.][\w/. -]*", text) else json.dumps(text)
