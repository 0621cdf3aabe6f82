"""Files that a case names, relative to its own folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, ValidationInfo

from app.schema.section import fail, show


def _find(value: object, info: ValidationInfo) -> Path:
    if not isinstance(value, str | Path):
        fail(f"{show(value)} is not a path; expected text")
    path: Path = (info.context or {}).get("folder", Path()) / Path(value).expanduser()
    if not path.is_file():
        fail(f"no such file: {path}")
    return path.resolve()


File = Annotated[Path, BeforeValidator(_find)]
