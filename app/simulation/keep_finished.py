"""What ``mantle run --keep`` leaves alone: what this program and stack made of the same case."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mantle.schema import config
from mantle.system import identity


def finished(folder: Path, case: config.Case) -> bool:
    """Tell whether a run directory is complete, that of a case, and of this very program.

    Args:
        folder: The run directory.
        case: The configuration, without variations. A mesh file that is newer than the results
            makes another case of it.
    """
    try:
        done = (folder / "DONE").stat().st_mtime
        same = (folder / "case.yaml").read_text(encoding="utf-8") == config.dump(case)
        record = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    same &= record.get("identity") == identity.parts()
    geometry = case.geometry
    newer = isinstance(geometry, config.MeshFile) and geometry.path.stat().st_mtime > done
    return same and not newer


def summaries(output: Path, varied: Sequence[config.Varied]) -> dict[int, dict[str, Any]]:
    """The summaries of the variations that are finished, by their places.

    Args:
        output: The folder above theirs.
        varied: The variations.
    """
    return {
        i: json.loads((output / v.name / "summary.json").read_text(encoding="utf-8"))
        for i, v in enumerate(varied)
        if finished(output / v.name, v.case)
    }


def everything(output: Path, case: config.Case, case_path: Path, overrides: Sequence[str]) -> bool:
    """Tell whether a run directory has all that a case asks for.

    Args:
        output: The run directory.
        case: The configuration.
        case_path: The case file.
        overrides: ``--set`` options.
    """
    if not case.variations:
        return finished(output, case)
    varied = config.variations(case_path, overrides)
    return (output / "DONE").exists() and all(finished(output / v.name, v.case) for v in varied)
