"""Compiled laws: which files define them."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.laws.contact_laws import Contact
from app.laws.traction_laws import Traction
from app.mechanics import point_laws


def test_point_laws_are_compiled_again_if_a_formula_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A helper of a formula counts, whatever module has it."""
    helper = tmp_path / "helper.py"
    monkeypatch.setattr(point_laws, "SOURCE_FOLDERS", (*point_laws.SOURCE_FOLDERS, tmp_path))
    law = Contact(friction_coefficient=0.3)
    notes = set()
    for text in ("a = 1", "a = 2"):
        helper.write_text(text)
        notes.add(point_laws._note_file(law, "key"))
    assert len(notes) == 2


def test_point_laws_from_outside_are_always_compiled() -> None:
    """Which files define them is not known.

    The law has no `kind`: other tests in this process read the list of laws.
    """

    class Layer(Traction):
        """A law in a file of a user."""

    assert point_laws._note_file(Layer.model_construct(), "key") is None
