"""Compiled laws: which files define them; where they have friction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.laws.contact_laws import Contact
from app.laws.traction_laws import Traction
from app.mechanics import point_laws
from forms.contact import STICK
from tests import support

BLOCKS = f"""{support.TWO_BLOCKS}regions:
  lower: {{youngs_modulus: 1000 MPa, poisson_ratio: 0.3}}
  upper: {{youngs_modulus: 500 MPa, poisson_ratio: 0.3}}
supports:
  floor: {{kind: fixed, boundary: bottom}}
"""


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


def test_point_laws_have_friction_by_point() -> None:
    """A block slides freely on a zone without friction, whatever the interface has elsewhere."""
    law = "interfaces.lower_upper={{kind: contact, friction_coefficient: {}, zones: {{all: {}}}}}"
    found = {}
    for friction, zone in ((0.3, 0.0), (0.0, 0.3)):
        zone_text = f"{{above: 0 mm, friction_coefficient: {zone}}}"
        case = support.case(BLOCKS, law.format(friction, zone_text))
        contact = support.assemble(case)[0].contact
        assert contact is not None
        np.testing.assert_array_equal(contact.laws.friction_coefficient, zone)
        rest = np.zeros((len(contact.local), 3))
        forces = replace(contact.evaluate(rest, rest), status=np.full(len(rest), STICK))
        found[zone] = contact.unresisted_motions(forces).shape[1]
    assert found == {0.0: 3, 0.3: 0}


@pytest.mark.parametrize("factor", [0.01, 1.0, 100.0])
def test_point_laws_augmentation_is_at_most_the_stiffness_of_a_layer(factor: float) -> None:
    """Remedies scale it; above that stiffness a larger force would have a smaller multiplier."""
    law = "interfaces.lower_upper={kind: contact, friction_coefficient: 0.3}"
    layer = "interfaces.lower_upper.elastic_layer={tangential: 50 MPa/mm}"
    contact = support.assemble(support.case(BLOCKS, law, layer))[0].contact
    assert contact is not None
    laws = contact.laws
    expected = np.minimum(factor * laws.unscaled_augmentation, 50.0)
    laws.scale_augmentation(factor)
    np.testing.assert_allclose(laws.augmentation, expected)
    assert np.linalg.eigvalsh(laws.multiplier_share).min() > -1e-12
