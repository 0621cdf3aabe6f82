"""Common parts of the laws: names, values that vary in space, multipliers that vary in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, Discriminator, PrivateAttr, Tag
from pydantic_core import PydanticCustomError

from app.foundation.errors import InputError
from app.schema.expressions import Varying, values_at_points
from app.schema.section import ITEMS, UNION_TAG, Pair, Section, Text, fail
from app.schema.units import Dimension, Length, NonNegativeInteger, Number, Part, PositiveLength

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from app.foundation.arrays import Bools, Field, Floats

StiffnessField = Annotated[
    float | str, Varying(Dimension("MPa/mm", "a stiffness per area", "100 MPa/mm", above=0.0))
]
StrengthField = Annotated[float | str, Varying(Dimension("MPa", "a strength", "2 MPa", above=0.0))]
FractureEnergyField = Annotated[
    float | str, Varying(Dimension("N/mm", "an energy per area", "100 J/m^2", above=0.0))
]
LengthField = Annotated[float | str, Varying(Dimension("mm", "a length", "0.05 mm"))]
# Largest radial interference [mm]: strains of bone are a few percent.
MOST_INTERFERENCE = 1.0
# Above this bone would be crushed, which is not modelled; docs/howto/cementless.md [mm].
MUCH_INTERFERENCE = 0.1
# Its usual size in bone, as text.
USUAL_INTERFERENCE = "0.01 to 0.02 mm"
_INTERFERENCE = Dimension(
    "mm",
    "a length",
    "0.02 mm",
    at_least=0.0,
    at_most=MOST_INTERFERENCE,
    beyond=f"an interference is radial, and {USUAL_INTERFERENCE} are usual",
    usual=(1e-4, MOST_INTERFERENCE),
    other_units=("um",),
)
INTERFERENCE = Varying(_INTERFERENCE)
GAP = Varying(
    Dimension(
        "mm",
        "a length",
        "0.05 mm",
        at_least=-MOST_INTERFERENCE,
        beyond="a negative gap is a radial interference, and -0.01 to -0.02 mm are usual",
    )
)
GapField = Annotated[float | str, GAP]
# Reliability of values, and their source.
Status = Literal["measured", "assumed", "unverified"] | None
Source = Text | None
# Source of values that were not looked up.
MEMORY = "from memory: check"
# Rounding error of heights of the nodes of a mesh, which may be on the border of a zone [mm].
ROUNDING_OF_HEIGHTS = 1e-6
# Multipliers at the ends of the stages.
LoadHistory = Annotated[tuple[Number, ...], ITEMS] | None
# Pairs of seconds since the start of the run and multiplier.
TimeCourse = Sequence[tuple[float, float]]
Table = tuple[tuple[float, float], ...]


class Patches(Section):
    """Share of an area in randomly placed patches, the same on every mesh."""

    share: Annotated[float, Part()]
    """Expected share of the area. The summary of the run has the actual share."""
    patch: PositiveLength
    """Size of a patch."""
    seed: NonNegativeInteger = 0
    """Seed of the random numbers. The same seed gives the same patches."""

    def __call__(self, x: Floats) -> Floats:
        """1 in patches, 0 elsewhere, at points (n, 3) [mm]: shape (n,)."""
        # Cubes of space, cut by the surface; the shift keeps their faces off planes of meshes.
        shift = (0.6180339887, 0.7548776662, 0.5698402910)
        cubes = np.floor(x / self.patch + shift).astype(np.int64).astype(np.uint64)
        chance: NDArray[np.uint64] = np.full(len(x), self.seed, dtype=np.uint64)
        for cube in cubes.T:  # SplitMix64 (Steele, Lea and Flood 2014)
            chance = (chance ^ cube) + np.uint64(0x9E3779B97F4A7C15)
            chance = (chance ^ (chance >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            chance = (chance ^ (chance >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            chance ^= chance >> np.uint64(31)
        return np.where(chance / 2.0**64 < self.share, 1.0, 0.0)


# Of an area: 30 %, an expression that gives 0 to 1, or patches.
ShareField = Annotated[
    Annotated[float | str, Varying(Part()), Tag(UNION_TAG + "share")]
    | Annotated[Patches, Tag(UNION_TAG + "patches")],
    Discriminator(lambda s: UNION_TAG + ("patches" if isinstance(s, dict | Patches) else "share")),
]


class Named(Section):
    """Base of named parts of a case. The copy in a scene has its name."""

    _name: str = PrivateAttr("")

    @property
    def name(self) -> str:
        """Name in the case file; empty outside a scene."""
        return self._name

    def named(self, name: str, **changes: Any) -> Self:
        """Copy with a name and changed fields."""
        named_copy = self.model_copy(update=changes)
        named_copy._name = name
        return named_copy


class OfRegion(Named):
    """Base of laws that belong to one region. Their name is the region's."""

    @property
    def region(self) -> str:
        """Name of the region."""
        return self._name


