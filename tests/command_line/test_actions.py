"""The commands as functions of Python."""

from __future__ import annotations

from collections.abc import Callable

import pytest

import mantle
from app.foundation.errors import InputError


@pytest.mark.parametrize("function", [mantle.check, mantle.mesh, mantle.run])
def test_actions_name_load_for_a_path(function: Callable[[str], object]) -> None:
    with pytest.raises(InputError, match=r"use mantle\.load\('blocks\.yaml'\)"):
        function("blocks.yaml")
