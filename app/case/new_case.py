"""New cases, short and complete, for ``mantle init``."""

from __future__ import annotations

from errno import EACCES, EROFS
from pathlib import Path

import configs
from app.errors import InputError

FOLDER = configs.FOLDER / "start"
STEMS = {"titanium": "Ti-6Al-4V", "cocr": "CoCrMo", "steel": "316L"}
SCHEMA = f"# yaml-language-server: $schema={configs.FOLDER / 'schema.json'}\n"


def write(path: Path, kind: str, stem: str = "") -> Path:
    """Write a new case that runs as it is, its stem of one of `STEMS`; return its file.

    Raises:
        InputError: The file exists or cannot be written; the kind has no stem.
    """
    if stem and kind not in ("femur", "cylinders"):
        raise InputError(f"--stem {stem}: of kind {kind} there is no stem")
    path = path if path.suffix in (".yaml", ".yml") else path.with_name(f"{path.name}.yaml")
    text = (FOLDER / f"{kind}.yaml").read_text(encoding="utf-8")
    text = text.replace(STEMS["titanium"], STEMS[stem or "titanium"])
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(SCHEMA + text)
    except FileExistsError:
        raise InputError(f"{path}: is there already; nothing is written") from None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        why = "the folder is read-only" if getattr(error, "errno", 0) in (EROFS, EACCES) else why
        raise InputError(f"{path}: cannot be written: {why}") from error
    return path
