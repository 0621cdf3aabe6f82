"""Rim, tip and neck are reported apart; with them nothing is lost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from app.results.interface_numbers import ContactSamples
from app.results.stresses import Stresses
from app.results.surface_parts import Surface
from tests import support

# A block pressed by 1 um on one of 2 mm without Poisson's ratio: 0.05 MPa on 16 mm2.
PRESSED = """
geometry: {kind: blocks, blocks: [{name: stem, size: [4 mm, 4 mm, 2 mm]},
                                  {name: upper, size: [4 mm, 4 mm, 1 mm]}]}
mesh: {order: 1, size: 0.5 mm, far_size: 1 mm}
regions: {stem: {youngs_modulus: 100 MPa, poisson_ratio: 0}, upper: {rigid: true}}
interfaces: {stem_upper: {kind: contact, friction_coefficient: 0}}
supports: {floor: {kind: fixed, boundary: bottom}, hand: {kind: displacement, boundary: top,
                                                          x: 0 mm, y: 0 mm, z: -1 um}}
"""
# Where y < 1 mm is the tip, and of what is left where x < 1 mm the rim [mm2].
AREAS = {"tip": 4.0, "rim": 3.0, "": 9.0}


@pytest.fixture(scope="module")
def pressed() -> support.Solved:
    return support.solve(PRESSED)


def divided(solved: support.Solved) -> tuple[Surface, dict[str, Any]]:
    """The interface in its parts, and its numbers."""
    contact = solved.problem.contact
    assert contact is not None
    x, y, _ = contact.points.surface.x.T
    surface = Surface(contact.points.surface, 0, {"tip": y - 1.0, "rim": x - 1.0})
    trial = solved.problem.trial(*solved.solver.u_and_q())  # type: ignore[arg-type]
    return surface, ContactSamples(solved.problem, trial, None, [surface]).numbers["stem_upper"]


def test_surface_parts_add_up_to_the_interface(pressed: support.Solved) -> None:
    _, numbers = divided(pressed)
    for part in ("rim", "tip"):
        area = numbers[part]["area"]
        assert area == pytest.approx(AREAS[part], rel=1e-12)
        assert numbers[part]["force"] == pytest.approx([0, 0, 0.05 * area], abs=1e-9)
    whole = sum(part["area"] for part in (numbers, numbers["rim"], numbers["tip"]))
    assert whole == pytest.approx(16.0)
    assert numbers["force"] == pytest.approx([0, 0, 0.05 * 16.0], abs=1e-9)


def test_surface_parts_have_separate_statistics(pressed: support.Solved) -> None:
    """Of the coordinate x, which is 2.5 mm in the mean of what is left."""
    surface, numbers = divided(pressed)
    x = pressed.last.x[:, 0]
    for part, mean, most in (("", 2.5, 4.0), ("rim", 0.5, 1.0), ("tip", 2.0, 4.0)):
        field = surface.field(x, part)
        assert field.area == pytest.approx(AREAS[part], rel=1e-12)
        assert field.mean() == pytest.approx(mean, rel=1e-12)
        assert field.percentile(1.0) == field.maximum()[0] == pytest.approx(most)
    assert min(numbers["gap_max_at"][:2]) >= 1.0 >= numbers["rim"]["gap_max_at"][0]


def test_surface_parts_of_an_undivided_interface(pressed: support.Solved) -> None:
    numbers = pressed.interfaces["stem_upper"]
    assert numbers["area"] == pytest.approx(16.0) and not {"rim", "tip"} & numbers.keys()


def test_surface_parts_neck_is_separate_from_the_stem(
    pressed: support.Solved, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tension by z [MPa]: the neck, above 1 mm, has what is above 1 MPa."""
    stresses = Stresses(pressed.problem, depth=lambda x: 1.0 - x[:, 2])
    z = stresses.points_and_volumes("stem")[0][:, 2]
    monkeypatch.setattr(stresses, "evaluate", lambda _: np.multiply.outer(z, np.diag([0, 0, 1.0])))
    stem = stresses.region("stem")
    assert (
        0.5 < stem["von_mises_p99"] <= stem["von_mises_max"] < 1.0 < stem["neck"]["principal_max"]
    )
    assert stem["volume"] + stem["neck"]["volume"] == pytest.approx(32.0)
    assert stem["neck"]["von_mises_max"] == pytest.approx(z.max())
    assert stem["neck"]["von_mises_max_at"][2] == pytest.approx(z.max())
    without = Stresses(pressed.problem)
    assert "neck" not in without.region("stem")
