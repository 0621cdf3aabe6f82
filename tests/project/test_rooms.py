"""Packages that add to the core: without its folder, the core runs what does not need it."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import support
from tests.project.sources import ROOT

CORE = ("app", "forms", "meshes", "configs")
# Rooms, with a key that each of them adds.
KEYS = {
    "fatigue": "fatigue.region=bone",
    "patient": "geometry.kind=patient",
    "remodelling": "remodelling.lazy_zone=0.1",
}
# What the core says of these keys without the room.
REFUSED = {
    "fatigue": "fatigue: unknown key",
    "patient": "geometry.kind: 'patient' is not one of",
    "remodelling": "remodelling: unknown key",
}
COARSE = ("mesh.size=3 mm", "mesh.order=1", "output.report=false", "output.fields=false")


def without(room: str, copy: Path) -> Path:
    """A copy of the program without a room and its line of registration."""
    for folder in CORE:
        shutil.copytree(ROOT / folder, copy / folder)
    shutil.copy(ROOT / "mantle.py", copy)
    shutil.rmtree(copy / "app" / room)
    rooms = copy / "app" / "rooms.py"
    text = rooms.read_text(encoding="utf-8")
    text, names = re.subn(rf"\b{room}, |, {room}\b", "", text)
    assert names == 2
    rooms.write_text(text, encoding="utf-8")
    return copy


@pytest.mark.parametrize("room", KEYS)
def test_rooms_core_runs_without_a_room(room: str, tmp_path: Path) -> None:
    program = without(room, tmp_path / "program")

    def run(*overrides: str) -> subprocess.CompletedProcess[str]:
        output = tmp_path / "out"
        case = program / "configs" / "blocks.yaml"
        command = [sys.executable, "-m", "mantle", "run", case, "-o", output]
        command += support.sets(*COARSE, *overrides)
        environment = support.environment() | {"PYTHONPATH": str(program)}
        return subprocess.run(
            command, cwd=program, env=environment, capture_output=True, text=True, timeout=300
        )

    refused = run(KEYS[room])
    assert refused.returncode == 2
    assert REFUSED[room] in refused.stderr
    done = run()
    assert done.returncode == 0, done.stderr
    assert "converged" in done.stdout
