"""Messages on keys in a wrong section (`app/case/misplaced_keys.py`)."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.case.case import load_case
from app.foundation.errors import InputError
from tests.support import CONFIGS

AN_INTERFACE = "write it below the name of an interface: interfaces.NAME."


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("geometry.friction_coefficient=0.2", f"here; {AN_INTERFACE}friction_coefficient"),
        ("geometry.interference=0.02 mm", f"here; {AN_INTERFACE}interference"),
        ("geometry.mesh={size: 6 mm}", "it is a section of the whole file"),
        ("regions.stem.friction_coefficient=0.3", f"{AN_INTERFACE}friction_coefficient"),
        ("interfaces.stem_cement.youngs_modulus=3 GPa", "below the name of a region: regions.NAME"),
        ("solver.size=3 mm", "write it below 'mesh': mesh.size"),
        ("loads.friction_coefficient=0.2", "If 'friction_coefficient' is meant as a key: write it"),
        ("friction_coefficient=0.2", "unknown key; expected interfaces.NAME.friction_coefficient"),
        # Keys of the same section of another kind, and keys of no section.
        ("geometry.stem_radius=3 mm", "unknown key; allowed: kind, cement_thickness"),
        ("geometry.ream=by", "unknown key; allowed: kind, cement_thickness"),
        ("interfaces.stem_cement.penalty=3 MPa/mm", "unknown key; allowed: kind, conductance"),
        ("mesh.sise=3 mm", "did you mean 'size'?"),
    ],
)
def test_misplaced_keys_are_named_with_their_section(change: str, words: str) -> None:
    with pytest.raises(InputError) as refused:
        load_case(CONFIGS / "stance.yaml", (change,))
    assert any(words in message for message in refused.value.messages)


def test_misplaced_keys_of_an_interface_are_to_be_indented_below_its_name(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text("base: stance\nfriction_coefficient: 0.3\n")
    expected = "unknown key here; indent it below the name of an interface, in 'interfaces'"
    with pytest.raises(InputError, match=f"2:1: friction_coefficient: {expected}"):
        load_case(path)
