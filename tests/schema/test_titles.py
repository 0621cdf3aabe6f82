"""Titles of cases of which something varies."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.campaigns.runs import Job, runs_of
from app.case import sweep as sweep_file
from app.case.case import dump, load
from tests.support import CONFIGS

STANCE = CONFIGS / "stance.yaml"
TITLE = "Single-limb stance, titanium stem, 4 mm mantle"
FRICTION = "interfaces.stem_cement.friction_coefficient=0.1"


@pytest.mark.parametrize(
    ("overrides", "changed"),
    [
        ([], ""),
        (["geometry.cement_thickness=2 mm"], "cement_thickness 2 mm"),
        (["mesh={size: 5 mm, order: 1}"], "mesh size 5 mm, order 1"),
        ([FRICTION, "interfaces.cement_bone.friction_coefficient=0.8"],
         "stem_cement.friction_coefficient 0.1, cement_bone.friction_coefficient 0.8"),
        # What changes no result to speak of.
        (["output.every=2", "solver.tolerance=1e-9"], ""),
    ],
)  # fmt: skip
def test_a_title_names_what_is_changed(overrides: list[str], changed: str) -> None:
    title = load(STANCE, overrides).config.title
    assert title == (f"{TITLE}; changed: {changed}" if changed else TITLE)


def test_a_title_that_is_given_stays() -> None:
    case = load(STANCE, ["title=Thin", "geometry.cement_thickness=2 mm"]).config
    assert case.title == "Thin"


def test_a_resolved_case_keeps_its_title(tmp_path: Path) -> None:
    """The case beside the results is read back without the options."""
    case = load(STANCE, ["geometry.cement_thickness=2 mm"]).config
    path = tmp_path / "case.yaml"
    path.write_text(dump(case))
    assert load(path).config.title == case.title


def test_titles_of_variations_and_sweeps_tell_them_apart(tmp_path: Path) -> None:
    text = STANCE.read_text() + "\nvariations: {rough: {interfaces.*.friction_coefficient: 1.5}}\n"
    (tmp_path / "stance.yaml").write_text(text)
    (rough,) = load(tmp_path / "stance.yaml").variations()
    assert rough.case.title == (
        f"{TITLE}; changed: stem_cement.friction_coefficient 1.5, "
        "cement_bone.friction_coefficient 1.5"
    )
    path = tmp_path / "sweep.yaml"
    path.write_text("base: stance.yaml\ngrid: {geometry.cement_thickness: [2 mm, 3 mm]}\n")
    _, planned = sweep_file.read(path)
    assert [p.case.title for p in planned] == [
        f"{TITLE}; changed: cement_thickness {t} mm" for t in (2, 3)
    ]


def test_a_title_makes_no_other_run(tmp_path: Path) -> None:
    """A value that is the file's own, given as an option, is the same case."""
    own = ("geometry.cement_thickness=4 mm",)
    jobs = [Job("a", STANCE), Job("b", STANCE, own)]
    one, two = runs_of(jobs, tmp_path, 1)
    assert one.id == two.id
