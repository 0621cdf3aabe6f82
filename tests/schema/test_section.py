"""Sections of a case."""

from __future__ import annotations

import numpy as np

from app.schema.section import Section


def test_section_with_cached_arrays_compares_by_fields() -> None:
    """A cache by geometry compares sections that already hold arrays."""

    class Place(Section):
        x: float = 1.0

    one, two, other = Place(), Place(), Place(x=2.0)
    one.__dict__["placement"], two.__dict__["placement"] = np.zeros(3), np.ones(3)
    assert one == two and hash(one) == hash(two)
    assert one != other and one != 1.0
