"""Laws of tractions by the gap vector."""

from __future__ import annotations

from app.laws.interface_laws import Frictional
from app.laws.traction_laws import Traction


class _Glue(Frictional, Traction):
    """A law with friction that is not registered: it has no `kind`."""


def test_traction_laws_with_and_without_friction_are_compiled_apart() -> None:
    """Laws of one form share the compiled code of the first: it has friction or has none."""
    plain, rough, rougher = (_Glue(kind="glue", friction_coefficient=μ) for μ in (0.0, 0.3, 0.5))
    assert plain.form != rough.form == rougher.form
