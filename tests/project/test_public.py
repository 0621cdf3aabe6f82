"""The public functions for Python, and modules that importing and installing mantle loads."""

from __future__ import annotations

import dataclasses
import fcntl
import json
import re
import shutil
import signal
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mantle
from app.foundation.errors import InputError
from app.simulation.recorder import AcceptedStep
from tests import support
from tests.support import CONFIGS, ROOT

COARSE = {"mesh.size": "4 mm", "mesh.order": 1}


def python(*arguments: str, **more: str) -> str:
    return support.python(*arguments, **more).stdout


def test_public_import_starts_neither_mpi_nor_petsc() -> None:
    """A process that starts ranks needs no MPI. Pictures and units are imported on use."""
    loaded = python("-c", "import sys, mantle; print(*sys.modules)").split()
    stack = {"dolfinx", "petsc4py", "mpi4py", "gmsh", "h5py", "matplotlib", "pint"}
    assert "mantle" in loaded and not stack & {name.partition(".")[0] for name in loaded}


def test_public_core_needs_no_cases() -> None:
    """Modules that `docs/demos` import solve without case files, mesher, results and reports."""
    code = (
        "import sys, app.stepping.stages, app.scene.scene, meshes.distribute; print(*sys.modules)"
    )
    loaded = set(python("-c", code).split())
    assert {"app.mechanics.problem", "app.heat.operators"} <= loaded
    assert not {"app.case.case", "app.results", "app.simulation", "app.report", "gmsh"} & loaded


def test_public_package_is_the_command() -> None:
    assert python("-m", "mantle", "--help").startswith("usage: mantle ")
    assert python("-m", "mantle", "--version") == f"mantle {mantle.__version__}\n"


# What a run, its report and its results may not change in the process that calls them.
GUEST = """
import locale, os, signal, sys, ufl, warnings
from dolfinx import fem
import dolfinx.jit, ffcx.codegeneration.jit, ffcx.options, numpy, logging
import ruamel.yaml, scipy.sparse, scipy.special  # which add filters of warnings
import matplotlib.pyplot as plt
plt.rcParams["font.size"] = 23

def settings():
    modules = (dolfinx.jit, ffcx.codegeneration.jit, ffcx.options)
    return {
        **dict(os.environ), **plt.rcParams, "figures": plt.get_fignums(), "path": list(sys.path),
        **{f"{m.__name__}.{k}": v for m in modules for k, v in vars(m).items() if callable(v)},
        **{str(s): signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)},
        "numpy": (numpy.geterr(), numpy.get_printoptions()), "hook": sys.excepthook,
        "log": (list(logging.root.handlers), logging.root.level), "here": os.getcwd(),
        "filters": list(warnings.filters), "show": warnings.showwarning,
        "locale": locale.setlocale(locale.LC_ALL), "backend": plt.get_backend(),
    }

before = settings()
import mantle
# A size that no cache has: gmsh has to come.
size = f"{4 - os.getpid() / 1e8} mm"
case = mantle.load(sys.argv[1], **{"mesh.size": size, "output.error": True})
mantle.check(case, meshed=True)
results = mantle.run(case, sys.argv[2])
after = settings()
print("changed:", *[k for k in {**before, **after} if before.get(k) != after.get(k)])
print(len(repr(case).splitlines()), len(repr(results).splitlines()))
u = results.fields.function("displacement")
integral = fem.assemble_scalar(fem.form(ufl.inner(u, u) * ufl.dx(degree=6)))
print(integral ** 0.5 / results.fields.norms(lambda x, region: 0 * x)[1])
try:
    results.fields.on_points("stres")
except mantle.InputError as error:
    print(error)
"""


def test_public_host_keeps_its_settings(tmp_path: Path) -> None:
    printed = python(
        "-c", GUEST, str(CONFIGS / "cylinders.yaml"), str(tmp_path / "out")
    ).splitlines()
    printed = printed[next(k for k, line in enumerate(printed) if line.startswith("changed:")) :]
    assert printed[:2] == ["changed:", "5 4"] and float(printed[2]) == pytest.approx(1, rel=1e-10)
    assert "no field 'stres' on points; fields: " in printed[3] and "stress" in printed[3]


def test_public_host_without_mpi_keeps_its_environment(tmp_path: Path) -> None:
    """MPI starts within the run, and its folder is for the run alone."""
    host = """
import os, sys
os.environ["TMPDIR"] = sys.argv[3]
before = dict(os.environ)
import mantle
within = []
case = mantle.load(sys.argv[1], **{"mesh.size": "4 mm", "mesh.order": 1})

def changed():
    return {n for n in {**before, **os.environ} if before.get(n) != os.environ.get(n)}

for k in range(2):
    progress = lambda step: within.append(changed())
    print(mantle.run(case, f"{sys.argv[2]}{k}", progress=progress) and changed())
print("TMPDIR" in within[0], within[-1])
try:
    mantle.run(case, sys.argv[1])
except mantle.InputError:
    print(changed())
"""
    places = str(CONFIGS / "blocks.yaml"), str(tmp_path / "out"), str(tmp_path)
    printed = python("-c", host, *places, PYTHONPATH=str(ROOT)).splitlines()
    assert printed[-4:] == ["set()", "set()", "True set()", "set()"]


