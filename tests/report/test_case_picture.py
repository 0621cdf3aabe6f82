"""The picture of a case: places of arrows, texts, and labels without overlap."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Text

from app.case.case import load_case
from app.plots import figures, surface_views
from app.report import case_picture
from app.system import folders
from meshes import build
from tests import support
from tests.patient.bones import moved, parametric_femur, write

CASES = {
    "stance.yaml": "10mm",
    "blocks.yaml": "2.5mm",
    "cylinders.yaml": "4mm",
    "cure.yaml": "10mm",
}


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The figures of a test."""
    made_figures: list[Any] = []
    new = figures.new

    def recorded(*size: float) -> Any:
        made_figures.append(new(*size))
        return made_figures[-1]

    monkeypatch.setattr(figures, "new", recorded)
    return made_figures


@pytest.mark.parametrize("name", CASES)
def test_case_picture_labels_do_not_overlap(name: str, tmp_path: Path, made: list[Any]) -> None:
    case = load_case(support.CONFIGS / name, [f"mesh.size={CASES[name]}"]).config
    data = build(case.geometry, case.mesh, folders.cache("meshes"))
    case_picture.draw(case, data, tmp_path / "case.png")
    texts = [t for ax in made[0].axes for t in ax.texts if t.get_text()] + made[0].texts
    words = {t.get_text() for t in texts}
    boxes = [Text.get_window_extent(t) for t in texts if t.get_text()]  # without arrows
    width, height = made[0].bbox.size
    for box in boxes:
        assert box.x0 >= 0 and box.x1 <= width and box.y0 >= 0 and box.y1 <= height
    boxes += [legend.get_window_extent() for legend in made[0].legends]
    assert not [(a, b) for a, b in combinations(boxes, 2) if a.overlaps(b)]
    if name == "stance.yaml":
        assert {"hip\n1,800 N", "psoas\n107 N", "shaft\nfixed"} <= words
        # Every text is in one half, so that a narrow screen shows one below the other.
        assert all(box.x1 <= width / 2 or box.x0 >= width / 2 for box in boxes)
        heads = [t.xy for t in made[0].axes[0].texts if getattr(t, "arrow_patch", None)]
        assert [h for h in heads if h == pytest.approx((43, 54))]  # of the hip: the centre
    if name == "blocks.yaml":
        assert {"press\n2 MPa", "floor\nroller, axis z"} <= words
        ((_, places, each),) = case_picture._forces(case, data)
        assert places[:, 2] == pytest.approx(15) and each == pytest.approx(
            np.tile([0, 0, -200], (len(each), 1))
        )


def test_case_picture_long_title_and_legend_fit(tmp_path: Path, made: list[Any]) -> None:
    """A title of many lines is inside the picture. A legend of six lines covers no axis."""
    case = load_case(
        support.CONFIGS / "blocks.yaml", ["mesh.size=4mm", f"title={'many words of a title ' * 20}"]
    ).config
    data = build(case.geometry, case.mesh, folders.cache("meshes"))
    more = {f"part_{k}": 100 + k for k in range(9)}
    case_picture.draw(case, replace(data, regions=data.regions | more), tmp_path / "case.png")
    (figure,) = made
    assert [len(legend.get_texts()) for legend in figure.legends] == [12, 4]
    title = figure.texts[0]
    assert title.get_text().count("\n") > 3 and title.get_window_extent().x0 >= 0
    boxes = [Text.get_window_extent(t) for t in figure.texts if t.get_text()]
    boxes += [Text.get_window_extent(t) for ax in figure.axes for t in ax.texts if t.get_text()]
    boxes += [legend.get_window_extent() for legend in figure.legends]
    _, height = figure.bbox.size
    assert all(box.y0 >= 0 and box.y1 <= height for box in boxes)
    assert not [(a, b) for a, b in combinations(boxes, 2) if a.overlaps(b)]


def test_case_picture_legend_has_the_friction_of_zones(tmp_path: Path, made: list[Any]) -> None:
    zones = "interfaces.stem_bone.zones={half_coated: {above: 80 mm, friction_coefficient: 0.6}}"
    case = load_case(support.CONFIGS / "pressed.yaml", ["mesh.size=12 mm", zones]).config
    data = build(case.geometry, case.mesh, folders.cache("meshes"))
    case_picture.draw(case, data, tmp_path / "case.png")
    legends = [text.get_text() for legend in made[0].legends for text in legend.get_texts()]
    assert any(text.endswith(", half coated 0.6") for text in legends)


def test_case_picture_of_a_right_femur_says_that_it_is_mirrored(
    tmp_path: Path, made: list[Any]
) -> None:
    mirror = np.diag([-1.0, 1.0, 1.0])
    for name, matrix in (("left", np.eye(3)), ("right", mirror)):
        write(tmp_path / f"{name}.stl", moved(parametric_femur(), matrix, np.zeros(3)))
        path = tmp_path / f"{name}.yaml"
        path.write_text(
            "base: stance\nmesh: {size: 12 mm, order: 1}\n"
            "geometry: {kind: patient, bone: {surface: "
            f"{name}.stl, unit: mm}}}}\nloads: {{library: one_leg_stance}}\n"
        )
        case = load_case(path).config
        data = build(case.geometry, case.mesh, folders.cache("meshes"))
        case_picture.draw(case, data, tmp_path / "case.png")
        assert case.geometry.is_mirrored == (name == "right")
        assert ("mirrored" in made[-1].texts[0].get_text()) == (name == "right")
        surface_views.draw_interfaces(data, tmp_path / "a.png", title="a right femur, mirrored")
        assert made[-1]._suptitle.get_text() == "a right femur, mirrored"
        edges = [text.get_text() for legend in made[-1].legends for text in legend.get_texts()]
        assert edges == ["on cortical bone"]
