"""Numbers whose error can be estimated by an adjoint solution: motions."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator

from app.case import quantities
from app.errors import InputError
from app.schema.section import fail, show

# The mean of slip is none: slip counts in contact alone, so that points that open take it along,
# which a derivative does not see (on the femur it missed an error of 15 %).
OF_INTERFACE = (
    *(f"{motion}_{part}" for motion in ("gap", "motion") for part in ("mean", "p95", "p99")),
    *("slip_p95", "slip_p99"),
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


def share(text: str) -> float:
    """A part of a number, ``2%`` or ``0.02``.

    Raises:
        InputError: It is none between 0 and 1.
    """
    number, percent, rest = text.strip().partition("%")
    try:
        value = float(number) / (100 if percent else 1)
    except ValueError:
        value = -1.0
    if rest or not 0 < value < 1:
        raise InputError(f"--to {text}: not a part of the number; allowed: e.g. 2% or 0.02")
    return value
