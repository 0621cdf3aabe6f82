"""Laws of tractions by the gap vector."""

from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from app.laws.interface_laws import Frictional
from app.laws.traction_laws import Cohesive, Traction


class _Glue(Frictional, Traction):
    """A law with friction that is not registered: it has no `kind`."""


def test_traction_laws_with_and_without_friction_are_compiled_apart() -> None:
    """Laws of one form share the compiled code of the first: it has friction or has none."""
    plain, rough, rougher = (_Glue(kind="glue", friction_coefficient=μ) for μ in (0.0, 0.3, 0.5))
    assert plain.form != rough.form == rougher.form


def test_traction_laws_soften_in_mixed_modes() -> None:
    """Softening ends at a larger jump than its onset, in each mode.

    Strengths 1 and 10^0.5 MPa, energies 1 and 10 N/mm: both pure modes allow K = 1 MPa/mm. A mode
    with a share B of shear needs 2 K (1 - 0.9 B) (1 + 9 B^η) > 1.
    """
    keys = {
        "kind": "cohesive",
        "friction_coefficient": 0.3,
        "tensile_strength": "1 MPa",
        "shear_strength": f"{math.sqrt(10)} MPa",
        "tensile_energy": "1 N/mm",
        "shear_energy": "10 N/mm",
        "softening": "exponential",
    }
    least = max(1 / (2 * (1 - 0.9 * B) * (1 + 9 * B**12)) for B in (k / 100 for k in range(101)))
    assert least > 1.2
    Cohesive.model_validate(keys | {"stiffness": "1.0001 MPa/mm", "mixing_exponent": 2})
    Cohesive.model_validate(keys | {"stiffness": f"{1.001 * least} MPa/mm", "mixing_exponent": 12})
    with pytest.raises(ValidationError, match="too soft for a mixed mode with 72% of shear"):
        Cohesive.model_validate(
            keys | {"stiffness": f"{0.999 * least} MPa/mm", "mixing_exponent": 12}
        )
