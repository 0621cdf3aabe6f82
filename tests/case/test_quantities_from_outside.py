"""Quantities that a user's package adds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import mantle
from app.case import quantities
from tests import support
from tests.cases.outside import CASE, run

# Quantities: what each is, and how it is computed.
EXTENSION = '''
import numpy as np
from mpi4py import MPI
from app.case.error_classes import STRESS_ERRORS
from app.case.quantities import Quantity, add_quantity


def area_over(level):
    """Area of an interface where the pressure exceeds a level [mm^2]."""
    return lambda points, at: points.weight[at & (points.pressure > level)].sum()


def strain_energy(stresses, region):
    """Energy of the elastic strain of a region [N mm]."""
    _, volumes = stresses.points_and_volumes(region)
    return MPI.COMM_WORLD.allreduce(np.sum(stresses.energy_density(region) * volumes))


add_quantity(
    Quantity(
        "interfaces", "area_over_1MPa", "mm^2", digits=1, label="over 1 MPa",
        error_class=STRESS_ERRORS, step_record=True, compute=area_over(1.0),
    ),
    Quantity("interfaces", "area_over_5MPa", "mm^2", compute=area_over(5.0)),
    Quantity("regions", "strain_energy", "N mm", digits=4, compute=strain_energy),
)
'''

# The same blocks, pressed onto each other by 3 MPa.
PRESSED = CASE.replace(
    "kind: elastic_layer, stiffness: 50 MPa/mm", "kind: contact, friction_coefficient: 0.3"
).replace("-3 MPa", "3 MPa")
STUDY = """\
base: case.yaml
study:
  quantities: [lower_upper.area_over_1MPa, upper.strain_energy]
  lines: {size: {mesh.size: [4 mm, 2 mm]}}
  reference:
    values: {lower_upper.area_over_1MPa: 16 mm^2, upper.strain_energy: 0.144 N*mm}
"""


def test_quantities_from_outside_is_published(tmp_path: Path) -> None:
    """The force is 3 MPa over 16 mm²; the energy is σ²/(2E) times 32 mm³."""
    summary, output = run(tmp_path, EXTENSION, PRESSED, "--error")
    interface = summary["interfaces"]["lower_upper"]
    assert interface["area_over_1MPa"] == pytest.approx(16, rel=1e-9)
    assert interface["area_over_1MPa_error"] == pytest.approx(0, abs=1e-9)
    assert interface["area_over_5MPa"] == 0
    energies = [summary["regions"][name]["strain_energy"] for name in ("lower", "upper")]
    assert energies == pytest.approx([0.072, 0.144], rel=1e-9)
    assert "area_over_5MPa_error" not in interface
    record = mantle.read(tmp_path / "out").step_record
    assert record["lower_upper area_over_1MPa [mm^2]"][-1] == pytest.approx(16, rel=1e-9)
    assert not any("5MPa" in name for name in record)
    lines = output.splitlines()
    title = next(k for k, line in enumerate(lines) if line.startswith("interface"))
    assert lines[title].endswith(" over 1 MPa  area over 5MPa")
    assert lines[title + 1].split()[-2:] == ["mm^2", "mm^2"]
    assert lines[title + 2].split()[-2:] == ["16.0", "0.00"]
    assert any(line.startswith("upper") and line.endswith("0.1440") for line in lines)


@pytest.mark.slow
def test_quantities_from_outside_is_measured_by_a_study(tmp_path: Path) -> None:
    (tmp_path / "study.yaml").write_text(STUDY)
    done = support.extended(
        tmp_path, EXTENSION, PRESSED, "study", "study.yaml", "-o", "out", "--cores", "1"
    )
    assert done.returncode == 0, done.stdout + done.stderr
    record = json.loads((tmp_path / "out" / "study.json").read_text())["quantities"]
    for name, unit in (("lower_upper.area_over_1MPa", "mm^2"), ("upper.strain_energy", "N mm")):
        assert record[name]["unit"] == unit
        assert [p["error"] < 1e-9 for p in record[name]["points"]] == [True, True]


def test_quantities_from_outside_is_added_once_with_a_unit() -> None:
    with pytest.raises(ValueError, match="already"):
        quantities.add_quantity(quantities.TABLE["interfaces"]["gap_max"])
    with pytest.raises(ValueError, match="unit"):
        quantities.add_quantity(quantities.Quantity("interfaces", "length", "furlong"))
    with pytest.raises(ValueError, match="interfaces, stem, bonds, probes have `step_record`"):
        quantities.add_quantity(quantities.Quantity("regions", "length", "mm", step_record=True))
