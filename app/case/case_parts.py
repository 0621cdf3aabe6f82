"""The sections of a case, as checks of one against another see them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class CaseParts:
    """The sections of a case; None for one that is missing or invalid by itself.

    Of `time` it matters only whether it is there.
    """

    geometry: Any
    side: Any
    mesh: Any
    regions: Mapping[str, Any] | None
    interfaces: Mapping[str, Any]
    supports: Mapping[str, Any] | None
    loads: Mapping[str, Any]
    heat: Mapping[str, Any]
    time: bool
    output: Any
    stages: Any
