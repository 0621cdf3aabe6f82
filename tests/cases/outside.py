"""A layer whose law, load or quantities are in a user's package."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests import support
from tests.cases.blocks import HALVES

# All that it takes: its keys in YAML and its formula.
LAYER = '''
from typing import Literal
from mantle import Traction
from app.laws.values import StiffnessField


class ElasticLayer(Traction):
    """A thin elastic layer: traction = stiffness times the displacement between its sides."""

    kind: Literal["elastic_layer"] = "elastic_layer"
    stiffness: StiffnessField
    """Traction per displacement."""

    def traction(self, point):
        return self.stiffness * point.gap_vector
'''

# Two blocks of 2 mm on each other, and a shear and a pull on top.
CASE = f"""\
{HALVES}interfaces:
  lower_upper: {{kind: elastic_layer, stiffness: 50 MPa/mm}}
supports: {{base: {{kind: fixed, boundary: bottom}}}}
loads: {{pull: {{kind: pressure, boundary: top, pressure: -3 MPa}}}}
"""


def run(folder: Path, program: str, text: str, *more: str) -> tuple[dict[str, Any], str]:
    """Run a case with a package of the user's: its summary, and its output."""
    done = support.extended(folder, program, text, "run", "case.yaml", "-o", "out", *more)
    assert done.returncode == 0, done.stdout + done.stderr
    return support.summary(folder / "out"), done.stdout
