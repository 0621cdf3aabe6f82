"""C code that is compiled on first use."""

from __future__ import annotations

from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import cffi
import pytest
from dolfinx import jit

from app.numerics.compiled import compiled
from app.system import form_cache

DECLARATIONS = "int twice(int);"
SOURCE = "static int twice(int n) { return 2 * n; }"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setattr(jit, "get_options", lambda: {"cache_dir": str(tmp_path)})
    return tmp_path


def twice() -> int:
    return int(compiled("test", DECLARATIONS, SOURCE).lib.twice(21))


def test_compiled_code_is_kept(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert twice() == 42
    monkeypatch.setenv("CC", "/bin/false")
    assert twice() == 42
    # Other code, another version and other options are compiled.
    for declarations, source, version, flags in (
        (DECLARATIONS, SOURCE + " ", "", []),
        (DECLARATIONS, SOURCE, "2", []),
        (DECLARATIONS, SOURCE, "", ["-O1"]),
    ):
        with pytest.raises(cffi.VerificationError):
            compiled("test", declarations, source, version=version, flags=flags)
    assert len(list(cache.glob("*" + EXTENSION_SUFFIXES[0]))) == 1
    assert not [path for path in cache.iterdir() if path.is_dir()]


@pytest.mark.parametrize("damage", ["cut", "empty", "garbage", "no mark"])
def test_compiled_again_if_damaged(damage: str, cache: Path) -> None:
    assert twice() == 42
    (module,) = cache.glob("*" + EXTENSION_SUFFIXES[0])
    content = module.read_bytes()
    module.unlink()  # the loaded module keeps its file
    match damage:
        case "cut":
            module.write_bytes(content[: len(content) // 2])
        case "empty":
            module.write_bytes(b"")
        case "garbage":
            module.write_bytes(b"x" * len(content))
        case "no mark":
            module.write_bytes(content)
            module.with_name(module.name.partition(".")[0] + ".c.cached").unlink()
    assert twice() == 42
    assert form_cache.usable(cache, module.name.partition(".")[0])


def test_compiled_error_has_the_output_of_the_compiler() -> None:
    with pytest.raises(cffi.VerificationError) as caught:
        compiled("test", DECLARATIONS, "static int twice(int n) { return unknown; }")
    assert any("unknown" in note for note in caught.value.__notes__)
    problem = form_cache.error_of_compilation(caught.value)
    assert problem and "unknown" in str(problem)
