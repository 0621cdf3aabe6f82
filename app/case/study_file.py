"""Where a study stands: in its case, or in a file of its own that names the case (`StudyFile`)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from app.case import checks, overlay, study_options
from app.case.case import read_geometry, resolve
from app.case.study_options import Study, StudyFile
from app.errors import InputError
from app.schema import section, yaml_file
from app.schema.yaml_file import CaseFile, Fault

# A study has no use for the variations of its case.
ALONE = ("variations={}",)


@dataclass(frozen=True)
class Source:
    """A study and what it is of.

    Attributes:
        study: The study.
        file: The file that it stands in.
        case: The case file.
        overrides: Options that hold for every point.
        ranks: Number of MPI ranks, where a point does not say it.
    """

    study: Study
    file: CaseFile
    case: Path
    overrides: tuple[str, ...]
    ranks: int = 1


def read(path: Path, overrides: Sequence[str]) -> Source:
    """Read and check a study.

    Args:
        path: A case with a study section, or a study of another case.
        overrides: ``--set`` options, of the study or of the case: these hold for every point, so
            not for what varies.

    Raises:
        InputError: Anything wrong with it or its case, at once.
    """
    if overlay.is_study(yaml_file.read(path).data):
        return _of_another(path, overrides)
    ranks, others = study_options.split_ranks(overrides)
    file = overlay.read(path, [*others, *ALONE])
    study = resolve(file, path.parent).study
    if study is None:
        raise InputError(f"{path}: has no study section: what varies, what is measured")
    file.raise_all(_clashes(study, overrides))
    return Source(study, file, path, tuple(others), ranks or 1)


def _clashes(study: Study, overrides: Iterable[str]) -> list[Fault]:
    """Options of what the lines or the reference say."""
    lines: list[tuple[yaml_file.Path, dict[str, Any]]] = [
        (("study", "lines", name), line) for name, line in study.lines.items()
    ]
    lines.append((("study", "reference", "run"), study.reference.run or {}))
    varied = (((*path, key), key) for path, line in lines for key in line)
    return yaml_file.clashes(overrides, varied)


def _of_another(path: Path, overrides: Sequence[str]) -> Source:
    """A study that names its case."""
    mine = [o for o in overrides if re.match(r"\s*study\b", o)]
    others = [o for o in overrides if o not in mine]
    file = yaml_file.read(path, mine)
    problems: list[Fault] = []
    try:
        study = StudyFile.model_validate(file.data).study
    except ValidationError as error:
        problems += section.faults(error)
        study = None
    base, changes = file.data["base"], file.data.get("set", {})
    ranks, common = study_options.split_ranks([*_options(changes, others), *others])
    case = overlay.found(path.parent, str(base))
    if isinstance(base, str):
        try:
            content = overlay.read(case, [*common, *ALONE])
            problems += checks.quantities(read_geometry(content.data, case.parent), study)
            resolve(content, case.parent)
        except InputError as error:
            for message in error.messages:
                _blame(file, case, message, problems)
    problems += _clashes(study, others) if study else []
    file.raise_all(problems)
    assert study is not None  # or there was a problem
    return Source(study, file, case, tuple(common), ranks or 1)


def _options(changes: Any, others: Iterable[str]) -> list[str]:
    """The study's own overrides as options, but for those that others replace."""
    keys = {o.partition("=")[0].strip() for o in others}
    valid = changes if isinstance(changes, dict) else {}
    return study_options.options({k: v for k, v in valid.items() if k not in keys})


def _blame(file: CaseFile, case: Path, message: str, problems: list[Fault]) -> None:
    """Note a defect of the case where its cause is: in an override of it, or in itself."""
    if message.startswith(f"{case}: "):  # it cannot be read
        problems.append(Fault(("base",), message))
    elif found := yaml_file.at_override(
        message, {k: ("set", k) for k in file.data.get("set") or {}}
    ):
        problems.append(found)
    else:
        file.complaints.append((yaml_file.LAST, message))
