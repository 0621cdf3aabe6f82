"""Young's moduli of bone by its density in an image of computed tomography."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.foundation.layout import two_digits
from app.laws.densities import LEAST_DENSITY, Law, ModulusField, modulus_of_density, table_of
from app.patient.geometry import ImageFile, Patient
from app.schema.section import Section, Text, fail
from app.schema.units import Dimension

if TYPE_CHECKING:
    from app.patient.images import Image

# Density of ash by that of a phantom: slope [-].
ASH_SLOPE = 0.877
# Its offset [g/cm3].
ASH_OFFSET = 0.0789
# Part of the apparent density that is ash [-].
ASH_PART = 0.6
# Bounds of the modulus at the 99.9th percentile of the CT numbers [MPa].
MODULUS_RANGE = (500.0, 40e3)
# Bounds of the median modulus of a cortex [MPa]; a thin cortex has a low one.
CORTEX_RANGE = (1e3, 25e3)
AIR_NUMBER = -200.0  # CT number: air and lung are below it
REPORTED_DENSITIES = (0.3, 0.6, 1.0)  # g/cm3 for which moduli are reported
SAME_AXES = 0.5  # deg up to which the axes of CT and labels are the same
SURFACE_DEPTH = 1.5  # mm below the surface of a bone where voxels have nothing of what is around it


class Calibration(Section):
    """Line of a phantom that was scanned with the bone."""

    slope: Annotated[float, Dimension("g/cm^3", "a density", "0.0008 g/cm^3", above=0.0)]
    """Density for each CT number."""
    offset: Annotated[float, Dimension("g/cm^3", "a density", "0.004 g/cm^3")]
    """Density at the CT number 0."""


class ImageModulus(ModulusField):
    """Young's modulus by the density in an image."""

    from_file: ClassVar[tuple[str, ...]] = ("sha256",)

    density: ImageFile
    """Image of CT numbers: NIfTI, DICOM (slices or frames), or `values` and `affine` in an `.npz`
    of numpy."""
    calibration: Calibration
    """Density as a linear function of CT numbers, from a phantom."""
    law: Law
    """Modulus by density: `morgan_neck`, `keyak`, `carter_hayes`, or a law that the case gives."""
    axes: Literal["RAS", "LPS"] = "RAS"
    """Axes of the bone's file, or of the geometry: to right, anterior, superior as in the image, or
    to left, posterior, superior, as 3D Slicer writes surfaces."""
    sha256: Text | None = None
    """Hash of the image; another image is refused."""

    @model_validator(mode="after")
    def _check_numbers(self) -> ImageModulus:
        try:
            image = self.image
        except InputError as error:
            fail(str(error), at=("density",))
        if self.sha256 not in (None, image.sha256):
            fail(
                f"{self.density}: has another checksum than in the case; is it another image?",
                at=("sha256",),
            )
        self.__dict__["sha256"] = image.sha256
        if not self.modulus_of(-1e9) > 0.0:
            fail(f"gives no positive modulus at {LEAST_DENSITY} g/cm^3", at=("law",))
        softest, stiffest = MODULUS_RANGE
        if not softest < self.largest < stiffest:
            number = image.percentile_99_9
            fault = (
                f"the largest CT number, {number:g}, gives E = {two_digits(self.largest / 1e3)} GPa"
            )
            fault += (
                f"; expected {softest / 1e3:g} to {stiffest / 1e3:g} GPa. Is the unit wrong, or"
            )
            fail(f"{fault} does the image show metal or labels?", at=("calibration", "slope"))
        return self

    @property
    def image(self) -> Image:
        """Voxels of the image."""
        from app.patient import images  # scipy, which other cases do without

        return images.read(self.density)

    def densities(self, numbers: Any) -> dict[str, Any]:
        """Densities of CT numbers [g/cm3], by kind."""
        qct = self.calibration.offset + self.calibration.slope * numbers
        ash = ASH_SLOPE * qct + ASH_OFFSET
        return {"qct": qct, "ash": ash, "apparent": ash / ASH_PART}

    def modulus_of(self, numbers: Any) -> Any:
        """Young's modulus of CT numbers [MPa]."""
        return modulus_of_density(self.law, self.densities(numbers)[table_of(self.law)[0]])

    @property
    def largest(self) -> float:
        """Young's modulus that is exceeded in one voxel of a thousand [MPa]."""
        return float(self.modulus_of(self.image.percentile_99_9))

    def modulus_at(self, x: Floats, geometry: Any) -> Floats:
        """Young's modulus at points (n, 3) of a geometry (n,) [MPa].

        Points near the surface of a patient's bone have the modulus at `SURFACE_DEPTH` below it.
        """
        if isinstance(geometry, Patient):
            x = geometry.in_file(x, SURFACE_DEPTH)
        if self.axes == "LPS":
            x = x * [-1.0, -1.0, 1.0]
        from app.patient.images import OutsideImageError  # scipy, which other cases do without

        try:
            numbers = self.image.values_at(x)
        except OutsideImageError as error:
            raise InputError(f"{error}; is it in other axes? See the key `axes`") from error
        return np.asarray(self.modulus_of(numbers))

    def details(self, geometry: Any) -> dict[str, str]:
        """Moduli at three densities, at the densest voxels, and below the surface of a patient."""
        dense, kind = self.image.percentile_99_9, table_of(self.law)[0]
        shown_densities, shown_moduli = (
            ", ".join(f"{v:{f}}" for v in values)
            for values, f in (
                (REPORTED_DENSITIES, "g"),
                (modulus_of_density(self.law, list(REPORTED_DENSITIES)), ",.0f"),
            )
        )
        densities = ", ".join(
            f"{rho:.2f} {density_kind}" for density_kind, rho in self.densities(dense).items()
        )
        details = {
            "image": "; ".join(self.image.summary),
            f"E at {shown_densities} g/cm^3 ({kind} density)": f"{shown_moduli} MPa",
            "densest voxels": f"CT number {dense:g}, {densities}, E {self.largest / 1e3:.1f} GPa",
        }
        if isinstance(geometry, Patient):
            E = np.percentile(self.below_surface(geometry), [5, 50, 95]) / 1e3
            title = f"E {SURFACE_DEPTH:g} mm below the bone's surface (5, 50, 95 %)"
            details[title] = "{:.1f}, {:.1f}, {:.1f} GPa".format(*E)
        return details

    def below_surface(self, patient: Patient) -> Floats:
        """Young's moduli at a depth of `SURFACE_DEPTH` below a patient's surface (n,) [MPa]."""
        return self.modulus_at(patient.skin, patient)

    def doubts(self, geometry: Any) -> list[str]:
        """Notes on implausible CT numbers: shifted by 1024, or no numbers."""
        image, name = self.image, self.density.name
        notes = list(image.notes)
        if image.nan_count:
            notes.append(f"{name}: {image.nan_count:,} voxels are not numbers")
        if image.min_measured > AIR_NUMBER:
            doubt = f"{name}: its smallest CT number is {image.min_measured:g}, but air has -1000;"
            notes.append(f"{doubt} is there no air, or was 1024 added to all numbers?")
        if isinstance(geometry, Patient):
            notes += self._doubts_on(geometry)
        return notes

    def _doubts_on(self, patient: Patient) -> list[str]:
        """Notes on a CT turned against the labels, and on a cortex too soft or too stiff."""
        notes, name = list[str](), self.density.name
        if patient.bone.image:
            from app.patient import images  # scipy, which other cases do without

            labels = patient.bone.image
            angle = math.degrees(self.image.angle_to(images.read_layers(labels)))
            if angle > SAME_AXES:
                notes.append(
                    f"{name}: its axes are turned by {angle:.1f} deg against those of"
                    f" {labels.name}; are CT and labels of one scan?"
                )
        median = float(np.median(self.below_surface(patient)))
        doubt = f"{name}: the median of E {SURFACE_DEPTH:g} mm below the bone's surface is"
        softest, stiffest = CORTEX_RANGE
        if median < softest:
            notes.append(
                f"{doubt} {two_digits(median / 1e3)} GPa; expected more than"
                f" {softest / 1e3:g} GPa. Is the CT mirrored or moved against the bone, or is"
                " the calibration wrong?"
            )
        if median > stiffest:
            expected = f"expected less than {stiffest / 1e3:g} GPa"
            notes.append(
                f"{doubt} {median / 1e3:.1f} GPa; {expected}. Was 1024 added to its CT numbers,"
                " or is the calibration that of another scanner?"
            )
        return notes
