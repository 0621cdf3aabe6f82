"""Cases over others, written and loaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from app.case.case import load_case
from app.foundation.errors import InputError
from tests.cases.blocks import BLOCKS


def write(folder: Path, **texts: str) -> Path:
    """Files by name; the path of the last."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        path = folder / f"{name}.yaml"
        path.write_text(text, encoding="utf-8")
    return path


def loaded(folder: Path, text: str, *overrides: str, below: str = BLOCKS) -> Any:
    return load_case(write(folder, blocks=below, case=text), overrides).config


def messages(path: Path, *overrides: str) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        load_case(path, overrides)
    return tuple(m.replace(f"{path.parent}/", "") for m in caught.value.messages)
