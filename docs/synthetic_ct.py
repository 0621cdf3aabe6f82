"""A CT of the parametric femur, made: `ct.nii.gz` and `labels.nii.gz` (1 bone, 2 its canal).

`./mantle shell -c 'python3 docs/synthetic_ct.py FOLDER'`: voxels of 0.7 mm, numbers by a phantom of
0.0008 g/cm3 each and 0.004 g/cm3 at 0, noise of 20. The scan ends in the shaft.
"""

from __future__ import annotations

import sys
from pathlib import Path

import nibabel
import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from tests.patient.bones import inside, parametric_canal, parametric_femur

# Size of a voxel, and the lowest one [mm].
VOXEL = 0.7
LOW = -215.0
# CT numbers of the tissues.
CORTEX = 1400.0
HEAD = 450.0
BESIDE = 40.0
MARROW = -60.0
AIR = -1000.0
SKIN = 20.0  # mm from the bone: air begins there


def main(folder: Path) -> None:
    """Write both images."""
    low, high = (
        parametric_femur().points.min(axis=0) - 5.0,
        parametric_femur().points.max(axis=0) + 5.0,
    )
    axes = [np.arange(a + 1e-4, b, VOXEL) for a, b in zip([*low[:2], LOW], high, strict=True)]
    bone, canal = (inside(surface, *axes) for surface in (parametric_femur(), parametric_canal()))
    # Cancellous bone above the canal, more than 2 mm below the surface.
    deep = distance_transform_edt(bone, sampling=VOXEL) > 2.0
    numbers = np.where(bone, CORTEX, BESIDE)
    numbers[distance_transform_edt(~bone, sampling=VOXEL) > SKIN] = AIR
    numbers[deep & (axes[2] > -30.0)] = HEAD
    numbers[canal] = MARROW
    numbers = gaussian_filter(numbers, 0.6) + np.random.default_rng(0).normal(0, 20, bone.shape)
    affine = np.diag([VOXEL, VOXEL, VOXEL, 1.0])
    affine[:3, 3] = [a[0] for a in axes]
    for name, values in (("ct", numbers), ("labels", bone + 1.0 * canal)):
        image = nibabel.Nifti1Image(values.astype(np.int16), affine)
        image.to_filename(folder / f"{name}.nii.gz")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
