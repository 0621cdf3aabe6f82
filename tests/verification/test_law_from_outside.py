"""A law of a user's package, without a change of the program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mantle
from tests import support
from tests.cases.outside import CASE, LAYER, run


def test_law_from_outside_is_solved_and_written(tmp_path: Path) -> None:
    """A layer in tension has the gap σ/k for any blocks. The test goes from YAML to the fields."""
    summary, _ = run(tmp_path, LAYER, CASE)
    interface = summary["interfaces"]["lower_upper"]
    assert interface["gap_mean"] == pytest.approx(3 / 50, rel=1e-9)
    assert interface["gap_max"] == pytest.approx(3 / 50, rel=1e-9)
    assert interface["pressure_mean"] == pytest.approx(-3, rel=1e-9)
    assert interface["shear_max"] == pytest.approx(0, abs=1e-9)
    assert summary["balance"]["energy"] < 1e-9
    # The equations are linear, and a layer holds what it joins.
    assert summary["solver"]["newton_iterations"] <= 2
    fields = mantle.read(tmp_path / "out").fields
    assert fields.at_interface("lower_upper", "gap").max() == pytest.approx(3 / 50, rel=1e-6)


def test_law_from_outside_constants_vary_in_space(tmp_path: Path) -> None:
    """A rigid block on springs k = 50 (1 + x/8) has its tilt by hand. A negative k is refused."""
    rigid = "upper: {rigid: true, tissue: other}"
    case = CASE.replace("50 MPa/mm", "50 * (1 + x / 8)").replace("size: 2 mm", "size: 1 mm")
    case = case.replace("upper: {youngs_modulus: 1 GPa, poisson_ratio: 0, tissue: other}", rigid)
    summary, _ = run(tmp_path, LAYER, case)
    interface = summary["interfaces"]["lower_upper"]
    assert summary["balance"]["force"] < 1e-9
    # An opening a + b s over s in [-2, 2] mm: force 3 MPa x 16 mm2, no moment.
    at = interface["gap_max_at"][0]  # an edge of the block: the soft one
    s = np.linspace(-2, 2, 5)
    k = 4 * np.array([0.5, 1, 1, 1, 0.5]) * 50 * (1 + (at + 2 + s) / 8)
    a, b = np.linalg.solve([[k.sum(), k @ s], [k @ s, k @ s**2]], [48, 0])
    assert interface["gap_mean"] == pytest.approx(a, rel=2e-3)
    assert interface["gap_max"] == pytest.approx(a - 2 * b, rel=2e-3)
    done = support.extended(
        tmp_path, LAYER, CASE.replace("50 MPa/mm", "50 * (1 - x)"), "run", "case.yaml", "-o", "bad"
    )
    assert done.returncode == 2
    assert "interfaces.lower_upper.stiffness: " in done.stderr and "must be positive" in done.stderr


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (("50 MPa/mm", "50 MPa"), 2, "interfaces.lower_upper.stiffness"),
        (("elastic_layer", "elastic_layers"), 2, "penalty, cohesive, elastic_layer"),
        (("", ""), 0, "elastic_layer"),
    ],
)
def test_law_from_outside_is_checked(
    tmp_path: Path, change: tuple[str, str], code: int, words: str
) -> None:
    done = support.extended(tmp_path, LAYER, CASE.replace(*change), "check", "case.yaml")
    assert done.returncode == code
    assert words in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("program", "place"),
    [("import numpy\nimport nothing_of_this_name\n", ":2"), ("x = (\n", ":1:5")],
)
def test_law_from_outside_import_error_is_named(tmp_path: Path, program: str, place: str) -> None:
    done = support.extended(tmp_path, program, CASE, "check", "case.yaml")
    assert done.returncode == 2
    assert f"own_package.py{place}: MANTLE_EXTENSIONS: 'own_package'" in done.stderr


# A layer that the largest opening so far softens: an internal variable.
WORN = '''
from typing import Literal
from ufl import conditional, dot, gt, max_value
from mantle import Traction
from app.schema.units import Length, PositiveStiffness


class WornLayer(Traction):
    """A layer whose stiffness falls with the largest opening so far."""

    internal_variables = {"most": ()}

    kind: Literal["worn_layer"] = "worn_layer"
    stiffness: PositiveStiffness
    """Traction per displacement at first."""
    length: Length
    """Opening at which half of it is left."""

    def traction(self, point):
        softer = 1 + point.internal_variables["most"] / self.length
        return self.stiffness / softer * point.gap_vector

    def new_internal_variables(self, point):
        opening = dot(point.gap_vector, point.normals[0])
        return {"most": max_value(point.internal_variables["most"], opening)}

    def status(self, point):
        return conditional(gt(point.internal_variables["most"], self.length / 4), 3, 1)
'''


def test_law_from_outside_keeps_internal_variables(tmp_path: Path) -> None:
    """Loading gives d1 = σ1/(k - σ1/l).

    Unloading to σ2 on the damaged line gives d2 = σ2 (1 + d1/l)/k.
    """
    k, length, high, low = 50.0, 0.2, 3.0, 1.0
    case = CASE.replace("elastic_layer, stiffness", "worn_layer, length: 0.2 mm, stiffness")
    case = case.replace("-3 MPa}", "-3 MPa, history: [1, 0.3333333333333333]}")
    case += "stages: [{name: load, increments: 2}, {name: unload, increments: 2}]\n"
    summary, _ = run(tmp_path, WORN, case)
    most = high / (k - high / length)
    gap = summary["interfaces"]["lower_upper"]["gap_mean"]
    assert gap == pytest.approx(low * (1 + most / length) / k, rel=1e-8)
    fields = mantle.read(tmp_path / "out").fields
    assert fields.at_interface("lower_upper", "most").max() == pytest.approx(most, rel=1e-8)
    assert set(fields.at_interface("lower_upper", "status")) == {-1, 3}


# A glue that softens by opening alone, with contact and friction where it is broken.
GLUE = '''
from typing import Literal
from ufl import conditional, dot, ge, gt, max_value, min_value
from mantle import Frictional, Traction
from app.laws.values import FractureEnergyField, StiffnessField, StrengthField


class Glue(Frictional, Traction):
    """Glue that softens linearly with the opening."""

    can_open = True
    internal_variables = {"damage": (), "spent": ()}

    kind: Literal["glue"] = "glue"
    stiffness: StiffnessField
    """Traction per displacement."""
    tensile_strength: StrengthField
    """Largest tension."""
    energy: FractureEnergyField
    """Fracture energy."""

    def new_internal_variables(self, point):
        onset = self.tensile_strength / self.stiffness
        end = 2 * self.energy / self.tensile_strength
        opening = min_value(max_value(dot(point.gap_vector, point.normals[0]), onset), end)
        spent = (opening - onset) / (end - onset)
        before = point.internal_variables["spent"]
        spent = conditional(ge(spent, before - 1e-12), spent, before)
        opening = onset + spent * (end - onset)
        return {"damage": 1 - onset * (1 - spent) / opening, "spent": spent}

    def traction(self, point):
        return (1 - point.internal_variables["damage"]) * self.stiffness * point.gap_vector

    def debonded_share(self, point):
        damage = point.internal_variables["damage"]
        return conditional(gt(point.committed["damage"], 0), damage, 0)

    def stored(self, point):
        square = dot(point.gap_vector, point.gap_vector)
        return (1 - point.internal_variables["damage"]) * self.stiffness * square / 2

    def dissipated(self, point):
        return self.energy * (point.internal_variables["spent"] - point.committed["spent"])
'''
# A soft bar whose end has to go back while the glue breaks (snap-back), then pressed and slid.
TORN = """\
geometry: {kind: blocks, blocks: [{name: lower, size: [4 mm, 4 mm, 4 mm]},
                                  {name: upper, size: [4 mm, 4 mm, 4 mm]}]}
