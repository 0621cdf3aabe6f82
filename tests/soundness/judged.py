"""Texts of the errors and notes of a case on its mesh."""

from __future__ import annotations

from app.case.case import Case
from app.soundness import well_posedness
from meshes.data import MeshData
from tests import support
from tests.support import build

TWO = """
geometry: {kind: blocks, blocks: [{name: bone, size: [10 mm, 10 mm, 5 mm]},
                                  {name: metal, size: [10 mm, 10 mm, 5 mm]}]}
mesh: {size: 3 mm, order: 1}
regions:
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
  metal: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
interfaces:
  bone_metal: {kind: contact, friction_coefficient: 0.4}
supports:
  floor: {kind: fixed, boundary: bottom}
loads:
  press: {kind: pressure, boundary: top, pressure: 2 MPa}
"""


def judge(case: Case, data: MeshData) -> list[str]:
    """Notes on a case on a mesh."""
    return [
        v.text for v in well_posedness.check_on_mesh(case, well_posedness.mesh_parts(case, data))
    ]


def judged(text: str, *overrides: str) -> list[str]:
    """Notes on a case on its mesh."""
    case = support.case(text, *overrides)
    return judge(case, build(case))
