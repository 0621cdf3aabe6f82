"""Numbers whose error can be estimated by an adjoint solution: motions."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator

from mantle.schema import quantities
from mantle.schema.fields import fail, show

OF_INTERFACE = tuple(
    f"{motion}_{part}" for motion in ("gap", "slip", "motion") for part in ("mean", "p95", "p99")
)
OF_STEM = (
    *("subsidence", "retroversion", "varus"),
    *(f"{end}_displacement.{axis}" for end in ("tip", "top") for axis in "xyz"),
)


def _goal(value: object) -> object:
    if not isinstance(value, str):
        fail(f"{show(value)} is not the name of a number, e.g. stem_cement.slip_p99")
    quantities.find(value)
    owner, _, key = value.partition(".")
    if key not in (OF_STEM if owner == "stem" else OF_INTERFACE):
        fail(
            f"{show(value)} is no motion; expected <interface>. with one of "
            f"{', '.join(OF_INTERFACE)}, or stem. with one of {', '.join(OF_STEM)}"
        )
    return value


Goal = Annotated[str, BeforeValidator(_goal)]