mesh: {order: 1, size: 4 mm}
regions:
  lower: {youngs_modulus: 0.4 GPa, poisson_ratio: 0, tissue: other}
  upper: {youngs_modulus: 0.4 GPa, poisson_ratio: 0, tissue: other}
interfaces:
  lower_upper: {kind: glue, friction_coefficient: 0.3, stiffness: 1.0e+4 MPa/mm,
                tensile_strength: 10 MPa, energy: 0.1 N/mm}
supports:
  base: {kind: fixed, boundary: bottom}
  pull: {kind: displacement, boundary: top, z: 0.4 mm, history: [1, -0.05, -0.05]}
  slide: {kind: displacement, boundary: top, x: 0.1 mm, y: 0 mm, history: [0, 0, 1]}
stages: [{name: pull, increments: 4, fracture_step: 0.1 N mm}, {name: press}, {name: slide}]
solver: {tolerance: 1.0e-12}
"""


def test_law_from_outside_breaks_by_given_energy_then_has_friction(tmp_path: Path) -> None:
    """Traction falls linearly with the used energy, G A in all. Friction μ p remains."""
    summary, _ = run(tmp_path, GLUE, TORN)
    record = mantle.read(tmp_path / "out").step_record
    used = np.asarray(record["lower_upper dissipation [N mm]"])
    stage = np.ceil(np.asarray(record["time [-]"]))
    breaking = (used > 0) & (used < 0.999 * 1.6) & (stage == 1)
    assert breaking.sum() >= 15
    np.testing.assert_allclose(np.diff(used[breaking]), 0.1, rtol=1e-5)
    tension = -np.asarray(record["lower_upper pressure_p95 [MPa]"])[breaking]
    np.testing.assert_allclose(tension, 10 * (1 - used[breaking] / 1.6), rtol=1e-6)
    # The end goes back: stretch of the bars, 8 mm long, and opening of the glue.
    opening = 1e-3 + used[breaking] / 1.6 * (0.02 - 1e-3)
    end = 0.4 * np.asarray(record["time [-]"])[breaking]
    np.testing.assert_allclose(end, tension * 8 / 400 + opening, rtol=1e-6)
    interface = summary["interfaces"]["lower_upper"]
    assert interface["area_broken"] == pytest.approx(16, rel=1e-9)
    pressure = 0.05 * 0.4 * 400 / 8
    assert interface["pressure_mean"] == pytest.approx(pressure, rel=1e-9)
    assert interface["shear_mean"] == pytest.approx(0.3 * pressure, rel=1e-9)
    assert interface["dissipation"] > 1.6 and summary["balance"]["energy"] < 1e-8


# The layer of `elastic_layer` in series with contact, by the slot of a law.
CONTACT_LAYER = '''
from typing import Literal
from ufl import Identity, as_vector, conditional, diff, dot, eq, inner, inv, outer, variable
from ufl.algorithms import expand_derivatives, strip_variables
from mantle import InterfaceLaw
from app.laws.values import StiffnessField
from app.schema.units import NonNegativeNumber
from forms.contact import OPEN, Response, contact_law


class ContactLayer(InterfaceLaw):
    """Contact and friction on an elastic layer."""

    can_open = True
    internal_variables = {"slid": (3,)}

    kind: Literal["contact_layer"] = "contact_layer"
    coefficient: NonNegativeNumber
    """Of friction."""
    normal: StiffnessField
    """Pressure per approach."""
    tangential: StiffnessField
    """Shear per elastic shift."""

    @property
    def spring_stiffness(self):
        return self.normal, self.tangential

    def response(self, at):
        v, old = at.constants, at.internal_variables["slid"]
        gap = variable(at.jump + at.initial_gap)
        across = sum(outer(n, n) for n in at.normals) / len(at.normals)
        K = v["tangential"] * Identity(3) + (v["normal"] - v["tangential"]) * across
        # The trial force K gap, of which friction counts K (gap - old): `contact_law` at no jump.
        none, μ = as_vector([0, 0, 0]), v["coefficient"]
        law = contact_law(K * gap, none, none, K * old, at.S_star, at.normals, μ, 1)
        elastic = inv(K) * law.force
        internal_variables = at.updated({"slid": gap - elastic})
        both = internal_variables["slid"], old
        slid, since = (v - dot(v, at.normals[0]) * at.normals[0] for v in both)
        outputs = {
            "force": law.force,
            "by_jump": expand_derivatives(diff(law.force, gap)),
            "pressures": law.pressures,
            "status": law.status,
            "slip": conditional(eq(law.status, OPEN), 0, 1) * slid,
            "stored": inner(law.force, elastic) / 2,
            "dissipated": inner(law.force, slid - since),
        }
        plain = {name: strip_variables(e) for name, e in outputs.items()}
        internal_variables = {name: strip_variables(e) for name, e in internal_variables.items()}
        return Response(by_multiplier=None, internal_variables=internal_variables, **plain)
'''


def test_law_from_outside_layer_equals_compliance(tmp_path: Path) -> None:
    """Blocks are pressed, pushed until parts slip and open, and pushed back, with equal numbers."""
    assert CONTACT_LAYER.count("\n") <= 60
    push = "{kind: displacement, boundary: top, x: 0.04 mm, y: 0 mm, history: [0, 1, -0.2]}"
    press = "{kind: displacement, boundary: top, z: -0.01 mm, history: [1, 1, 0.4]}"
    stages = "[{name: press}, {name: push, increments: 2}, {name: back, increments: 2}]"
    case = CASE.replace("size: 2 mm}", "size: 1 mm}").partition("loads:")[0]
    case = case.replace("bottom}}", f"bottom}}, push: {push}, press: {press}}}")
    case += f"stages: {stages}\nsolver: {{tolerance: 1.0e-12}}\n"
    layer = "kind: contact_layer, coefficient: 0.3, normal: 150 MPa/mm, "
    layer += "tangential: 130 MPa/mm"
    built_in = "kind: contact, friction_coefficient: 0.3, "
    built_in += "elastic_layer: {normal: 150 MPa/mm, tangential: 130 MPa/mm}"
    runs = []
    for name, law in (("own", layer), ("built_in", built_in)):
        text = case.replace("kind: elastic_layer, stiffness: 50 MPa/mm", law)
        (tmp_path / name).mkdir()
        run(tmp_path / name, CONTACT_LAYER, text)
        runs.append(mantle.read(tmp_path / name / "out"))
    one, two = (r.summary["interfaces"]["lower_upper"] for r in runs)
    assert 0.1 < two["open_fraction"] + two["slip_fraction"] and two["dissipation"] > 0
    for key, value in two.items():
        if not key.endswith("_at") and key not in ("contact_work", "critical_friction"):
            assert one[key] == pytest.approx(value, rel=1e-7, abs=1e-9), key
    for name in ("gap", "slip", "pressure", "shear", "status"):
        maps = [r.fields.at_interface("lower_upper", name) for r in runs]
        assert support.difference(*maps) < 1e-7
