"""Extension packages: without the folder of one, the core runs all else."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from app.case.summary import Summary
from tests import support
from tests.project.sources import ROOT

CORE = ("app", "forms", "meshes", "configs")
# Extensions with keys, and a key that each of them adds. (`press_fit` adds no key.)
KEYS = {
    "bearing": "interfaces.bone_cement.wear_coefficient=1e-6 mm^3/(N m)",
    "fatigue": "fatigue.region=bone",
    "patient": "geometry.kind=patient",
    "remodelling": "remodelling.lazy_zone=0.1",
}
# What the core says of these keys without the extension.
REFUSED = {
    "bearing": "interfaces.bone_cement.wear_coefficient: unknown key",
    "fatigue": "fatigue: unknown key",
    "patient": "geometry.kind: 'patient' is not one of",
    "remodelling": "remodelling: unknown key",
}
COARSE = ("mesh.size=3 mm", "mesh.order=1", "output.report=false", "output.fields=false")


def without(extension: str, copy: Path) -> Path:
    """A copy of the program without an extension and its line of registration."""
    for folder in CORE:
        shutil.copytree(ROOT / folder, copy / folder)
    shutil.copy(ROOT / "mantle.py", copy)
    shutil.rmtree(copy / "app" / extension)
    registration = copy / "app" / "extensions.py"
    text = registration.read_text(encoding="utf-8")
    text, names = re.subn(rf"\b{extension}, |, {extension}\b", "", text)
    assert names == 1
    registration.write_text(text, encoding="utf-8")
    return copy


def run(program: Path, case: Path, *overrides: str) -> subprocess.CompletedProcess[str]:
    """Run a case with a copy of the program."""
    command = [sys.executable, "-m", "mantle", "run", case, "--force", "-o", program.parent / "out"]
    command += support.sets(*overrides)
    environment = support.environment() | {"PYTHONPATH": str(program)}
    return subprocess.run(
        command, cwd=program, env=environment, capture_output=True, text=True, timeout=300
    )


@pytest.mark.parametrize("extension", KEYS)
def test_extensions_core_runs_without_one(extension: str, tmp_path: Path) -> None:
    program = without(extension, tmp_path / "program")
    case = program / "configs" / "blocks.yaml"
    refused = run(program, case, *COARSE, KEYS[extension])
    assert refused.returncode == 2
    assert REFUSED[extension] in refused.stderr
    done = run(program, case, *COARSE)
    assert done.returncode == 0, done.stderr
    assert "converged" in done.stdout


def test_extensions_all_packages_are_removed_in_turn() -> None:
    text = (ROOT / "app" / "extensions.py").read_text(encoding="utf-8")
    imported = next(n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.ImportFrom))
    assert {alias.name for alias in imported.names} == {*KEYS, "press_fit"}


def test_extensions_core_presses_without_press_fits(tmp_path: Path) -> None:
    """The interference is solved. There are no numbers of the insertion."""
    program = without("press_fit", tmp_path / "program")
    case = program / "configs" / "blocks.yaml"
    pressed = "interfaces.bone_cement.interference=10 um"
    stages = "stages=[{name: insertion}, {name: load}]", "loads.press.history=[0, 1]"
    done = run(program, case, *COARSE, pressed, *stages)
    assert done.returncode == 0, done.stderr
    assert "converged" in done.stdout
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    numbers = summary["interfaces"]["bone_cement"]
    assert "micromotion_p99" in numbers
    assert not [key for section in (numbers, *summary["regions"].values()) for key in section
                if key.startswith("insertion_")]  # fmt: skip


def test_extensions_core_names_no_section_of_one() -> None:
    sections = {*KEYS, "press_fit", "stem_test"}
    assert not sections & Summary.__annotations__.keys()


def test_extensions_core_solves_finite_sliding_without_bearings(tmp_path: Path) -> None:
    """Contact is solved. There are no numbers of sliding, and heat between the sides is refused."""
    program = without("bearing", tmp_path / "program")
    case = program / "configs" / "verification" / "drawn_block.yaml"
    two = "stages=[{name: press}, {name: there, increments: 3}]", "supports.along.history=[0, 1]"
    done = run(program, case, "output.report=false", *two)
    assert done.returncode == 0, done.stderr
    assert "converged" in done.stdout and "torque" not in done.stdout
    heat = "{conductivity: 1 W/(m K), density: 1000 kg/m^3, specific_heat: 1000 J/(kg K), "
    heat += "initial_temperature: 37 degC}"
    warm = [f"regions.{region}.thermal={heat}" for region in ("plate", "block")]
    warm += [
        "stages=[{name: press}, {name: warm, duration: 60 s}]",
        "supports.along.history=[0, 1]",
    ]
    refused = run(program, case, *warm, "interfaces.contact.conductance=5000 W/(m^2 K)")
    assert refused.returncode == 2
    assert "interfaces.contact.conductance: no package computes the heat" in refused.stderr
