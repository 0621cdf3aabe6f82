"""Triangles around a label: odd labels, volumes, slip of a hip from an image."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from app.foundation.errors import InputError
from app.laws.densities import modulus_of_density
from app.patient import images, label_surface
from app.patient.image_modulus import ImageModulus
from meshes import femur_bone
from meshes.data import region_volumes
from tests import support
from tests.patient.bones import inside, parametric_canal, parametric_femur, slices, write
from tests.patient.patients import as_own, made
from tests.patient.voxel_images import LABELS, labelled


@pytest.mark.parametrize(
    ("factor", "off"), [(0.99999, "2e-05"), (1.01, "0.02"), (32768 / 32767, "6.1e-05")]
)
def test_label_surface_nearly_integer_labels_are_rounded(
    factor: float, off: str, tmp_path: Path
) -> None:
    corners, _ = label_surface.read(labelled(tmp_path, LABELS), 1)
    values = (LABELS * factor).astype(np.float32)
    near, body = label_surface.read(labelled(tmp_path, values), 1)
    assert near == pytest.approx(corners)
    assert f"labels rounded by up to {off}" in body.notes


def test_label_surface_interpolated_labels_are_refused(tmp_path: Path) -> None:
    """Linear interpolation leaves such labels at borders."""
    values = 0.5 * (LABELS + np.roll(LABELS, 1, axis=0))
    between = int((values % 1 > 0).sum())
    with pytest.raises(
        InputError, match=f"{between:,} voxels have values that are not whole .* nearest"
    ):
        label_surface.read(labelled(tmp_path, values), 1)


def test_label_surface_mask_has_label_1(tmp_path: Path) -> None:
    corners, _ = label_surface.read(labelled(tmp_path, LABELS == 2), 1)
    assert corners == pytest.approx(label_surface.read(labelled(tmp_path, LABELS), 2)[0])


def test_label_surface_nan_labels_are_background(tmp_path: Path) -> None:
    values = np.where(LABELS > 0, LABELS, np.nan)
    corners, body = label_surface.read(labelled(tmp_path, values), 2)
    assert f"{int((LABELS == 0).sum()):,} voxels are not numbers; they count as 0" in body.notes
    assert corners == pytest.approx(label_surface.read(labelled(tmp_path, LABELS), 2)[0])


def test_label_surface_knows_where_the_image_cuts_the_body(tmp_path: Path) -> None:
    """A ball of radius 9 lacks its upper third and a side."""
    whole_body = label_surface.body(labelled(tmp_path, LABELS > 0), 1)
    assert whole_body.borders == ()
    cut_off = (LABELS > 0)[5:, :, :16]
    np.savez(tmp_path / "cut.npz", values=cut_off, affine=np.eye(4))
    side, top = label_surface.body(tmp_path / "cut.npz", 1).borders
    assert side == pytest.approx(np.argwhere(cut_off[:1]) * [1.0, 1.0, 1.0])
    assert (top[:, 2] == 15.0).all() and len(top) == cut_off[:, :, 15].sum()
    # A voxel apart from the body is left out: it does not reach the border for it.
    apart = LABELS > 0
    apart[0, 0, 0] = True
    assert label_surface.body(labelled(tmp_path, apart), 1).borders == ()


VOXEL = 0.5  # mm
LOW = -205.0  # mm: the scan ends in the shaft
SLOPE = 0.0008  # of a phantom, per CT number [g/cm3]
OFFSET = 0.004  # of a phantom [g/cm3]
DENSITY = {
    "density": "ct.npz",
    "calibration": {"slope": f"{SLOPE} g/cm^3", "offset": f"{OFFSET} g/cm^3"},
    "law": "morgan_neck",
}
STL = {"surface": "bone.stl"}, {"surface": "canal.stl", "ream": "broach"}
LABEL_IMAGES = (
    {"image": "labels.npz", "label": 1},
    {"image": "labels.npz", "label": 2, "ream": "broach"},
)
BESIDE = 40.0  # CT number beside the bone
MARROW = -50.0  # CT number in its canal
NOISE = 20.0  # spread of CT numbers


def density(z: Any) -> Any:
    """Density of the bone at a level [g/cm3]."""
    return 1.0 + 0.001 * z


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``ct.npz``, its ``labels.npz`` (1 bone, 2 canal), and surfaces."""
    folder = tmp_path_factory.mktemp("scan")
    write(folder / "bone.stl", parametric_femur())
    write(folder / "canal.stl", parametric_canal())
    low, high = (
        parametric_femur().points.min(axis=0) - 3.0,
        parametric_femur().points.max(axis=0) + 3.0,
    )
    low[2] = LOW
    axes = [np.arange(a + 1e-4, b, VOXEL) for a, b in zip(low, high, strict=True)]
    bone, canal = (inside(surface, *axes) for surface in (parametric_femur(), parametric_canal()))
    numbers = np.where(bone, (density(axes[2]) - OFFSET) / SLOPE, BESIDE)
    numbers = gaussian_filter(np.where(canal, MARROW, numbers), 0.6)
    numbers += np.random.default_rng(0).normal(0, NOISE, numbers.shape)
    affine = np.diag([VOXEL, VOXEL, VOXEL, 1.0])
    affine[:3, 3] = [a[0] for a in axes]
    np.savez(folder / "ct.npz", values=numbers.astype(np.int16), affine=affine)
    # Bone is above the middle of its surface; the canal is the rest in it, open at the end.
    labels = (numbers > 500.0) + 2 * (canal & (numbers <= 500.0))
    labels[0, 0, 0] = 1
    np.savez(folder / "labels.npz", values=labels.astype(np.uint8), affine=affine)
    return folder


