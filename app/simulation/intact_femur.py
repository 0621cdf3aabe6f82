"""What bone bears before the operation, carried from the mesh of an intact femur to another."""

from __future__ import annotations

from typing import Any

import numpy as np

from app.case.case import Case, load
from app.foundation.arrays import Floats
from app.foundation.errors import ConvergenceError, InputError
from app.mechanics.body_forms import BodyForms
from app.stepping.remodelling import Remodeller

NEAR = 32  # cells in which a point is looked for: those whose centres are nearest


def intact_case(ours: Case, regions: tuple[str, ...]) -> Case:
    """The intact case by its law and mesh, in which the same regions remodel as in ours.

    Raises:
        InputError: It cannot be read, or lacks a region or a load case.
    """
    law: Any = ours.remodelling
    case = load(law.intact).config
    known = {"region": [*case.regions], "stage": [stage.name for stage in case.stages]}
    for what, wanted in (("region", regions), ("stage", law.load_cases)):
        missing = [name for name in wanted if name not in known[what]]
        if missing:
            text = f"has no {what} {', '.join(missing)}; it has {', '.join(known[what])}"
            raise InputError(f"remodelling.intact: {law.intact} {text}")
    law = law.model_copy(update={"regions": regions})
    return case.model_copy(update={"remodelling": law, "mesh": ours.mesh, "variations": {}})


def carried(intact: Remodeller, ours: BodyForms) -> Floats:
    """Stimulus of an intact femur at the vertices of ours (n, r) [J/g]; collective."""
    forms, cases = intact.mechanics, intact.problem.scene.load_cases
    stimulus: Any = intact.stimulus([(k, k + 1.0) for k in cases])
    if stimulus is None:
        raise ConvergenceError("remodelling.intact: a load case of it cannot be solved")
    x, to = (m.scalars.tabulate_dof_coordinates() for m in (forms, ours))
    columns = []
    for region, values in zip(forms.remodels, stimulus.T, strict=True):
        own = forms.vertices(region)
        corners, known = (forms.mesh.comm.allgather(v[own]) for v in (x, values))
        columns.append(interpolated(np.concatenate(corners), np.concatenate(known), to))
    return np.column_stack(columns)


def interpolated(corners: Floats, values: Floats, x: Floats) -> Floats:
    """Values at points (n, 3), linear in cells of vertices (m, 4, 3) with values (m, 4).

    Points outside get the value at a border of the cell in which they would be, if it were larger.
    """
    from scipy.spatial import cKDTree  # 0.1 s, which most runs do without

    near = min(NEAR, len(corners))
    cells = cKDTree(corners.mean(axis=1)).query(x, near)[1].reshape(len(x), near)
    edges = corners[cells, 1:] - corners[cells, :1]
    across = np.linalg.solve(edges.swapaxes(2, 3), (x[:, None] - corners[cells, 0])[..., None])
    shares = np.concatenate([1 - across.sum(axis=2), across[..., 0]], axis=2)
    best = np.arange(len(x)), shares.min(axis=2).argmax(axis=1)
    share = np.maximum(shares[best], 0.0)
    return np.asarray((share * values[cells[best]]).sum(axis=1) / share.sum(axis=1))
