"""Young's moduli of bone by its density in an image of computed tomography."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Tag, model_validator

from app.foundation.errors import InputError
from app.schema.paths import ImageFile
from app.schema.section import ITEMS, TAG, Four, Section, Text, Truth, fail
from app.schema.units import Dimension, Modulus, Number, Stress

if TYPE_CHECKING:
    from app.foundation.arrays import Floats
    from meshes.images import Image


# Density of ash by that of a phantom: slope [-].
ASH_SLOPE = 0.877
# Its offset [g/cm3].
ASH_OFFSET = 0.0789
# Part of the apparent density that is ash [-].
ASH_PART = 0.6
# Smaller densities of a law are taken as this [g/cm3].
LEAST = 0.01
# No bone is stiffer [MPa].
STIFFEST = 40e3
# The densest bone of a femur is stiffer [MPa].
SOFTEST = 500.0
# The median of a cortex is below this [MPa].
STIFF_CORTEX = 25e3
AIR = -200.0  # CT number: air and lung are below it
SHOWN = (0.3, 0.6, 1.0)  # g/cm3 for which moduli are told
INSIDE = 1.5  # mm below the surface of a bone where voxels have nothing of what is around it
Table = tuple[tuple[float, float, float, float], ...]
# Kind of density, and from which on [g/cm3] E = a + b rho^c: from, a [MPa], b [MPa], c.
LAWS: dict[str, tuple[str, Table]] = {
    "morgan_neck": ("apparent", ((0.0, 0.0, 6850.0, 1.49),)),
    "keyak": (
        "ash",
        ((0.0, 0.0, 33900.0, 2.2), (0.27, 469.0, 5307.0, 1.0), (0.6, 0.0, 10200.0, 2.01)),
    ),
    "carter_hayes": ("apparent", ((0.0, 0.0, 2875.0, 3.0),)),
}


_Density = Annotated[float, Dimension("g/cm^3", "a density", "0.004 g/cm^3")]
EXAMPLE = "[0 g/cm^3, 0 MPa, 6.85 GPa, 1.49]"


class Calibration(Section):
    """Line of a phantom that was scanned with the bone."""

    slope: Annotated[float, Dimension("g/cm^3", "a density", "0.0008 g/cm^3", above=0.0)]
    """Density for each CT number."""
    offset: _Density
    """Density at the CT number 0."""


class DensityLaw(Section):
    """A law of one's own: E = a + b rho^c, rho in g/cm3, in ranges of rho."""

    density: Literal["qct", "ash", "apparent"]
    """Density that it is of: by the phantom, of ash or apparent."""
    ranges: Annotated[
        tuple[Annotated[tuple[_Density, Stress, Modulus, Number], Four(EXAMPLE)], ...], ITEMS
    ]
    """Each from a density on: that density, a, b and c."""


Law = Annotated[
    Annotated[Literal["morgan_neck", "keyak", "carter_hayes"], Tag(TAG + "known")]
    | Annotated[DensityLaw, Tag(TAG + "own")],
    Discriminator(lambda law: TAG + ("known" if isinstance(law, str) else "own")),
]


def table_of(law: str | DensityLaw) -> tuple[str, Table]:
    """Kind of density of a law, and its ranges."""
    return LAWS[law] if isinstance(law, str) else (law.density, law.ranges)


def modulus(law: str | DensityLaw, density: Any) -> Any:
    """Young's modulus [MPa] at densities of the law's kind [g/cm3]."""
    import numpy as np

    rho = np.maximum(density, LEAST)
    start, a, b, c = np.transpose(table_of(law)[1])
    k = np.maximum(np.searchsorted(start, rho) - 1, 0)
    return a[k] + b[k] * rho ** c[k]


def density(law: str | DensityLaw, modulus: Any) -> Any:
    """Density [g/cm3] at Young's moduli [MPa], of a law that rises."""
    import numpy as np

    start, a, b, c = np.transpose(table_of(law)[1])
    k = np.maximum(np.searchsorted(a + b * np.maximum(start, LEAST) ** c, modulus) - 1, 0)
    return ((modulus - a[k]) / b[k]) ** (1 / c[k])


@dataclass(frozen=True)
class ChangingDensity:
    """Density of a region that another package changes in a run; its moduli all follow it alike.

    Attributes:
        law: Modulus by density.
        bounds: Least and largest density [g/cm3].
    """

    law: str | DensityLaw
    bounds: tuple[float, float]


