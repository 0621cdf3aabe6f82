"""Steps that end a run: bodies that nothing holds."""

from __future__ import annotations

import pytest

from app.errors import ConvergenceError
from tests import support

PLUG = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
           length: 30 mm}
mesh: {order: 1, size: 4 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0}
supports:
  outer: {kind: fixed, boundary: bone_surface}
loads:
  push: {kind: force, boundary: stem_top, force: [0 N, 0 N, -1800 N]}
"""


def test_a_body_held_by_the_facets_alone_is_no_answer() -> None:
    """A straight frictionless stem slides out; the facets of its mesh must not pass for a hold."""
    with pytest.raises(ConvergenceError, match=r"interface 'stem_cement'|body 'stem'"):
        support.solve(PLUG)


def test_a_lifted_body_is_named() -> None:
    """A block pulled off its base is free, and the message says which."""
    stack = """
geometry: {kind: blocks, blocks: [{name: base, size: [10 mm, 10 mm, 5 mm]},
                                  {name: lid, size: [10 mm, 10 mm, 5 mm]}]}
mesh: {order: 1, size: 4 mm}
regions:
  base: {youngs_modulus: 10 GPa, poisson_ratio: 0.3}
  lid: {youngs_modulus: 2 GPa, poisson_ratio: 0.3}
interfaces:
  base_lid: {kind: contact, friction_coefficient: 0.3}
supports:
  floor: {kind: fixed, boundary: bottom}
loads:
  pull: {kind: force, boundary: top, force: [0 N, 0 N, 500 N]}
"""
    with pytest.raises(ConvergenceError, match="nothing holds body 'lid'"):
        support.solve(stack)