# ---------------------------------------------------------------------------------- one case


def test_public_load_with_overrides() -> None:
    dots = mantle.load(CONFIGS / "blocks.yaml", **COARSE, title="Coarse")
    words = mantle.load(str(CONFIGS / "blocks.yaml"), mesh__size="4 mm", mesh__order=1)
    assert dots.config.mesh == words.config.mesh
    assert (dots.config.mesh.size, dots.config.title) == (4.0, "Coarse")
    with pytest.raises(InputError, match=r"(?m)^mesh\.size: ") as caught:
        mantle.load(CONFIGS / "blocks.yaml", **{"mesh.size": "5 kg"}, mesh__oder=1)
    assert len(caught.value.messages) == 2


def test_public_check_returns_case_and_size() -> None:
    case = mantle.load(CONFIGS / "blocks.yaml", **COARSE, loads={})
    estimated, counted = mantle.check(case), mantle.check(case, meshed=True)
    assert estimated.description == counted.description
    assert "estimated" in estimated.size and "estimated" not in counted.size
    assert "the result will be zero" in estimated.notes[0].text
    assert str(estimated).count("\nnote: ") == len(counted.notes)
    assert len(estimated.notes) == len(counted.notes)


def test_public_mesh_returns_plain_arrays() -> None:
    data = mantle.mesh(mantle.load(CONFIGS / "blocks.yaml", **COARSE))
    assert data.points.shape[1:] == (3,) and data.cells.shape == (len(data.cell_tags), 4)
    assert list(data.regions) == ["bone", "cement", "metal"]


