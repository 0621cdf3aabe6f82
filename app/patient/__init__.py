"""A patient's bone: surfaces, images and landmarks, and moduli by computed tomography.

`geometry` has the keys of `kind: patient`, `image_modulus` those of a density in an image, `bone`
the bone in the model's axes, `measured_layers` its layers in the sections of a mesh. Importing the
package registers it; the core does not know it.
"""

from pathlib import Path

from app.case import new_case
from app.patient import findings as findings
from app.patient.geometry import Patient as Patient
from app.patient.image_modulus import ImageModulus as ImageModulus


def _from_labels(
    path: Path,
    labels: Path,
    ct: Path | None,
    side: str | None,
    label: str | None,
    cementless: bool,
) -> tuple[Path, list[str]]:
    """Write a first case by a segmentation."""
    from app.patient import first_case  # most of scipy, which other commands do without

    return first_case.write(path, labels, ct, side, label, cementless)


new_case.add_from_labels(_from_labels)
