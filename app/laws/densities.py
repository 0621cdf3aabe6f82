"""Young's moduli of bone by its density in an image of computed tomography.

CT numbers become density by the line of a phantom, and that becomes the density of a law: of ash,
0.877 times that of the phantom plus 0.0789 g/cm3, or apparent, that of ash over 0.6.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Tag, model_validator

from app.errors import InputError
from app.schema.paths import File
from app.schema.section import ITEMS, TAG, Section, Text, Truth, fail
from app.schema.units import Dimension, Modulus, Number, Stress

if TYPE_CHECKING:
    from app.arrays import Floats
    from meshes.images import Image

    Places = Callable[[Floats, float], Floats]

# Of ash by that of a phantom [g/cm3], and its part of the apparent density.
ASH_SLOPE, ASH_OFFSET, ASH_PART = 0.877, 0.0789, 0.6
LEAST = 0.01  # g/cm3: smaller densities of a law are taken as that
STIFFEST = 40e3  # MPa: no bone is stiffer
SHOWN = (0.3, 0.6, 1.0)  # g/cm3 for which moduli are told
# Voxels, and mm at most, below the surface of a bone where air is no part of a value.
INSIDE = (3.0, 1.5)
KINDS = {"qct": "by the phantom", "ash": "of ash", "apparent": "apparent"}
Table = tuple[tuple[float, float, float, float], ...]
# Kind of density, and from which on [g/cm3] E = a + b rho^c: from, a [MPa], b [MPa], c.
LAWS: dict[str, tuple[str, Table]] = {
    "morgan_neck": ("apparent", ((0.0, 0.0, 6850.0, 1.49),)),
    "keyak": (
        "ash",
        ((0.0, 0.0, 33900.0, 2.20), (0.27, 469.0, 5307.0, 1.0), (0.60, 0.0, 10200.0, 2.01)),
    ),
    "carter_hayes": ("apparent", ((0.0, 0.0, 2875.0, 3.0),)),
}


class Calibration(Section):
    """Line of a phantom that was scanned with the bone."""

    slope: Annotated[float, Dimension("g/cm^3", "a density", "0.0008 g/cm^3", above=0.0)]
    """Density for each CT number."""
    offset: Annotated[float, Dimension("g/cm^3", "a density", "0.004 g/cm^3")]
    """Density at the CT number 0."""


class DensityRange(Section):
    """Range of densities in which E = a + b rho^c, rho in g/cm3."""

    above: Annotated[float, Dimension("g/cm^3", "a density", "0.27 g/cm^3", at_least=0.0)] = 0.0
    """Density where it begins; it ends where the next one does."""
    a: Stress = 0.0
    """Modulus a."""
    b: Modulus
    """Modulus b."""
    c: Number
    """Exponent c."""


class DensityLaw(Section):
    """A law of one's own."""

    density: Literal["qct", "ash", "apparent"]
    """Density that it is of: by the phantom, of ash or apparent."""
    ranges: Annotated[tuple[DensityRange, ...], ITEMS]
    """Ranges, by density."""


class ImageModulus(Section):
    """Young's modulus by the density in an image."""

    found: ClassVar[tuple[str, ...]] = ("sha256",)

    density: File
    """Image of CT numbers: NIfTI, or `values` and `affine` in an `.npz` of numpy."""
    calibration: Calibration
    """What makes densities of CT numbers: the line of a phantom."""
    law: Annotated[
        Annotated[Literal["morgan_neck", "keyak", "carter_hayes"], Tag(TAG + "known")]
        | Annotated[DensityLaw, Tag(TAG + "own")],
        Discriminator(lambda law: TAG + ("known" if isinstance(law, str) else "own")),
    ]
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
        if self.largest > STIFFEST:
            fail(
                f"is {self.largest / 1e3:.0f} GPa at the CT number {image.dense:g}, which one voxel"
                f" in a thousand exceeds; bone has at most {STIFFEST / 1e3:.0f}: a density for each"
                " CT number in another unit, or metal?",
                at=("calibration", "slope"),
            )
        if not self.modulus_of(-1e9) > 0.0:
            fail(f"is not positive at {LEAST} g/cm3", at=("law",))
        return self

    @property
    def image(self) -> Image:
        """The image."""
        from meshes import images

        return images.read(self.density)

    @property
    def _law(self) -> tuple[str, Table]:
        if isinstance(self.law, str):
            return LAWS[self.law]
        return self.law.density, tuple((r.above, r.a, r.b, r.c) for r in self.law.ranges)

    def densities(self, numbers: Any) -> dict[str, Any]:
        """Densities of CT numbers [g/cm3], by kind."""
        qct = self.calibration.offset + self.calibration.slope * numbers
        ash = ASH_SLOPE * qct + ASH_OFFSET
        return {"qct": qct, "ash": ash, "apparent": ash / ASH_PART}

    def modulus(self, density: Any) -> Any:
        """Young's modulus [MPa] at densities of the law's kind [g/cm3]."""
        import numpy as np

        rho = np.maximum(density, LEAST)
        start, a, b, c = np.transpose(self._law[1])
        k = np.maximum(np.searchsorted(start, rho) - 1, 0)
        return a[k] + b[k] * rho ** c[k]

    def modulus_of(self, numbers: Any) -> Any:
        """Young's modulus of CT numbers [MPa]."""
        return self.modulus(self.densities(numbers)[self._law[0]])

    @property
    def largest(self) -> float:
        """Young's modulus that is exceeded in one voxel of a thousand [MPa]."""
        return float(self.modulus_of(self.image.dense))

    def at(self, x: Floats, places: Places) -> Floats:
        """Young's modulus at points (n, 3) of the model [MPa]; `places` are theirs in its file."""
        image = self.image
        voxels, most = INSIDE
        x = places(x, min(voxels * image.voxel, most))
        return self.modulus_of(image.at(x * [-1, -1, 1] if self.axes == "LPS" else x))

    @property
    def told(self) -> dict[str, str]:
        """Moduli at three densities, and at the densest voxels."""
        dense, kind = self.image.dense, KINDS[self._law[0]]
        of_dense = self.densities(dense)
        all_kinds = ", ".join(f"{of_dense[k]:.2f} {words}" for k, words in KINDS.items())
        at = f"E at {', '.join(f'{rho:g}' for rho in SHOWN)} g/cm3 {kind}"
        return {
            at: ", ".join(f"{self.modulus(rho):,.0f}" for rho in SHOWN) + " MPa",
            "densest voxels": f"CT number {dense:g}: {all_kinds}, E {self.largest / 1e3:.1f} GPa",
        }
