"""A case together with the file it comes from: what the commands and the public functions take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from app.case import overlay
from app.case.case import Case, Varied, resolve, variations_of
from app.schema.yaml_file import CaseFile


@dataclass(frozen=True)
class LoadedCase:
    """A case and where it comes from.

    Attributes:
        config: The checked case: ``case.config.mesh.size``, ``case.config.regions["stem"]``. Its
            values are floats in mm, N, MPa, s, K, rad; every interface of the geometry is listed.
        path: The case file.
        overrides: What was changed in it, ``key=value`` each.
        file: Its content, and where each key stands, for messages.
    """

    config: Case
    path: Path
    overrides: tuple[str, ...]
    file: CaseFile = field(repr=False)

    @property
    def output(self) -> Path:
        """The folder of its results, unless another is asked for: ``out/<name of the file>``."""
        return Path("out") / self.path.stem

    def variations(self) -> list[Varied]:
        """The variations of the case, in the order of the file."""
        return variations_of(self.path, self.overrides)


def load(path: Path, overrides: Sequence[str] = ()) -> LoadedCase:
    """Read, check and resolve a case.

    Args:
        path: The YAML file.
        overrides: ``a.b.c=value`` each, applied in order before anything is checked.

    Raises:
        InputError: Anything wrong with the file; every defect at once, one line each.
    """
    file = overlay.read(path, overrides)
    return LoadedCase(resolve(file, path.parent), path, tuple(overrides), file)