class ImageModulus(Section):
    """Young's modulus by the density in an image."""

    found: ClassVar[tuple[str, ...]] = ("sha256",)

    density: ImageFile
    """Image of CT numbers: NIfTI, DICOM (slices or frames), or `values` and `affine` in an `.npz`
    of numpy."""
    calibration: Calibration
    """What makes densities of CT numbers: the line of a phantom."""
    law: Law
    """Modulus by density: `morgan_neck`, `keyak`, `carter_hayes`, or a law of one's own."""
    per_cell: Truth = False
    """Whether it is the mean over each cell, as other programs read it; it always is at first
    order."""
    axes: Literal["RAS", "LPS"] = "RAS"
    """Axes of the bone's file, or of the geometry: to right, anterior, superior as in the image, or
    to left, posterior, superior, as 3D Slicer writes surfaces."""
    sha256: Text | None = None
    """Hash of the image; another image is refused."""

    @model_validator(mode="after")
    def _sound(self) -> ImageModulus:
        try:
            image = self.image
        except InputError as error:
            fail(str(error), at=("density",))
        if self.sha256 not in (None, image.sha256):
            fail(f"{self.density}: is not the image of this hash", at=("sha256",))
        self.__dict__["sha256"] = image.sha256
        if not self.modulus_of(-1e9) > 0.0:
            fail(f"is not positive at {LEAST} g/cm3", at=("law",))
        if not SOFTEST < self.largest < STIFFEST:
            text = f"{image.dense:g}, the densest, is {self.largest / 1e3:.2g} GPa; expected"
            text += f" {SOFTEST / 1e3:g} to {STIFFEST / 1e3:g}: another unit, metal, or labels?"
            fail(f"the CT number {text}", at=("calibration", "slope"))
        return self

    @property
    def image(self) -> Image:
        """Its voxels."""
        from meshes import images

        return images.read(self.density)

    def densities(self, numbers: Any) -> dict[str, Any]:
        """Densities of CT numbers [g/cm3], by kind."""
        qct = self.calibration.offset + self.calibration.slope * numbers
        ash = ASH_SLOPE * qct + ASH_OFFSET
        return {"qct": qct, "ash": ash, "apparent": ash / ASH_PART}

    def modulus_of(self, numbers: Any) -> Any:
        """Young's modulus of CT numbers [MPa]."""
        return modulus(self.law, self.densities(numbers)[table_of(self.law)[0]])

    @property
    def largest(self) -> float:
        """Young's modulus that is exceeded in one voxel of a thousand [MPa]."""
        return float(self.modulus_of(self.image.dense))

    def at(self, x: Floats, places: Any) -> Floats:
        """Young's modulus at points (n, 3) of the model [MPa].

        `places` gives theirs in the image's axes, at a depth in the bone at least.
        """
        x = places(x, INSIDE)
        return self.modulus_of(self.image.at(x * [-1, -1, 1] if self.axes == "LPS" else x))

    def told(self, geometry: Any) -> dict[str, str]:
        """Moduli at three densities, at the densest voxels, and below the surface of a patient."""
        import numpy as np

        dense, kind = self.image.dense, table_of(self.law)[0]
        at, moduli = (
            ", ".join(f"{v:{f}}" for v in values)
            for values, f in ((SHOWN, "g"), (modulus(self.law, list(SHOWN)), ",.0f"))
        )
        found = ", ".join(f"{rho:.2f} {of}" for of, rho in self.densities(dense).items())
        told = {
            "image": "; ".join(self.image.summary),
            f"E at {at} g/cm3 ({kind} density)": f"{moduli} MPa",
            "densest voxels": f"CT number {dense:g}, {found}, E {self.largest / 1e3:.1f} GPa",
        }
        if len(geometry.skin):
            E = np.percentile(self.below_surface(geometry), [5, 50, 95]) / 1e3
            words = f"E {INSIDE:g} mm below the bone's surface (5, 50, 95 %)"
            told[words] = "{:.1f}, {:.1f}, {:.1f} GPa".format(*E)
        return told

    def below_surface(self, geometry: Any) -> Any:
        """Young's moduli at a depth of `INSIDE` below a patient's surface (n,) [MPa]."""
        return self.at(geometry.skin, geometry.in_image)

    def doubts(self, geometry: Any) -> list[str]:
        """Notes on implausible CT numbers: shifted by 1024, or no numbers."""
        import numpy as np

        image, name = self.image, self.density.name
        notes = list(image.notes)
        if image.lost:
            notes.append(f"{name}: {image.lost:,} voxels are no numbers")
        if image.least > AIR:
            text = f"{name}: its least CT number is {image.least:g}; air has -1000: without air, or"
            notes.append(f"{text} is 1024 added to all of them?")
        if len(geometry.skin):
            median = float(np.median(self.below_surface(geometry)))
            if median > STIFF_CORTEX:
                text = f"{name}: the median of E {INSIDE:g} mm below the bone's surface is"
                expected = f"expected less than {STIFF_CORTEX / 1e3:g}"
                notes.append(
                    f"{text} {median / 1e3:.1f} GPa; {expected}: is 1024 added to its CT numbers,"
                    " or is the calibration another's?"
                )
        return notes
