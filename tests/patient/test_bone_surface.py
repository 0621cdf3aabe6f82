"""The surface of a bone: unit, orientation, open ends, damaged triangles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import meshio
import nibabel
import numpy as np
import pytest

from app.foundation.errors import GeometryError
from app.patient import bone_surface
from app.patient.bone_surface import BoneSurface
from tests.patient.bones import opened, parametric_canal, parametric_femur, write
from tests.patient.surface_text import judged, stl


def bytes_of(
    tmp_path: Path, change: Callable[[BoneSurface], BoneSurface], scale: float = 1.0
) -> Path:
    return write(tmp_path / "bone.stl", change(parametric_femur()), scale)


def test_bone_surface_unit_is_found_and_reported(tmp_path: Path) -> None:
    path = bytes_of(tmp_path, lambda s: s, 1e-3)
    surface = bone_surface.read(path)
    assert np.ptp(surface.points[:, 2]) == pytest.approx(
        np.ptp(parametric_femur().points[:, 2]), rel=1e-5
    )
    read, unit = surface.notes
    assert read == "5,056 triangles of a binary STL file"
    assert unit == "unit: m, as the surface is 0.337 long"
    with pytest.raises(
        GeometryError, match=r"0\.337 mm long, but a proximal femur is 65 to 600 mm"
    ):
        bone_surface.read(path, "mm")


def test_bone_surface_flipped_triangles_are_reversed_with_note(tmp_path: Path) -> None:
    def flip(s: BoneSurface) -> BoneSurface:
        triangles = s.triangles.copy()
        triangles[100:130] = triangles[100:130, ::-1]
        return BoneSurface(s.points, triangles)

    surface = bone_surface.read(bytes_of(tmp_path, flip))
    assert "30 triangles with the wrong orientation turned over" in surface.notes
    a, b, c = surface.corners.transpose(1, 0, 2)
    x, y, z = parametric_femur().corners.transpose(1, 0, 2)
    assert (np.cross(a, b) * c).sum() == pytest.approx((np.cross(x, y) * z).sum(), rel=1e-5)


@pytest.mark.parametrize(
    ("suffix", "message"),
    [("ply", "is cut short or damaged"), ("obj", r"line \d+: .* a vertex has three numbers")],
)
def test_bone_surface_of_other_formats_is_equal(suffix: str, message: str, tmp_path: Path) -> None:
    path, stl = tmp_path / f"bone.{suffix}", bone_surface.read(bytes_of(tmp_path, lambda s: s))
    meshio.Mesh(parametric_femur().points, [("triangle", parametric_femur().triangles)]).write(path)
    assert bone_surface.read(path).corners == pytest.approx(stl.corners, abs=1e-4)
    whole = path.read_bytes()  # cut in a line on a vertex
    path.write_bytes(whole[: whole.index(b"\n", 20_000) + 5])
    with pytest.raises(GeometryError, match=message):
        bone_surface.read(path)


def test_bone_surface_open_distal_end_is_reported(tmp_path: Path) -> None:
    surface = bone_surface.read(bytes_of(tmp_path, lambda s: opened(s, -150.0)))
    assert any(line.startswith("open at an end") for line in surface.notes)


def test_bone_surface_many_triangles_are_thinned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bone_surface, "MOST_TRIANGLES", 1000)
    monkeypatch.setattr(bone_surface, "THINNING_SIZE", 6.0)
    surface = bone_surface.read(bytes_of(tmp_path, lambda s: s))
    assert len(surface.triangles) < 0.7 * len(parametric_femur().triangles)
    assert "of 5,056 triangles left after merging corners within 6.0 mm" in " ".join(surface.notes)


def test_bone_surface_refuses_places_where_digits_are_lost(tmp_path: Path) -> None:
    """Numbers of four bytes have steps of 1 mm at ten kilometres."""
    path = stl(tmp_path, parametric_femur().corners + 1e7)
    with pytest.raises(GeometryError, match=r"coordinates reach 1e\+07 mm, .* to the origin"):
        bone_surface.read(path)


def test_bone_surface_spike_has_a_note(tmp_path: Path) -> None:
    """A corner with a damaged number is 60 mm from its place."""
    bone = parametric_femur()
    points = bone.points.copy()
    points[1200, 0] += 60.0
    surface = bone_surface.read(stl(tmp_path, points[bone.triangles]))
    (note,) = surface.doubts
    assert note.startswith("1 corners stick out from their neighbours, the farthest by 60 mm at (")
    assert bone_surface.read(stl(tmp_path, bone.corners)).doubts == ()


def test_bone_surface_with_a_body_inside_says_so(tmp_path: Path) -> None:
    corners = np.concatenate([parametric_femur().corners, parametric_canal().corners[:, ::-1]])
    with pytest.raises(GeometryError, match="2 bodies, one inside the other, like bone and canal"):
        bone_surface.read(stl(tmp_path, corners))


def test_bone_surface_note_on_an_open_proximal_end(tmp_path: Path) -> None:
    """The top of the head is missing, or one triangle of it. The shaft is cut."""
    corners = parametric_femur().corners
    high = corners[:, :, 2].max(axis=1)
    for kept, edges in ((high < 60.0, 32), (np.arange(len(corners)) != high.argmax(), 3)):
        surface, frame = judged(stl(tmp_path, corners[kept]))
        (note,) = frame.doubts(surface)
        assert "open at the proximal end, at (4" in note and f"({edges} edges)" in note
    surface, frame = judged(stl(tmp_path, opened(parametric_femur(), -150.0).corners))
    assert len(surface.rim) and frame.doubts(surface) == []


@pytest.mark.parametrize(
    ("edge", "units"),
    [(7.2, None), (0.72, "cm"), (7.2 / 25.4, "cm or inch"), (0.0072, "m")],
)
def test_bone_surface_of_an_image_in_another_unit_names_it(
    edge: float, units: str | None, tmp_path: Path
) -> None:
    """40 voxels of 7.2 mm are 288 mm long, as a femur; 288 mm are 11.3 inch, or 113 mm by cm."""
    values = np.zeros((12, 12, 44), np.uint8)
    values[3:9, 3:9, 2:42] = 1
    affine = np.diag([edge, edge, edge, 1.0])
    nibabel.Nifti1Image(values, affine).to_filename(tmp_path / "labels.nii")
    if units is None:
        bone_surface.read(tmp_path / "labels.nii", label=1)
        return
    with pytest.raises(GeometryError, match=rf"is the unit of the image {units}\?") as caught:
        bone_surface.read(tmp_path / "labels.nii", label=1)
    assert "or give the label of the femur" in str(caught.value)
