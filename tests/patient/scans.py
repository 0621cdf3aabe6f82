"""CT and labels of the parametric femur, in the form of a hospital and of TotalSegmentator."""

from __future__ import annotations

from pathlib import Path

import nibabel
import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter
from scipy.spatial.transform import Rotation

from app.foundation.arrays import Floats
from app.patient import landmarks
from app.patient.bone_surface import BoneSurface
from tests.patient.bones import inside, moved, parametric_canal, parametric_femur

# Numbers of the femora in TotalSegmentator, version 2.
NUMBERS = {"left": 75, "right": 76}
HIP = 77
# CT numbers of cortex, cancellous bone, marrow, muscle.
CORTEX = 1400.0
CANCELLOUS = 350.0
MARROW = -60.0
MUSCLE = 40.0
NOISE = 20.0
# Distance of the centre of the head from the middle of the body, and its height [mm].
ASIDE = 90.0
HEIGHT = 800.0
# Level of the femur above which cancellous bone fills it [mm].
FULL = -25.0


def in_patient(side: str) -> tuple[BoneSurface, BoneSurface, Floats]:
    """The femur and its canal in axes to right, anterior, superior, and the head's centre [mm]."""
    head = landmarks.find_landmarks(parametric_femur()).head
    # Medial is to the right of a left femur.
    mirror = np.diag([1.0 if side == "left" else -1.0, 1.0, 1.0])
    place = np.array([-ASIDE if side == "left" else ASIDE, 20.0, HEIGHT])
    bone, canal = (
        moved(s, mirror, place - mirror @ head) for s in (parametric_femur(), parametric_canal())
    )
    return bone, canal, place


def scan(
    folder: Path,
    below: float,
    side: str = "left",
    edges: tuple[float, float, float] = (1.2, 1.2, 1.2),
    tilt: float = 0.0,
) -> Path:
    """Write ``ct.nii.gz`` and ``labels.nii.gz`` of a scan that ends below the head [mm, deg]."""
    bone, canal, head = in_patient(side)
    turn = Rotation.from_euler("xy", [tilt, 0.5 * tilt], degrees=True).as_matrix()
    bone, canal = (moved(s, turn.T, -turn.T @ head) for s in (bone, canal))
    low, high = bone.points.min(axis=0) - 8.0, bone.points.max(axis=0) + 8.0
    low[2] = -below
    axes = [np.arange(a + 1e-4, b, d) for a, b, d in zip(low, high, edges, strict=True)]
    solid, hollow = (inside(s, *axes) for s in (bone, canal))
    numbers = np.where(solid, CORTEX, MUSCLE)
    deep = distance_transform_edt(solid, sampling=edges) > 2.0
    numbers[deep & (axes[2] > FULL - 54.0)] = CANCELLOUS
    numbers[hollow] = MARROW
    numbers = gaussian_filter(numbers, 0.4 / np.array(edges))
    numbers += np.random.default_rng(0).normal(0.0, NOISE, numbers.shape)
    labels = np.where(solid, NUMBERS[side], 0).astype(np.uint8)
    labels[:2, :2, :2] = HIP
    affine = np.eye(4)
    affine[:3, :3] = turn * edges
    affine[:3, 3] = turn @ [a[0] for a in axes] + head
    folder.mkdir(exist_ok=True, parents=True)
    for name, values in (("ct", numbers.astype(np.int16)), ("labels", labels)):
        nibabel.Nifti1Image(values, affine).to_filename(folder / f"{name}.nii.gz")
    return folder
