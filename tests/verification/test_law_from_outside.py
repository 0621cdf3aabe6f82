"""A law of an interface, a load and a number that another package adds, without touching a file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import mantle
from tests import support

# All that it takes: its keys in YAML and its formula.
LAYER = '''
from typing import Literal
from mantle import Traction
from app.schema.units import PositiveStiffness


class ElasticLayer(Traction):
    """A thin elastic layer: traction = stiffness times the displacement between its sides."""

    kind: Literal["elastic_layer"] = "elastic_layer"
    stiffness: PositiveStiffness
    """Traction per displacement."""

    def traction(self, gap, normals, history):
        return self.stiffness * gap
'''

# Two blocks of 2 mm on each other, and a shear and a pull on top.
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
  lower_upper: {kind: elastic_layer, stiffness: 50 MPa/mm}
supports: {base: {kind: fixed, boundary: bottom}}
loads: {pull: {kind: pressure, boundary: top, pressure: -3 MPa}}
"""


def test_a_law_from_outside_is_solved_and_written(tmp_path: Path) -> None:
    """A layer in tension: the gap is σ/k, whatever the blocks do; from YAML to the fields."""
    done = support.extended(tmp_path, LAYER, CASE, "run", "case.yaml", "-o", "out")
    assert done.returncode == 0, done.stdout + done.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    found = summary["interfaces"]["lower_upper"]
    assert found["gap_mean"] == pytest.approx(3 / 50, rel=1e-9)
    assert found["gap_max"] == pytest.approx(3 / 50, rel=1e-9)
    assert found["pressure_mean"] == pytest.approx(-3, rel=1e-9)
    assert found["shear_max"] == pytest.approx(0, abs=1e-9)
    assert summary["balance"]["energy"] < 1e-9
    # The equations are linear, and a layer holds what it joins.
    assert summary["solver"]["newton_iterations"] <= 2
    import h5py

    with h5py.File(tmp_path / "out" / "fields.vtkhdf") as file:
        names: list[str] = []
        file.visit(names.append)
        gap = next(name for name in names if name.endswith("gap"))
        assert file[gap][...].max() == pytest.approx(3 / 50, rel=1e-6)


def test_a_law_from_outside_is_checked_as_the_others(tmp_path: Path) -> None:
    done = support.extended(
        tmp_path, LAYER, CASE.replace("50 MPa/mm", "50 MPa"), "check", "case.yaml"
    )
    assert done.returncode == 2
    assert "interfaces.lower_upper.stiffness" in done.stderr
    done = support.extended(
        tmp_path, LAYER, CASE.replace("elastic_layer", "elastic_layers"), "check", "case.yaml"
    )
    assert done.returncode == 2
    assert "bonded, contact, penalty, elastic_layer" in done.stderr
    done = support.extended(tmp_path, LAYER, CASE, "check", "case.yaml")
    assert done.returncode == 0 and "elastic_layer" in done.stdout


# A layer that the largest opening so far softens: history at each point.
WORN = '''
from typing import Literal
from ufl import conditional, dot, gt, max_value
from mantle import Traction
from app.schema.units import Length, PositiveStiffness


class WornLayer(Traction):
    """A layer whose stiffness falls with the largest opening so far."""

    history = {"most": ()}

    kind: Literal["worn_layer"] = "worn_layer"
    stiffness: PositiveStiffness
    """Traction per displacement at first."""
    length: Length
    """Opening at which half of it is left."""

    def traction(self, gap, normals, history):
        return self.stiffness / (1 + self._most(gap, normals, history) / self.length) * gap

    def remembered(self, gap, normals, history):
        return {"most": self._most(gap, normals, history)}

    def status(self, gap, normals, history):
        return conditional(gt(self._most(gap, normals, history), self.length / 4), 3, 1)

    def _most(self, gap, normals, history):
        return max_value(history["most"], dot(gap, normals[0]))
'''


def test_a_law_remembers(tmp_path: Path) -> None:
    """Loading gives d1 = σ1/(k - σ1/l), unloading to σ2 on the worn line d2 = σ2 (1 + d1/l)/k."""
    k, length, high, low = 50.0, 0.2, 3.0, 1.0
    case = CASE.replace("elastic_layer, stiffness", "worn_layer, length: 0.2 mm, stiffness")
    case = case.replace("-3 MPa}", "-3 MPa, history: [1, 0.3333333333333333]}")
    case += "stages: [{name: load, increments: 2}, {name: unload, increments: 2}]\n"
    done = support.extended(tmp_path, WORN, case, "run", "case.yaml", "-o", "out")
    assert done.returncode == 0, done.stdout + done.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    most = high / (k - high / length)
    found = summary["interfaces"]["lower_upper"]["gap_mean"]
    assert found == pytest.approx(low * (1 + most / length) / k, rel=1e-8)
    fields = mantle.read(tmp_path / "out").fields
    assert fields.at_interface("lower_upper", "most").max() == pytest.approx(most, rel=1e-8)
    assert set(fields.at_interface("lower_upper", "status")) == {-1, 3}


# A traction over a boundary, which no load of the program is.
WIND = '''
from typing import Literal
from mantle import Load
from app.schema.units import Stress


class Wind(Load):
    """A uniform shear along x."""

    kind: Literal["wind"] = "wind"
    boundary: str
    """Boundary of the geometry."""
    shear: Stress
    """Traction along x."""

    def work(self, v, on):
        ds = on.ds(self.boundary)
        return 0 if ds is None else on.constant(self.shear) * v[0] * ds
'''


def test_a_load_from_outside_does_work(tmp_path: Path) -> None:
    """The shear of the layer is that of the load, and the balances have its work."""
    program = LAYER + WIND
    case = CASE.replace("kind: pressure", "kind: wind").replace("pressure: -3", "shear: 3")
    done = support.extended(tmp_path, program, case, "run", "case.yaml", "-o", "out")
    assert done.returncode == 0, done.stdout + done.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    found = summary["interfaces"]["lower_upper"]
    assert found["shear_mean"] == pytest.approx(3, rel=0.05)
    assert abs(found["force"][0]) == pytest.approx(3 * 16, rel=1e-9)
    assert all(summary["balance"][name] < 1e-9 for name in ("force", "moment", "energy"))
