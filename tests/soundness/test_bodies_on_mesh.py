"""Bodies on a mesh, and the interfaces that join them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from app.soundness import well_posedness
from app.soundness.bodies_on_mesh import gaps_of, pieces_of_groups
from tests import support
from tests.soundness.judged import TWO, judged
from tests.support import build


def test_bodies_on_mesh_only_bonded_interfaces_join_bodies() -> None:
    """A new kind of law that can open is no bond. One that cannot open is a bond."""
    case = support.case(TWO)
    parts = well_posedness.mesh_parts(case, build(case))
    law = SimpleNamespace(can_open=True, gap_field=lambda *_: lambda x: np.full(len(x), 0.1))
    opens = case.model_copy(update={"interfaces": {"bone_metal": law}})
    assert len(pieces_of_groups(opens, parts)) == 2
    assert np.allclose(gaps_of(opens, parts)["bone_metal"], 0.1)
    holds = case.model_copy(update={"interfaces": {"bone_metal": SimpleNamespace(can_open=False)}})
    assert len(pieces_of_groups(holds, parts)) == 1


FRICTIONLESS = "interfaces.bone_metal={kind: contact, friction_coefficient: 0}"
GLUE = (
    "interfaces.bone_metal={kind: cohesive, friction_coefficient: 0, stiffness: 1000 MPa/mm, "
    "tensile_strength: 5 MPa, shear_strength: 5 MPa, tensile_energy: 0.1 N/mm, "
    "shear_energy: 0.1 N/mm}"
)
ZONE = "interfaces.bone_metal.zones={{a: {{above: {} mm, friction_coefficient: 0.5}}}}"


@pytest.mark.parametrize(
    ("changes", "smooth"),
    [
        ([FRICTIONLESS], "contact on 'bone_metal' has no friction"),
        # The interface is at z = 5 mm: a zone above it has no part of it.
        ([FRICTIONLESS, ZONE.format(6)], "contact on 'bone_metal' has no friction"),
        ([FRICTIONLESS, ZONE.format(4)], None),
        ([GLUE], None),
        ([GLUE, "interfaces.bone_metal.unbonded=0.5"], None),
        ([GLUE, "interfaces.bone_metal.unbonded=1"], "contact on 'bone_metal' has no friction"),
    ],
)
def test_bodies_on_mesh_slide_where_neither_friction_nor_a_bond_holds_them(
    changes: list[str], smooth: str | None
) -> None:
    notes = [n for n in judged(TWO, *changes) if "friction hardly holds" in n]
    assert [smooth in n for n in notes] == [True] if smooth else notes == []
