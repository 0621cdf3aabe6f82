"""The cache of compiled forms: incomplete modules, notes."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.numerics import pointwise
from app.system import folders, form_cache
from tests import support
from tests.system.caches import FORM, write_form


@pytest.mark.parametrize("damage", ["none", "cut", "no mark", "no source", "no module"])
def test_form_cache_incomplete_modules_are_compiled_again(damage: str, tmp_path: Path) -> None:
    module = write_form(tmp_path, "4")
    source, mark = tmp_path / f"{FORM}.c", tmp_path / f"{FORM}.c.cached"
    match damage:
        case "cut":
            module.write_text("cod")
        case "no mark" | "no source" | "no module":
            {"mark": mark, "source": source, "module": module}[damage.split()[1]].unlink()
    existed: list[bool] = []
    form_cache._compile_then_unlock(
        lambda: form_cache._get_or_lock(
            lambda *_: existed.append(source.exists()), FORM, [], tmp_path, 10
        )
    )
    assert existed == [damage == "none"] and not form_cache._locks


@pytest.mark.parametrize(
    "change",
    [
        {"module": "../../tmp/evil"},
        {"module": "/tmp/libffcx_expressions_0"},
        {"symbol": "system"},
        {"shapes": 3},
    ],
)
def test_form_cache_note_names_a_module(home: Path, change: dict[str, object]) -> None:
    folder = folders.cache("laws")
    assert folder is not None
    note = folder / "law-0.json"
    right = {"module": f"libffcx_expressions_{'0' * 40}", "symbol": f"expression_{'0' * 40}"}
    folders.write_json(note, right | {"inputs": [], "shapes": []} | change)
    assert pointwise.load_noted(support.MPI.COMM_SELF, note) is None