def test_label_surface_volumes_equal_those_of_triangles(scan: Path) -> None:
    """Volumes agree to 0.3 % each. A voxel apart from the bone is left out."""
    here, there = (as_own(scan, bone=bone, canal=canal) for bone, canal in (LABEL_IMAGES, STL))
    assert "1 voxels in 1 other pieces left out" in here.details["surface"]
    volumes, expected = (region_volumes(made(g)) for g in (here, there))
    assert volumes == pytest.approx(expected, rel=0.003)


def test_label_surface_from_nifti(tmp_path: Path) -> None:
    """The file has numbers and axes. Files without axes, in metres, or cut off are refused."""
    values = np.random.default_rng(0).integers(-1000, 2000, (5, 6, 7)).astype(np.int16)
    affine = np.array([[0, -0.5, 0, 9], [0.4, 0, 0, 8], [0, 0, 1, 7], [0, 0, 0, 1.0]])
    path = tmp_path / "ct.nii.gz"
    nibabel.Nifti1Image(values, affine).to_filename(path)
    assert images.read(path).values_at(affine[:3, 3:].T + affine[:3, 2]) == values[0, 0, 1]
    with pytest.raises(InputError, match="has no label 3000; it has -"):
        label_surface.read(path, 3000)
    whole = path.read_bytes()
    bare = nibabel.Nifti1Image(values, None)
    metres = nibabel.Nifti1Image(values, affine)
    metres.header.set_xyzt_units("meter")
    for wrong, message in ((bare, "neither qform nor sform"), (metres, "unit is meter")):
        wrong.to_filename(path)
        with pytest.raises(InputError, match=message):
            images.read(path)
    path.write_bytes(whole[:200])
    with pytest.raises(InputError, match="cannot be read as an image"):
        images.read(path)


def test_label_surface_from_slices_equals_nifti(tmp_path: Path) -> None:
    """Triangles and moduli of an oblique series agree. An uneven series is refused."""
    rng = np.random.default_rng(0)
    numbers = -1.0 * rng.integers(0, 100, (24, 20, 18))
    numbers[gaussian_filter(rng.normal(size=numbers.shape), 3) > 0.0] = 1200
    affine = np.array(
        [[0.3, -0.36, 0.8, 9], [0.4, 0.27, -0.6, 8], [0, 0.6, 0.75, -7], [0, 0, 0, 1]]
    )
    x = (affine @ [*rng.uniform(0, 17, (3, 50)), np.ones(50)])[:3].T
    folder, file = slices(tmp_path / "ct", numbers, affine), tmp_path / "ct.nii"
    nibabel.Nifti1Image(numbers, affine).to_filename(file)
    (folder / "notes.txt").write_text("no slice")
    E = [ImageModulus.model_validate(DENSITY | {"density": str(path)}) for path in (folder, file)]
    here, there = (label_surface.read(e.density, 1200)[0] for e in E)
    assert here == pytest.approx(there, abs=1e-5)
    here, there = (e.modulus_at(x, None) for e in E)
    assert here == pytest.approx(there, rel=1e-5)
    (folder / "1.2.3").unlink()
    with pytest.raises(InputError, match=r"1\.25 to 2\.5 mm apart; is one missing after 1\.2\.14"):
        images.read(folder)
    slices(folder, numbers[:, :, :3], affine, "1.3")
    with pytest.raises(InputError, match="has 2 series or orientations; put one"):
        images.read(folder)


def test_label_surface_moduli_at_points_of_the_cortex(scan: Path) -> None:
    """At 200 places up to the surface 95 % of moduli are within 3 %, by the noise.

    Values of the image alone are off by 10 % there.
    """
    E = ImageModulus.model_validate(DENSITY, context={"folder": scan})
    geometry, rng = as_own(scan), np.random.default_rng(1)
    angle, z, part = rng.uniform([0, -190, 0], [6.28, -30, 1], size=(200, 3)).T
    low = femur_bone.Tube(femur_bone.CANAL).radius(angle, z) + 1.0
    r = low + part * (femur_bone.PERIOSTEUM.radius(angle, z) - low)
    x = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    expected = modulus_of_density(E.law, E.densities((density(z) - OFFSET) / SLOPE)["apparent"])
    off = E.modulus_at(geometry.femur.frame.to_model(x), geometry) / expected - 1.0
    assert np.percentile(np.abs(off), 95) < 0.03
    assert abs(off.mean()) < 0.003
    assert list(E.details(geometry))[-1].startswith("E 1.5 mm below")
    raw = E.modulus_at(x, None) / expected - 1.0
    assert np.percentile(np.abs(raw), 95) > 0.1


@pytest.mark.slow
def test_label_surface_slip_equals_that_of_triangles(scan: Path) -> None:
    """Slip agrees at both interfaces, with moduli from the CT."""
    E = {"kind": "isotropic", "poisson_ratio": 0.3, "youngs_modulus": DENSITY}
    case: dict[str, Any] = {"base": "stance", "mesh": {"size": "8 mm"}, "output": {"error": True}}
    case |= {"regions": {"cortical_bone": E, "cancellous_bone": E}}
    interfaces = []
    for bone, canal in (STL, LABEL_IMAGES):
        case["geometry"] = {"kind": "patient", "bone": bone, "canal": canal}
        case["loads"] = {"library": "one_leg_stance"}
        interfaces.append(support.run(json.dumps(case), scan).summary["interfaces"])
        (scan / "out").rename(scan / f"out_{len(interfaces)}")
    for one, two in zip(*map(dict.values, interfaces), strict=True):
        assert two["slip_p99"] == pytest.approx(one["slip_p99"], abs=one["slip_p99_error"])
