"""Load, check, mesh, run and read a case: the functions of `mantle`, and of its command line.

Modules that need MPI or PETSc are imported inside `stack_needed` alone. A process that starts ranks
(``mantle run -n``) must not start MPI, and ``mantle check`` starts fast.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import meshes
from app import extensions as extensions  # registers them
from app.case import points
from app.case.case import LoadedCase, load_case
from app.foundation.errors import (
    ConvergenceError,
    InputError,
    MantleError,
    StoppedError,
    UnusableError,
    stack_needed,
)
from app.simulation import finished_runs
from app.soundness import cost, memory, preview
from app.soundness.preview import CheckedCase
from app.system import folders, ranks
from meshes import MeshData

if TYPE_CHECKING:
    from mpi4py import MPI

    from app.results.reading import Results
    from app.simulation.recorder import AcceptedStep
    from meshes.distribute import TaggedMesh

# Arguments of `run`, by the options of the command line with the same meaning.
ARGUMENTS = {
    "-o": "output",
    "--force": "force=True",
    "--restart auto": 'restart="auto"',
    "--restart FILE": "restart=FILE",
    "--restart": "restart",
}
# An option in a message. The one of the output begins it.
OPTION = re.compile(r"^-o(?= )|--force\b|--restart(?: auto| FILE)?(?![\w-])")


def load(path: str | os.PathLike[str], **overrides: object) -> LoadedCase:
    """Read a case file and check all that can be checked without a mesh.

    Args:
        path: The YAML file.
        overrides: Values that replace those of the file, by their keys as after ``--set``:
            ``**{"mesh.size": "5 mm"}``. In a key without dots two underscores are a dot, so that
            ``mesh__size="5 mm"`` is the same. Values are as in the file: text with a unit,
            numbers, lists, mappings.

    Returns:
        The case; ``case.config`` has its checked parts.

    Raises:
        InputError: The file cannot be read or is wrong; lists every defect, one line each.
    """
    keys = {key: key if "." in key else key.replace("__", ".") for key in overrides}
    changes = points.as_overrides({keys[key]: value for key, value in overrides.items()})
    return load_case(Path(path), changes, option="")


def check(case: LoadedCase, *, meshed: bool = False) -> CheckedCase:
    """Describe a case as understood, its size, and doubtful values in it.

    With ``meshed``, or with probes or paths, the mesh is made: sizes are counted instead of
    estimated, and loose parts, unsolvable problems, and probes and paths outside are reported.

    Returns:
        Texts on the case: its ``description``, its ``size`` and its ``notes``; print it.

    Raises:
        InputError: The case cannot be solved, or does not fit this machine.
        GeometryError: It cannot be meshed.
        EnvironmentProblem: A package for meshing is missing.
    """
    _refuse_path(case)
    memory.check(case.file, case.config)
    size = cost.estimated_size(case.config, memory.available_memory())
    notes = [*case.file.notes, *preview.input_notes(case.config)]
    output = case.config.output
    if meshed or output.probes or output.paths:
        data = mesh(case)
        with stack_needed():
            from app.soundness import well_posedness
        with case.file.placing():
            notes += well_posedness.check_on_mesh(
                case.config, well_posedness.mesh_parts(case.config, data)
            )
        size = cost.exact_size(case.config, data, memory.available_memory())
        room = case.config.geometry.room_details()
        size += f"\n  room around the stem: {room}" if room else ""
    description = preview.case_in_words(case.config, case.file.data)
    return CheckedCase(description, size, tuple(n for n in notes if n.text not in description))


def mesh(case: LoadedCase) -> MeshData:
    """Make the mesh of a case, or take it from the cache.

    Returns:
        Plain arrays: ``points`` (n, 3) [mm], ``cells`` (m, 4) or (m, 10) in gmsh's order,
        ``cell_tags`` (m,), names of regions, boundaries and interfaces, and notes of the mesher.

    Raises:
        InputError: The mesh does not fit this machine.
        GeometryError: The geometry cannot be built, or its mesh is not good enough.
        EnvironmentProblem: A package for meshing is missing.
    """
    _refuse_path(case)
    memory.check(case.file, case.config)
    with stack_needed(petsc=False):
        import gmsh  # noqa: F401  (only to report early that it is missing)
    with case.file.placing():
        return meshes.build(case.config.geometry, case.config.mesh, folders.cache("meshes"))


def run(
    case: LoadedCase | Mapping[str, object],
    output: str | os.PathLike[str] | None = None,
    *,
    mesh: TaggedMesh | None = None,
    progress: Callable[[AcceptedStep], None] = lambda step: None,
    force: bool = False,
    restart: str = "",
    walltime: float | None = None,
    signals: bool = False,
    petsc_options: Sequence[str] = (),
) -> Results:
    """Solve a case in this process and write its results; under mpirun, all ranks call it together.

    Args:
        case: As `load` returns it. With a mesh: sections of a case file as mappings and lists.
        output: The folder for the results; ``out/<name of the case file>`` by default. With a mesh
            it is needed: ``<output>.msh`` and ``<output>.yaml`` are written next to it.
        mesh: A dolfinx mesh with names, of `TaggedMesh.from_tags` or `from_markers`.
        progress: Called on every rank after each accepted step: number, time, row of history.csv.
        force: Replace results in the folder, and accept a checkpoint of another configuration.
            Without it, finished results of the same configuration are kept.
        restart: Continue from a checkpoint: ``auto`` for the newest in the folder, or a file.
        walltime: Wall time before whose end the state is saved and the run stops [s].
        signals: On a signal, save the state and stop.
        petsc_options: Raw options, as after ``--`` on the command line.

    Returns:
        Results, as `read` returns them.

    Raises:
        InputError: The case has an error, or the folder is not empty.
        GeometryError: The case cannot be meshed.
        ConvergenceError: The run did not converge; the last converged state is in the folder.
        UnusableError: The run ended, but a check failed: do not use its numbers. They are in the
            folder.
        StoppedError: By a signal, ``walltime`` or a full disk; the state is saved in the folder.
        EnvironmentProblem: A package, a compiler or MPI is missing or unusable.
    """
    _refuse_path(case)
    if isinstance(case, Mapping):
        if mesh is None or output is None:
            raise InputError(
                "a case given as a dict needs an output and a mesh: run(..., mesh=...)"
            )
        with stack_needed():
            from app.simulation.given_mesh import case_on
        case = case_on(mesh, case, Path(output))
    elif mesh is not None:
        raise InputError("a loaded case already has a mesh; give the case as a dict")
    folder = Path(output) if output is not None else case.output
    with _in_words_of_python():
        if not finished_runs.prepare(case, folder, force=force, restart=restart):
            solve_in_prepared_folder(
                case,
                folder,
                progress=progress,
                force=force,
                restart=restart,
                walltime=walltime,
                signals=signals,
                petsc_options=petsc_options,
            )
    return read(folder)


def solve_in_prepared_folder(
    case: LoadedCase,
    folder: Path,
    *,
    progress: Callable[[AcceptedStep], None] = lambda step: None,
    force: bool = False,
    restart: str = "",
    walltime: float | None = None,
    signals: bool = False,
    petsc_options: Sequence[str] = (),
) -> None:
    """Solve a case and write its results, as `run`; errors name options of the command line.

    The folder is that of `finished_runs.prepare`, which found no finished results in it.
    """
    with ranks.mpi_settings():
        with stack_needed():
            from app.simulation import session
        try:
            comm = session.run(
                case,
                folder,
                petsc_options,
                restart=restart,
                force=force,
                walltime=walltime,
                signals=signals,
                progress=progress,
            )
        except (ConvergenceError, StoppedError, UnusableError):
            _report(case, folder, None)
            raise
        _report(case, folder, comm)


def read(folder: str | os.PathLike[str]) -> Results:
    """Read the results of a run from its folder.

    Returns:
        Its numbers (``summary``), its columns of history.csv as arrays (``step_record``), its
        ``fields`` on points and cells, and the results of its ``variations`` by name.

    Raises:
        InputError: No run has written into the folder.
        EnvironmentProblem: A package for reading is missing.
    """
    path = Path(folder)
    if not any((path / name).exists() for name in ("case.yaml", "variations.json")):
        raise InputError(
            f"{path}: has no results of a run; expected a folder written by mantle run"
        )
    with stack_needed():
        from app.results.reading import Results
    return Results(path)


@contextmanager
def _in_words_of_python() -> Iterator[None]:
    """Name arguments of `run` in errors that name options of the command line."""
    try:
        yield
    except MantleError as error:
        error.verdicts = [
            replace(
                v, where=_arguments(v.where), what=_arguments(v.what), remedy=_arguments(v.remedy)
            )
            for v in error.verdicts
        ]
        error.args = (error.message(),)
        raise


def _arguments(text: str) -> str:
    """Replace options in a text."""
    return OPTION.sub(lambda option: ARGUMENTS[option[0]], text)


def _refuse_path(case: object) -> None:
    """Refuse a path; the message names `load`."""
    if isinstance(case, str | os.PathLike):
        raise InputError(f"expected a case, not its path; use mantle.load({str(case)!r})")


def _report(case: LoadedCase, folder: Path, comm: MPI.Comm | None) -> None:
    if case.config.output.report:
        from app.report import run_report

        run_report.after_run(folder, comm)
