"""Materials with random constants: accepted if the stiffness is positive definite."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from app.laws.materials import TransverselyIsotropic
from tests.cases.laws import compliance

# ------------------------------------------------------------------------------------ units


# -------------------------------------------------------------------------------- materials


ratios = st.floats(-1.5, 1.5)
moduli = st.floats(0.1, 10.0)


@given(moduli, moduli, ratios, ratios, moduli)
def test_materials_accepted_iff_positive_definite(
    e_l: float, e_t: float, nu_l: float, nu_t: float, mu_l: float
) -> None:
    eigenvalues = np.linalg.eigvalsh(compliance(e_l, e_t, nu_l, nu_t, mu_l))
    if abs(eigenvalues).min() < 1e-9 * abs(eigenvalues).max():
        return  # on the limit rounding decides
    values = {
        "kind": "transversely_isotropic",
        "axial_youngs_modulus": f"{e_l!r} GPa",
        "transverse_youngs_modulus": f"{e_t!r} GPa",
        "axial_poisson_ratio": nu_l,
        "transverse_poisson_ratio": nu_t,
        "axial_shear_modulus": f"{mu_l!r} GPa",
    }
    if eigenvalues.min() > 0.0:
        TransverselyIsotropic.model_validate(values)
    else:
        with pytest.raises(ValidationError, match=r"not positive definite|must be"):
            TransverselyIsotropic.model_validate(values)
