"""Laws of Young's modulus by density."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from app.laws.densities import DensityLaw, modulus_of_density


def test_densities_at_the_beginning_of_a_range_belong_to_it() -> None:
    ranges = [["0 g/cm^3", "0 MPa", "1 GPa", 1.0], ["0.5 g/cm^3", "0 MPa", "2 GPa", 1.0]]
    law = DensityLaw.model_validate({"density": "ash", "ranges": ranges})
    moduli = modulus_of_density(law, [0.25, 0.5, 1.0])
    np.testing.assert_allclose(moduli, [250.0, 1000.0, 2000.0])


def test_densities_of_ranges_rise() -> None:
    ranges = [["1 g/cm^3", "0 MPa", "3 GPa", 1.0], ["0 g/cm^3", "0 MPa", "2 GPa", 1.0]]
    with pytest.raises(ValidationError, match=r"begins at 0 .*, not above 1 of the range before"):
        DensityLaw.model_validate({"density": "ash", "ranges": ranges})
