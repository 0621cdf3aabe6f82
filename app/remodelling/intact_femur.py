"""Load of bone before the operation, carried from the mesh of an intact femur to another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.case.case import Case, load_case
from app.foundation.arrays import Floats
from app.foundation.errors import ConvergenceError, InputError
from app.mechanics.body_forms import BodyForms
from app.remodelling.bone import BoneMass
from app.remodelling.laws import Remodelling
from app.remodelling.stimulus import Stimulus
from app.scene.scene import Stage
from app.simulation.model import Model
from meshes import location

# Number of cells in which a point is searched: those with the nearest centres.
MAX_CANDIDATE_CELLS = 32


def load_cases(law: Remodelling, stages: Sequence[Stage]) -> list[int]:
    """Numbers of the stages that are load cases."""
    stage_names = [stage.name for stage in stages]
    return [stage_names.index(name) for name in law.load_cases]


def stimulus_before(law: Remodelling, model: Model, target_forms: BodyForms) -> Floats:
    """Stimulus of the intact femur at the vertices of a model (n, r) [J/g]; collective."""
    intact = model.separate_model(
        intact_case(law, model.case, target_forms.density_regions), "intact femur"
    )
    loads, bone = intact.analysis.load_stepper(), intact.records["bone"]
    assert loads is not None and isinstance(bone, BoneMass)
    stages = intact.scene.stages
    cases = [(k, k + 1.0) for k in load_cases(law, stages)]
    stimulus = Stimulus(law, bone, loads).of(cases)
    if stimulus is None:
        message = "a load case of the intact femur does not converge"
        raise ConvergenceError(f"remodelling.intact: {message}")
    return interpolate_stimulus(stimulus, bone.forms, target_forms)


def intact_case(law: Remodelling, operated: Case, regions: tuple[str, ...]) -> Case:
    """Intact case with the remodelling law, regions and mesh keys of the operated one.

    Raises:
        InputError: It cannot be read, or lacks a region or a load case.
    """
    assert law.intact is not None
    case = load_case(law.intact).config
    existing_names = {"region": [*case.regions], "stage": [stage.name for stage in case.stages]}
    for kind, needed_names in (("region", regions), ("stage", law.load_cases)):
        missing = [name for name in needed_names if name not in existing_names[kind]]
        if missing:
            message = (
                f"has no {kind} {', '.join(missing)}; it has {', '.join(existing_names[kind])}"
            )
            raise InputError(f"remodelling.intact: {law.intact} {message}")
    law = law.model_copy(update={"regions": regions})
    return case.model_copy(update={"remodelling": law, "mesh": operated.mesh, "variations": {}})


def interpolate_stimulus(stimulus: Floats, forms: BodyForms, target_forms: BodyForms) -> Floats:
    """Interpolate a stimulus to the vertices of other forms (n, r) [J/g]; collective.

    Its columns are the regions in the order of their forms, which may differ.
    """
    x, target_points = (
        body_forms.scalars.tabulate_dof_coordinates() for body_forms in (forms, target_forms)
    )
    columns = []
    for region in target_forms.density_regions:
        values = stimulus[:, forms.density_regions.index(region)]
        vertices = forms.vertices(region)
        corners, corner_values = (forms.mesh.comm.allgather(v[vertices]) for v in (x, values))
        columns.append(
            values_in_nearest_cells(
                np.concatenate(corners), np.concatenate(corner_values), target_points
            )
        )
    return np.column_stack(columns)


def values_in_nearest_cells(corners: Floats, values: Floats, x: Floats) -> Floats:
    """Values at points (n, 3), linear in cells of vertices (m, 4, 3) with values (m, 4).

    A point outside all cells has a value on the surface of the nearest cell: its negative
    barycentric coordinates there are set to zero.
    """
    from scipy.spatial import cKDTree  # 0.1 s, which most runs do without

    neighbours = min(MAX_CANDIDATE_CELLS, len(corners))
    cells = cKDTree(corners.mean(axis=1)).query(x, neighbours)[1].reshape(len(x), neighbours)
    barycentric = location.barycentric_coordinates(corners[cells], x[:, None])
    best_cells = np.arange(len(x)), barycentric.min(axis=2).argmax(axis=1)
    best_barycentric = np.maximum(barycentric[best_cells], 0.0)
    return np.asarray(
        (best_barycentric * values[cells[best_cells]]).sum(axis=1) / best_barycentric.sum(axis=1)
    )
