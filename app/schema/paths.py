"""Files that a case names, relative to its folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, ValidationInfo

from app.schema.section import fail, not_one_of, show


class BaseText(str):
    """Text of a base; a file that it names is relative to the folder of that base.

    Attributes:
        folder: Folder of the base.
    """

    folder: Path

    @classmethod
    def of(cls, value: object, folder: Path) -> object:
        """Return a value of a base in a folder, with all its texts marked."""
        if isinstance(value, str):
            text = cls(value)
            text.folder = folder
            return text
        if isinstance(value, dict):
            return {key: cls.of(entry, folder) for key, entry in value.items()}
        if isinstance(value, list):
            return [cls.of(entry, folder) for entry in value]
        return value


def file(
    *suffixes: str,
    check: Callable[[Path, Mapping[str, Any]], object] | None = None,
    folder: bool = False,
) -> BeforeValidator:
    """A file that exists, relative to the folder of the file that names it.

    `check` raises ValueError or OSError. It is called with the keys before the file's, too. With
    `folder` it may be a folder.
    """

    def find(value: object, info: ValidationInfo) -> Path:
        if not isinstance(value, str | Path):
            fail("is not a path; expected text")
        above: Path = (info.context or {}).get("folder", Path())
        if isinstance(value, BaseText):
            above = value.folder
        try:
            path = above / Path(value).expanduser()
            exists = path.is_file() or (folder and path.is_dir())
            if exists and check:
                check(path, info.data)
        except OSError as error:
            fail(f"{show(str(value))} cannot be read: {error.strerror}")
        except (RuntimeError, ValueError) as error:  # an unknown user; a bad file
            fail(f"{show(str(value))}: {error}")
        if suffixes and path.suffix.lower() not in suffixes:
            fail(f"{show(str(value))}: {not_one_of(path.suffix, suffixes)}")
        if not exists:
            fail(f"no such file: {path}")
        return path.resolve()

    return BeforeValidator(find)


File = Annotated[Path, file()]