def rising(quantity: str) -> Callable[[Table], Table]:
    """Validator: refuse an empty table, or one whose first column does not increase."""

    def check(table: Table) -> Table:
        if not table:
            fail("is empty; expected at least one pair")
        for i, ((value_before, _), (value, _)) in enumerate(pairwise(table)):
            if value <= value_before:
                fail(f"its {quantity} is not above that of the pair before", at=(i + 1,))
        return table

    return check


T = TypeVar("T")
# Interference of a press fit: a length, an expression, or pairs of height on the stem and length.
InterferenceField = Annotated[
    Annotated[float | str, INTERFERENCE, Tag(UNION_TAG + "interference")]
    | Annotated[
        tuple[
            Annotated[tuple[Length, Annotated[float, _INTERFERENCE]], Pair("[80 mm, 0.02 mm]")],
            ...,
        ],
        ITEMS,
        AfterValidator(rising("height")),
        Tag(UNION_TAG + "table"),
    ],
    Discriminator(
        lambda value: UNION_TAG + ("table" if isinstance(value, list | tuple) else "interference")
    ),
]


class StemPlaces(Protocol):
    """Places on the surface of a stem, as a geometry knows them."""

    @property
    def rounded_angle(self) -> float:
        """Angle up to which straight facets at an edge stand for a rounded one [rad]."""

    def height_on_stem(self, x: Floats) -> Floats:
        """Height of points (n, 3) above the stem's tip (n,) [mm]."""

    def on_flanks(self, x: Floats) -> Bools:
        """True at points (n, 3) that are neither on the stem's end nor on its shoulder (n,)."""

    def off_bone(self, interface: str, x: Floats) -> Bools:
        """True at points (n, 3) of an interface where bone never touches the stem (n,)."""


class NoStem:
    """Places of bodies without a stem: heights are z."""

    rounded_angle = 0.0

    def height_on_stem(self, x: Floats) -> Floats:
        """The coordinate z (n,) [mm]."""
        return x[:, 2]

    def on_flanks(self, x: Floats) -> Bools:
        """True everywhere."""
        return np.ones(len(x), dtype=bool)

    def off_bone(self, interface: str, x: Floats) -> Bools:
        """True nowhere."""
        return np.zeros(len(x), dtype=bool)


# Pairs that begin with a time.
OverTime = Annotated[tuple[T, ...], ITEMS, AfterValidator(rising("time"))]


def field(key: str, value: float | str | Field, mark: Varying | None = None) -> Field:
    """A value or an expression of a key as a function of points (n, 3): shape (n,).

    Values are within the bounds of a mark, if any.
    """
    if callable(value):
        return value

    def values_at(x: Floats) -> Floats:
        if not isinstance(value, str):
            return np.full(len(x), value)
        try:
            values = values_at_points(value, x)
            if mark is not None and len(values):
                for k in {int(values.argmin()), int(values.argmax())}:
                    place = ", ".join(f"{c:g}" for c in x[k])
                    bounds, shown_value = mark.constant, f"{values[k]:g} at ({place}) mm"
                    bounds.check(values[k], shown_value, bounds.unit)
            return values
        except (InputError, PydanticCustomError) as error:
            raise InputError(f"{key}: {error}") from error

    return values_at


def in_zone(above: float, below: float, heights: Floats) -> Bools:
    """True at heights on a stem between two others (n,) [mm], to rounding."""
    return (heights >= above - ROUNDING_OF_HEIGHTS) & (heights <= below + ROUNDING_OF_HEIGHTS)


def amplitude(load_history: Sequence[float] | None, time: float) -> float:
    """Multiplier at a time. Stage k runs from k to k + 1 and ends with ``load_history[k]`` or 1."""
    values = [0.0, *((1.0,) if load_history is None else load_history)]
    return float(np.interp(time, np.arange(len(values)), values))


def gap_at(gap: Floats, gap_history: Sequence[float], time: float) -> Floats:
    """Gap of points at a time (n,) [mm].

    Args:
        gap: Gap at full amplitude (n,) [mm].
        gap_history: Amplitudes at the ends of the stages. Empty: a clearance is constant, an
            interference grows through the first stage.
        time: Stage k runs from k to k + 1.
    """
    if gap_history:
        return amplitude(gap_history, time) * gap
    return np.maximum(gap, 0.0) + amplitude((1.0,), time) * np.minimum(gap, 0.0)


def gap_settled(gap: Floats, gap_history: Sequence[float]) -> float:
    """Time after which the gap of points (`gap_at`) is constant."""
    if not gap_history:
        return 1.0 if (gap < 0.0).any() else 0.0
    if not gap.any():
        return 0.0
    stage_ends = [0.0, *gap_history]
    return float(max((k + 1 for k, (a, b) in enumerate(pairwise(stage_ends)) if a != b), default=0))


def multiplier(time_course: TimeCourse | None, seconds: float) -> float:
    """Multiplier of a heat condition at a time [s], linear between pairs; 1 without any."""
    if not time_course:
        return 1.0
    return float(np.interp(seconds, [t for t, _ in time_course], [m for _, m in time_course]))
