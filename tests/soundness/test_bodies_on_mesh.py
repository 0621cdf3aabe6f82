"""Bodies on a mesh, and the interfaces that join them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from app.soundness import well_posedness
from app.soundness.bodies_on_mesh import gaps_of, pieces_of_groups
from tests import support
from tests.soundness.judged import TWO
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