def test_public_run_reports_steps_and_returns_results(tmp_path: Path) -> None:
    case = mantle.load(CONFIGS / "cylinders.yaml", **COARSE)
    steps: list[AcceptedStep] = []
    results = mantle.run(case, tmp_path / "out", progress=steps.append)
    assert [(s.number, s.stage, s.time) for s in steps][:2] == [
        (1, "press_fit", 1.0),
        (2, "push_in", 1.25),
    ]
    last = steps[-1]
    assert (last.folder, last.time, last.end) == (tmp_path / "out", 2.0, 2.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        last.time = 0.0  # type: ignore[misc]
    # Numbers, histories and fields are those of the files, and of each other.
    contact = results.summary["interfaces"]["stem_cement"]
    slips = results.step_record["stem_cement slip_max [mm]"]
    assert list(slips) == [s.row["stem_cement slip_max [mm]"] for s in steps]
    assert slips[-1] == contact["slip_max"]
    f = results.fields
    n, m = len(f.points), len(f.cells)
    assert (f.on_points("displacement").shape, f.stress().shape) == ((n, 3), (m, 3, 3))
    assert f.on_cells("region").shape == (m,) and {"displacement"} < {*f.point_fields}
    first, end = f.displacement("press_fit"), f.displacement("push_in")
    assert (first == f.displacement(0)).all() and (end == f.displacement(-1)).all()
    top = f.nodes_of(f.regions["stem"])
    top = top[f.points[top, 2] > 39.99]
    np.testing.assert_allclose(end[top, 2] - first[top, 2], -0.1, rtol=1e-6)
    assert (f.nodes_of("stem") == f.nodes_of(f.regions["stem"])).all()
    stages = "press_fit, push_in"
    unknown: dict[str, Callable[[], Any]] = {
        f"no stage 'pull' with a written step; stages: {stages}": lambda: f.displacement("pull"),
        f"no written step {len(f.times)}; there are": lambda: f.stress(len(f.times)),
        "no region 'stemm'; regions: .*did you mean 'stem'": lambda: f.nodes_of("stemm"),
        "no region '0'; regions: ": lambda: f.nodes_of(0),
        "no interface 'stem'; interfaces: stem_cement, cement_bone": lambda: f.at_interface(
            "stem", "gap"
        ),
        "no interface 'cement'; ": lambda: f.areas("cement"),
        "no quantity 'slop' at interface 'stem_cement'; quantities: .*'slip'": lambda: (
            f.at_interface("stem_cement", "slop")
        ),
        "no field 'displacement' on cells; fields: ": lambda: f.on_cells("displacement"),
    }
    for text, action in unknown.items():
        with pytest.raises(InputError, match=text):
            action()
    # As on the command line: results are kept if they are the same, and not replaced unasked.
    with pytest.raises(InputError, match="is not empty"):
        mantle.run(mantle.load(CONFIGS / "cylinders.yaml", title="other"), tmp_path / "out")
    written = (tmp_path / "out" / "DONE").stat().st_mtime_ns
    mantle.run(case, tmp_path / "out", progress=lambda step: pytest.fail("it ran"))
    assert (tmp_path / "out" / "DONE").stat().st_mtime_ns == written


def test_public_fields_are_read_while_locked(
    tmp_path: Path,
) -> None:
    case = mantle.load(CONFIGS / "blocks.yaml", **COARSE)
    results = mantle.run(case, tmp_path / "out")
    path = tmp_path / "out" / "fields.vtkhdf"
    with path.open("r+b") as viewer:
        fcntl.flock(viewer, fcntl.LOCK_EX)
        path.chmod(0o444)
        path.parent.chmod(0o555)
        assert len(results.fields.displacement()) == len(results.fields.points)
    path.parent.chmod(0o755)
    path.chmod(0o644)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(OSError, match=r"fields\.vtkhdf: the fields cannot be read: "):
        _ = mantle.read(tmp_path / "out").fields


def test_public_error_in_progress_ends_a_run(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)

    def fail(step: AcceptedStep) -> None:
        raise KeyError(step.stage)

    case = mantle.load(CONFIGS / "blocks.yaml", **COARSE)
    with pytest.raises(KeyError, match="load"):
        mantle.run(case, tmp_path, progress=fail)
    assert len(mantle.read(tmp_path).step_record["step"]) == 1
    assert mantle.run(case, tmp_path, force=True).summary["status"] == "converged"
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(
        InputError, match="has no results of a run; expected a folder written by mantle run"
    ):
        mantle.read(tmp_path / "none")


def test_public_variations_have_separate_results(tmp_path: Path) -> None:
    some = {"bonded": {"interfaces.stem_cement": {"kind": "bonded"}}, "as_is": {}}
    case = mantle.load(
        CONFIGS / "variations.yaml", variations=some, **{**COARSE, "output.fields": False}
    )
    folders = set()
    results = mantle.run(case, tmp_path, progress=lambda step: folders.add(step.folder))
    assert folders == {tmp_path / "bonded", tmp_path / "as_is"}
    assert results.variations.keys() == some.keys()
    slip = results.variations["as_is"].summary["interfaces"]["stem_cement"]["slip_max"]
    assert slip > 0 and "stem_cement" not in results.variations["bonded"].summary["interfaces"]


# ----------------------------------------------------------------------- notebooks, installing


def cells(path: Path) -> list[str]:
    """The code of a notebook, which has no outputs, or of a page of the manual."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    code = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code)
    return ["".join(cell["source"]) for cell in code]


PAGES = [*sorted(CONFIGS.glob("notebooks/*.ipynb")), ROOT / "docs" / "howto" / "python.md"]


@pytest.mark.parametrize("path", PAGES, ids=lambda p: p.name)
def test_public_examples_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names: dict[str, object] = {}
    for number, code in enumerate(cells(path), 1):
        exec(compile(code, f"{path.name}:{number}", "exec"), names)
    assert list(tmp_path.glob("out/*/DONE"))


@pytest.mark.slow
def test_public_wheel_installs_five_names(tmp_path: Path) -> None:
    """The wheel has the shipped cases, and no other folders of a checkout."""
    pytest.importorskip("setuptools")
    checkout = tmp_path / "checkout"
    for folder in ("app", "forms", "meshes", "configs"):
        shutil.copytree(ROOT / folder, checkout / folder)
    for file in ("pyproject.toml", "README.md", "mantle.py"):
        shutil.copy(ROOT / file, checkout)
    build = ["wheel", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    python("-m", "pip", *build, "-w", str(tmp_path), str(checkout))
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = {name.split("/")[0] for name in archive.namelist()}
        archive.extractall(tmp_path / "site")
    assert {name for name in names if not name.endswith(".dist-info")} == {
        *("app", "configs", "forms", "mantle.py", "meshes")
    }
    code = (
        "import mantle; from configs import FOLDER; from app.cli import main; "
        "print(mantle.__file__); main(['check', str(FOLDER / 'blocks.yaml'), '--mesh']); "
        "print(*FOLDER.glob('notebooks/*'))"
    )
    printed = python("-c", code, PYTHONPATH=str(tmp_path / "site")).splitlines()
    assert printed[0] == str(tmp_path / "site" / "mantle.py")
    assert "Patch test of three blocks" in printed
    assert printed[-1] == str(tmp_path / "site" / "configs" / "notebooks/first_run.ipynb")


def test_public_shell_completion() -> None:
    pytest.importorskip("argcomplete")
    line = "mantle swe"
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line))}
    asked |= {"_ARGCOMPLETE_STDOUT_FILENAME": "/dev/stdout"}
    assert python("-m", "mantle", **asked).strip() == "sweep"
