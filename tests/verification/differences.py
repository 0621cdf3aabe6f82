"""Derivatives of functions by differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

STEP = 1e-3


def slope(f: Callable[[float], Any], x: float, h: float = STEP) -> Any:
    """Central difference of fourth order."""
    return (8 * (f(x + h) - f(x - h)) - f(x + 2 * h) + f(x - 2 * h)) / (12 * h)
