"""Folder of a run, and the check for finished results of this program and its libraries."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from app.case.case import Case, LoadedCase, PlannedRun, dump, named_files
from app.case.geometries import MeshFile
from app.case.summary import Summary
from app.foundation.errors import InputError
from app.results.verdicts import check_usable
from app.soundness import memory
from app.system import folders, identity


def finished(folder: Path, case: Case) -> bool:
    """Return True if a run directory is complete, of this case, and written by this program.

    The case has no variations. A file that it names, such as a mesh, and that is newer than the
    results, makes it another case.
    """
    try:
        done_at = (folder / "DONE").stat().st_mtime
        written = (folder / "case.yaml").read_text(encoding="utf-8")
        is_same_case = written == dump(case)
        record = folders.read_json(folder / "provenance.json")
    except (OSError, ValueError):
        return False
    is_same_case &= record.get("identity") == identity.versions()
    geometry = case.geometry
    stamps = [path.stat().st_mtime for path in named_files(case)]
    if isinstance(geometry, MeshFile):
        stamps.append(geometry.modified)
    return is_same_case and max(stamps, default=0.0) <= done_at


def summaries(runs: Mapping[Path, PlannedRun]) -> dict[Path, Summary]:
    """Summaries of those runs that are finished, by folder."""
    return {
        folder: folders.read_json(folder / "summary.json")
        for folder, run in runs.items()
        if finished(folder, run.case)
    }


def prepare(case: LoadedCase, output: Path, *, force: bool = False, restart: str = "") -> bool:
    """Make the folder of a run before it starts; return True if the run is finished already.

    ``force`` replaces results, even those of the same case. ``restart`` is a checkpoint to restart
    from, ``auto`` or "".

    Raises:
        InputError: The case does not fit this machine, or the folder cannot be used.
        UnusableError: The run is finished, but its results must not be used.
    """
    if restart not in ("", "auto") and case.config.variations:
        raise InputError(
            "--restart FILE: a checkpoint belongs to one variation; use --restart auto"
        )
    memory.check(case.file, case.config)
    runs = case.runs(output)
    all_finished = (
        not force
        and restart in ("", "auto")
        and (output / "DONE").exists()
        and all(finished(folder, run.case) for folder, run in runs.items())
    )
    folders.prepare_run(output, force or all_finished or bool(restart))
    for folder in runs:
        folders.raise_if_taken(folder)
    if all_finished:
        check_usable({folder: folders.read_json(folder / "summary.json") for folder in runs})
    return all_finished
