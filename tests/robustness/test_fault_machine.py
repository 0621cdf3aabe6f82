"""Clocks, missing compiler, wrong BLAS, too little memory, forms compiled elsewhere."""

from __future__ import annotations

import re
import shutil
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from app.cli import main
from app.foundation.errors import EnvironmentProblem
from app.soundness import memory
from app.system import blas_check, doctor, form_cache
from tests import support
from tests.robustness.faulty import DAMAGES, arguments, command, damage, start

# ------------------------------------------------------------------------------------ clocks


def test_fault_machine_limits_do_not_use_the_wall_clock() -> None:
    """Limits and durations use clocks that nobody sets."""
    clock = re.compile(r"\btime\.time\(|datetime\.now|clock\.time\(")
    files = [p for part in ("app", "meshes", "forms") for p in (support.ROOT / part).rglob("*.py")]
    used = {f"{p.parent.name}/{p.name}" for p in files if clock.search(p.read_text())}
    # Provenance of a run, of a checkpoint; and how old files are, which is by that clock.
    records = {"simulation/session.py", "simulation/checkpoint.py", "results/run_folder.py"}
    assert used == records


# ------------------------------------------------------------------------------------- memory


def test_fault_machine_memory_errors_are_named() -> None:
    full = OSError(12, "Cannot allocate memory")
    for error in (MemoryError(), full, Exception("std::bad_alloc")):
        explained = memory.error_without_memory(error)
        assert isinstance(explained, EnvironmentProblem) and "not enough memory" in str(explained)
    try:
        try:
            raise MemoryError("the factors of 10 unknowns")
        except MemoryError as error:
            raise ValueError("else") from error
    except ValueError as error:
        assert "the factors of 10 unknowns" in str(memory.error_without_memory(error))
    circular = ValueError("x")
    circular.__cause__ = circular
    assert memory.error_without_memory(circular) is None


def test_fault_machine_too_little_memory_for_any_case(tmp_path: Path) -> None:
    limited = ["sh", "-c", 'ulimit -v 500000; exec "$@"', "sh", *command(tmp_path / "out")]
    env = support.environment()
    done = subprocess.run(limited, env=env, capture_output=True, text=True, timeout=60)
    assert done.returncode == 69
    assert "not enough memory for any case: a process may use 0.5 GB" in done.stderr
    assert not (tmp_path / "out").exists()


# --------------------------------------------------------------------------------------- BLAS


def test_fault_machine_blas_here_is_right() -> None:
    assert blas_check.wrong_results() == [] and doctor.wrong_blas() == ""


@pytest.mark.parametrize("error", [1e-3, np.nan, np.inf])
def test_fault_machine_doctor_and_verify_report_a_wrong_blas(
    error: float, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(blas_check, "_errors", lambda: iter([("dxyz", error)]))
    assert any("computes wrong numbers: dxyz" in problem for problem in doctor.problems())
    assert main(["verify", "--dry-run"]) == EnvironmentProblem.exit_code
    assert "computes wrong numbers: dxyz" in capsys.readouterr().err


# ------------------------------------------------------------------------------- compilations


# Of each what it does, as a script; None: there is none.
COMPILERS: dict[str, str | None] = {
    "fails": "exit 1",
    "makes nothing": "exit 0",
    "is killed": "kill -9 $$",
    "has no linker": 'for w; do [ "$w" = -shared ] && exit 1; done; exec cc "$@"',
    "links nothing": 'for w; do [ "$w" = -shared ] && exit 0; done; exec cc "$@"',
    "makes garbage": 'for o; do :; done; while [ "$1" != -o ]; do shift; done; echo x >"$2"',
    "is not executable": "",
    "is not there": None,
}


@pytest.mark.slow
@pytest.mark.parametrize(("how", "ranks"), [*((how, 1) for how in COMPILERS), ("is not there", 2)])
def test_fault_machine_compiler_that(how: str, ranks: int, tmp_path: Path) -> None:
    compiler, text, cache = tmp_path / "cc", COMPILERS[how], str(tmp_path / "cache")
    if text is not None:
        compiler.write_text(f"#!/bin/sh\n{text}\n")
        compiler.chmod(0o755 if text else 0o644)
    words = arguments(tmp_path / "out", "-n", str(ranks))
    done = support.python(*words, code=69, CC=str(compiler), XDG_CACHE_HOME=cache)
    assert done.stderr.count("a form cannot be compiled: ") == 1
    assert "Traceback" not in done.stderr
    if text is None:
        assert str(compiler) in done.stderr
        assert "mantle doctor checks the C compiler" in done.stderr
    support.python(*words, XDG_CACHE_HOME=cache)


@pytest.mark.slow
@pytest.mark.parametrize("how", DAMAGES)
def test_fault_machine_damaged_forms_are_compiled_again(
    how: str, warmed: Path, tmp_path: Path
) -> None:
    shutil.copytree(warmed, tmp_path / "cache")
    modules = list((tmp_path / "cache" / "fenics").glob("*.so"))
    assert modules
    for path in modules:
        damage(path, how)
    support.python(*arguments(tmp_path / "out"), XDG_CACHE_HOME=str(tmp_path / "cache"))


WAITING = """\
import sys, time
from pathlib import Path
from app.system import form_cache
form, folder = sys.argv[1], Path(sys.argv[2])
form_cache._get_or_lock(lambda *_: (folder / f"{form}.c").touch(), form, [], folder, 10)
print("compiling", flush=True)
time.sleep(60)
"""


def test_fault_machine_waits_for_a_running_compilation(tmp_path: Path) -> None:
    """Files of a process are removed only after its death. Other forms are available."""
    form, other = "libffcx_forms_" + "0" * 40, "libffcx_forms_" + "1" * 40
    existed: dict[str, bool] = {}

    def get(name: str, objects: list[str], folder: Path, timeout: int) -> None:
        existed[name] = (folder / f"{name}.c").exists()

    def find(name: str) -> None:
        form_cache._compile_then_unlock(
            lambda: form_cache._get_or_lock(get, name, [], tmp_path, 10)
        )

    child = support.started("-c", WAITING, form, tmp_path)
    assert child.stdout is not None and child.stdout.readline() == "compiling\n"
    waiter = threading.Thread(target=find, args=(form,))
    waiter.start()
    time.sleep(0.5)
    assert not existed and (tmp_path / f"{form}.c").exists()
    child.kill()
    child.communicate()
    waiter.join(10)
    find(other)
    assert existed == {form: False, other: False} and not form_cache._locks


@pytest.mark.slow
@pytest.mark.parametrize("number", range(3))
def test_fault_machine_two_cold_runs_at_once(number: int, tmp_path: Path) -> None:
    """The compiler takes longer than the usual waiting time."""
    compiler = tmp_path / "cc"
    compiler.write_text(f'#!/bin/sh\nsleep {12 if number == 0 else 1}\nexec cc "$@"\n')
    compiler.chmod(0o755)
    environ = {"XDG_CACHE_HOME": str(tmp_path / "c"), "CC": str(compiler)}
    both = []
    for k in range(2):
        both.append(start(tmp_path / f"{k}", **environ))
        time.sleep(0.2 * number)
    for child in both:
        assert child.communicate(timeout=600)[1] == ""
        assert child.returncode == 0
    shutil.rmtree(tmp_path / "c")
