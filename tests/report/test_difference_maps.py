"""Maps of differences between runs on different meshes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import mantle
from app.case.case import read_geometry
from app.plots.maps import Interpolation
from app.report import difference_maps, pictures
from app.report.sweep_results import CONVERGED, SweptCase
from app.report.viewer import interface_fields
from app.results.reading import Run


@pytest.fixture(scope="session")
def coarse(stems: tuple[Run, Run], tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The smooth stem on a coarser mesh."""
    folder = tmp_path_factory.mktemp("coarse") / "coarse"
    size = float(re.sub("[^0-9.]", "", str(stems[0].case["mesh"]["size"])))
    case = mantle.load(stems[0].folder / "case.yaml", **{"mesh.size": f"{1.5 * size} mm"})
    mantle.run(case, folder)
    return Run(folder)


def test_difference_maps_interpolation_is_exact_for_linear_values() -> None:
    """Two triangles of a square have either diagonal. Values off the surface are nan."""
    corners = np.array([[[0, 0], [2, 0], [0, 4]], [[2, 0], [0, 4], [2, 4]]], dtype=float)
    surface = Interpolation(corners, 3 * corners[..., 0] - corners[..., 1] + 5)
    places = np.array([[0.5, 0.5], [1.5, 3.0], [1.0, 2.0]])
    assert surface(places) == pytest.approx(3 * places[:, 0] - places[:, 1] + 5)
    assert np.isnan(surface(np.array([[5.0, 1.0]]))).all()
    assert surface.on_surface(np.array([[1.0, 1.0], [90.0, 1.0]])).tolist() == [True, False]


def test_difference_maps_of_other_meshes(
    stems: tuple[Run, Run], coarse: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fields linear in the height have the difference of both lines, on each mesh."""
    lines = {coarse.folder: (2.0, 7.0), stems[0].folder: (0.5, 1.0)}

    def line(run: Run, _: str) -> np.ndarray:
        slope, start = lines[run.folder]
        return slope * run.points[:, 2] + start

    monkeypatch.setattr(difference_maps, "lengths", line)
    sheets = []
    for run in (stems[0], coarse):
        geometry = read_geometry(run.case, run.folder)
        assert geometry
        name, sides = next(iter(geometry.interface_sides.items()))
        sheet = pictures.sheet(run, geometry.is_around_z, sides, geometry.region_names, name)
        assert sheet
        sheets.append((run, sheet))
    differences = difference_maps._differences(*sheets, name)
    values = differences["slip"] / interface_fields()["slip"][2]
    nodes = np.unique(sheets[0][1].nodes)
    there = np.isfinite(values[nodes])
    assert there.mean() > 0.9
    height = stems[0].points[nodes, 2]
    assert values[nodes][there] == pytest.approx((1.5 * height + 6.0)[there], abs=1e-6)


def test_difference_maps_are_drawn(stems: tuple[Run, Run], coarse: Run, tmp_path: Path) -> None:
    """Each interface has a picture, on other meshes too. Otherwise there is a reason."""
    cases = [(run.folder.name, SweptCase(run.folder.name, run.folder, CONVERGED)) for run in stems]
    other = ("coarse", SweptCase("coarse", coarse.folder, CONVERGED))
    drawn, missing = difference_maps.draw([*cases, other], tmp_path)
    assert drawn
    assert all((tmp_path / figure.name).stat().st_size > 5000 for figure in drawn)
    assert not missing
    empty = tmp_path / "empty"
    empty.mkdir()
    drawn, missing = difference_maps.draw(
        [cases[0], ("e", SweptCase("e", empty, CONVERGED))], tmp_path
    )
    assert not drawn
    assert all(text.startswith("no map of the difference of") for text in missing)
