"""Properties of a case that hold for all inputs, tested with random ones."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from app.case.case import load_case
from app.foundation.errors import InputError
from app.schema.units import Axis
from tests.support import CONFIGS

finite = st.floats(allow_nan=False, allow_infinity=False, width=64)


@given(st.tuples(finite, finite, finite))
def test_case_any_input_directions_have_unit_length(direction: tuple[float, float, float]) -> None:
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
def test_case_any_input_file_is_read_or_refused(
    tmp_path_factory: Any, content: str | bytes
) -> None:
    path = tmp_path_factory.mktemp("case") / "case.yaml"
    raw = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    path.write_bytes(raw)
    with pytest.raises(InputError) as caught:
        load_case(path)
    assert all(line.startswith(str(path)) for line in caught.value.messages)


@given(st.text(max_size=40))
def test_case_any_input_override_is_applied_or_refused(text: str) -> None:
    try:
        load_case(CONFIGS / "blocks.yaml", [text])
    except InputError as error:
        assert all(line.startswith("--set ") for line in error.messages)
