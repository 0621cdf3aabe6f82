"""The doctor reports present and missing parts, and the loaded BLAS."""

from __future__ import annotations

from pathlib import Path

import pytest

from app import __version__
from app.system import doctor

MAPS = """\
7f00-7f01 r-xp 00000000 08:01 123 /usr/lib/x86_64-linux-gnu/openblas-pthread/libblas.so.3
7f01-7f02 r--p 00001000 08:01 123 /usr/lib/x86_64-linux-gnu/openblas-pthread/libblas.so.3
7f02-7f03 r-xp 00000000 08:01 124 /usr/lib/x86_64-linux-gnu/openblas-pthread/libopenblasp-r0.3.29.so
7f03-7f04 r-xp 00000000 08:01 125 /usr/lib/x86_64-linux-gnu/libblasfeo.so.0
7f04-7f05 rw-p 00000000 00:00 0
7f05-7f06 rw-p 00000000 00:00 0 [heap]
7f06-7f07 r-xp 00000000 08:01 126 /opt/with blank/libmkl_rt.so.2
""".splitlines()


def test_doctor_finds_blas_in_the_memory_map() -> None:
    names = [Path(path).name for path in doctor.blas_libraries(MAPS)]
    assert names == ["libmkl_rt.so.2", "libblas.so.3", "libopenblasp-r0.3.29.so"]


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("/usr/lib/x86_64-linux-gnu/blas/libblas.so.3", True),
        ("/usr/lib/x86_64-linux-gnu/blas/libblas.so.3.12.1", True),
        ("/usr/lib/x86_64-linux-gnu/openblas-pthread/libblas.so.3", False),
        ("/usr/lib/x86_64-linux-gnu/openblas-pthread/libopenblasp-r0.3.29.so", False),
    ],
)
def test_doctor_recognizes_reference_blas(path: str, expected: bool) -> None:
    assert doctor.is_reference_blas(path) is expected


def test_doctor_report_names_dependencies() -> None:
    text = doctor.report_on_machine()
    rows = dict(line.split(maxsplit=1) for line in text.split("\n\n")[0].splitlines())
    assert rows["mantle"] == __version__
    for name in ("dolfinx", "petsc4py", "PETSc", "BLAS", "OMP_NUM_THREADS", "cores", "/dev/shm"):
        assert rows[name], name


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ImportError("dolfinx"), "not installed: dolfinx, petsc4py"),
        (OSError("libfoo.so: undefined symbol"), "unusable (OSError: libfoo.so: undefined symbol)"),
    ],
)
def test_doctor_report_with_missing_packages(
    error: Exception, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(name: str) -> None:
        raise error

    monkeypatch.setattr(doctor, "import_module", fail)
    monkeypatch.setenv("PATH", "/nonexistent")
    text = doctor.report_on_machine()
    for expected in (words, "mpirun is missing", "no C compiler"):
        assert expected in text


@pytest.mark.parametrize(
    ("version", "message"),
    [
        ("0.8.0", "DOLFINx 0.8.0 is too old"),
        ("0.9.0", ""),
        ("0.10.0.post5", ""),
        ("0.11.0.post0", ""),
        ("0.12.1", "DOLFINx 0.12.1 is newer"),
    ],
)
def test_doctor_reports_an_unknown_dolfinx(
    version: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "_version", lambda module: version)
    problems = [problem for problem in doctor.problems() if "DOLFINx" in problem]
    assert len(problems) == bool(message) and all(
        problem.startswith(message) for problem in problems
    )


def test_doctor_reports_missing_factors_with_their_cost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    text = "3.25.5, float64, with MUMPS, without CHOLMOD"
    monkeypatch.setattr(doctor, "_petsc", lambda: text)
    (problem_text,) = [problem for problem in doctor.problems() if problem.startswith("PETSc")]
    assert "no CHOLMOD" in problem_text and "times the CPU time" in problem_text


def test_doctor_reports_slow_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for threads, blas, slow in (("1", "openblas-pthread", False), ("4", "blas", True)):
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        path = f"/usr/lib/x86_64-linux-gnu/{blas}/libblas.so.3"
        monkeypatch.setattr(doctor, "loaded_blas", lambda path=path: [path])
        text = "\n".join(doctor.problems())
        assert ("OMP_NUM_THREADS is not 1" in text) == slow
        assert ("libopenblas0-pthread" in text) == slow
