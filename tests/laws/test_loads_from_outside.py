"""A load of a user's package."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cases.outside import CASE, LAYER, run

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


def test_loads_from_outside_does_work(tmp_path: Path) -> None:
    """The shear of the layer equals that of the load, and the balances contain its work."""
    case = CASE.replace("kind: pressure", "kind: wind").replace("pressure: -3", "shear: 3")
    summary, _ = run(tmp_path, LAYER + WIND, case)
    interface = summary["interfaces"]["lower_upper"]
    assert interface["shear_mean"] == pytest.approx(3, rel=0.05)
    assert abs(interface["force"][0]) == pytest.approx(3 * 16, rel=1e-9)
    assert all(summary["balance"][name] < 1e-9 for name in ("force", "moment", "energy"))
