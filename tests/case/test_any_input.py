"""Properties of the configuration that hold for all inputs, tried on random ones."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from app.case.case import load
from app.foundation.errors import InputError
from app.laws.materials import TransverselyIsotropic
from app.schema.units import Axis
from tests.cases.laws import compliance
from tests.support import CONFIGS

finite = st.floats(allow_nan=False, allow_infinity=False, width=64)


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


@given(st.tuples(finite, finite, finite))
def test_case_directions_have_unit_length(direction: tuple[float, float, float]) -> None:
    read = TypeAdapter(Axis).validate_python
    if not any(direction):
        with pytest.raises(ValidationError, match="zero vector"):
            read(direction)
        return
    axis = read(direction)
    assert math.hypot(*axis) == pytest.approx(1.0, abs=1e-12)
    assert read(axis) == axis


# ------------------------------------------------------------------------------------ files


@given(st.text(max_size=200) | st.binary(max_size=200))
def test_case_any_file_is_read_or_refused(tmp_path_factory: Any, content: str | bytes) -> None:
    path = tmp_path_factory.mktemp("case") / "case.yaml"
    raw = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    path.write_bytes(raw)
    with pytest.raises(InputError) as caught:
        load(path)
    assert all(line.startswith(str(path)) for line in caught.value.messages)


@given(st.text(max_size=40))
def test_overlay_any_override_is_applied_or_refused(text: str) -> None:
    try:
        load(CONFIGS / "blocks.yaml", [text])
    except InputError as error:
        assert all(line.startswith("--set ") for line in error.messages)
