"""Quantities that another package adds: in every output, without touching a file."""

from __future__ import annotations

import csv
import json
import subprocess
from pathlib import Path

import pytest

from app.case import quantities
from tests import support

# All that it takes: what each is, and how it is computed.
OWN = '''
import numpy as np
from mpi4py import MPI
from app.case.quantities import STRESS, Quantity, add_quantity


def area_over(level):
    """Area of an interface where the pressure exceeds a level [mm^2]."""
    return lambda points, at: points.weight[at & (points.pressure > level)].sum()


def strain_energy(stresses, region):
    """Energy of the elastic strain of a region [N mm]."""
    _, volumes = stresses.places(region)
    return MPI.COMM_WORLD.allreduce(np.sum(stresses.energy_density(region) * volumes))


add_quantity(
    Quantity(
        "interfaces", "area_over_1MPa", "mm^2", digits=1, label="over 1 MPa",
        order=STRESS, history=True, compute=area_over(1.0),
    ),
    Quantity("interfaces", "area_over_5MPa", "mm^2", compute=area_over(5.0)),
    Quantity("regions", "strain_energy", "N mm", digits=4, compute=strain_energy),
)
'''

# Two blocks of 4 mm x 4 mm x 2 mm, pressed onto each other by 3 MPa.
CASE = """\
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: [4 mm, 4 mm, 2 mm]}
    - {name: upper, size: [4 mm, 4 mm, 2 mm]}
mesh: {order: 1, size: 2 mm}
regions:
  lower: {youngs_modulus: 2 GPa, poisson_ratio: 0, tissue: other}
  upper: {youngs_modulus: 1 GPa, poisson_ratio: 0, tissue: other}
interfaces:
  lower_upper: {kind: contact, friction_coefficient: 0.3}
supports: {base: {kind: fixed, boundary: bottom}}
loads: {press: {kind: pressure, boundary: top, pressure: 3 MPa}}
"""
STUDY = """\
base: case.yaml
study:
  quantities: [lower_upper.area_over_1MPa, upper.strain_energy]
  lines: {size: {mesh.size: [4 mm, 2 mm]}}
  reference:
    values: {lower_upper.area_over_1MPa: 16 mm^2, upper.strain_energy: 0.144 N*mm}
"""


def mantle(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command with the quantities added."""
    return support.extended(folder, OWN, CASE, *arguments)


def test_a_quantity_from_outside_is_published(tmp_path: Path) -> None:
    """3 MPa over 16 mm²; the energy is σ²/(2E) times 32 mm³."""
    done = mantle(tmp_path, "run", "case.yaml", "-o", "out", "--error")
    assert done.returncode == 0, done.stdout + done.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    found = summary["interfaces"]["lower_upper"]
    assert found["area_over_1MPa"] == pytest.approx(16, rel=1e-9)
    assert found["area_over_1MPa_error"] == pytest.approx(0, abs=1e-9)
    assert found["area_over_5MPa"] == 0
    energies = [summary["regions"][name]["strain_energy"] for name in ("lower", "upper")]
    assert energies == pytest.approx([0.072, 0.144], rel=1e-9)
    assert "area_over_5MPa_error" not in found
    with (tmp_path / "out" / "history.csv").open(newline="") as file:
        *_, last = csv.DictReader(file)
    assert float(last["lower_upper area_over_1MPa [mm^2]"]) == pytest.approx(16, rel=1e-9)
    assert not any("5MPa" in name for name in last)
    lines = done.stdout.splitlines()
    title = next(k for k, line in enumerate(lines) if line.startswith("interface"))
    assert lines[title].endswith(" over 1 MPa  area over 5MPa")
    assert lines[title + 1].split()[-2:] == ["mm^2", "mm^2"]
    assert lines[title + 2].split()[-4:] == ["16.0", "±", "0.0", "0.00"]
    assert any(line.startswith("upper") and line.endswith("0.1440") for line in lines)


@pytest.mark.slow
def test_a_study_measures_a_quantity_from_outside(tmp_path: Path) -> None:
    (tmp_path / "study.yaml").write_text(STUDY)
    done = mantle(tmp_path, "study", "study.yaml", "-o", "out", "--cores", "1")
    assert done.returncode == 0, done.stdout + done.stderr
    record = json.loads((tmp_path / "out" / "study.json").read_text())["quantities"]
    for name, unit in (("lower_upper.area_over_1MPa", "mm^2"), ("upper.strain_energy", "N mm")):
        assert record[name]["unit"] == unit
        assert [p["error"] < 1e-9 for p in record[name]["points"]] == [True, True]


def test_a_quantity_is_added_once_and_has_a_unit() -> None:
    with pytest.raises(ValueError, match="already"):
        quantities.add_quantity(quantities.TABLE["interfaces"]["gap_max"])
    with pytest.raises(ValueError, match="unit"):
        quantities.add_quantity(quantities.Quantity("interfaces", "length", "furlong"))
