"""Runs for several tests of reports."""

from __future__ import annotations

from pathlib import Path

import pytest

import mantle
from app.results.reading import Run
from tests.report.sweeps import FRICTION, Maker
from tests.support import STEM


@pytest.fixture(scope="session")
def stems(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Run]:
    """A stem loaded in two stages at second order, and a rougher one on the same mesh."""
    folder = tmp_path_factory.mktemp("stems")
    text = STEM.replace("order: 1", "order: 2").replace("-900 N]", "-900 N], history: [0.5, 1]")
    (folder / "case.yaml").write_text(text + "stages: [{name: half}, {name: whole}]\n")
    for name, friction in (("smooth", 0.4), ("rough", 0.9)):
        case = mantle.load(folder / "case.yaml", **{FRICTION: friction})
        mantle.run(case, folder / name)
    return Run(folder / "smooth"), Run(folder / "rough")


@pytest.fixture(scope="session")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A stem pushed down in eight steps of two stages."""
    folder = tmp_path_factory.mktemp("moving")
    text = STEM.replace("-900 N]", "-900 N], history: [0.5, 1]")
    stages = "stages: [{name: half, increments: 5}, {name: whole, increments: 3}]\n"
    (folder / "case.yaml").write_text(text + stages)
    mantle.run(mantle.load(folder / "case.yaml", output__report=False), folder / "run")
    return Run(folder / "run")


@pytest.fixture
def maker(tmp_path: Path) -> Maker:
    return Maker(tmp_path)
