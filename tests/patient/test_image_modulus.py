"""Moduli by the density in an image: published laws, closed forms, equal values, bad input."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from app.foundation.errors import InputError
from app.laws import densities
from app.patient import images
from app.patient.geometry import Bone, Patient
from app.patient.image_modulus import ImageModulus
from app.patient.images import Image
from tests import support
from tests.cases.blocks import PULLED, bar

PHANTOM = {"slope": "0.0008 g/cm^3", "offset": "0.004 g/cm^3"}


def write(path: Path, values: Any, start: float = -20.0) -> Path:
    """An image of voxels of 1 mm. The centre of the first one is at a place."""
    affine = np.eye(4)
    affine[:3, 3] = start
    np.savez(path, values=values, affine=affine)
    return path


def modulus(path: Path, law: Any, **more: Any) -> dict[str, Any]:
    return {"density": str(path), "calibration": PHANTOM, "law": law} | more


def line(a: float) -> dict[str, Any]:
    """A law of the user: a + rho in GPa."""
    return {"density": "qct", "ranges": [["0 g/cm^3", f"{a} GPa", "1 GPa", 1]]}


@pytest.fixture
def even(tmp_path: Path) -> Path:
    """An image of uniform cortical bone."""
    return write(tmp_path / "even.npz", np.full((60, 60, 60), 1400, dtype=np.int16))


@pytest.mark.parametrize(
    ("law", "expected"),
    [
        ("morgan_neck", [1139, 3200, 6850]),
        ("keyak", [2061, 3653, 10200]),
        ("carter_hayes", [78, 621, 2875]),
    ],
)
def test_image_modulus_published_laws(even: Path, law: str, expected: list[float]) -> None:
    """Moduli in MPa are for densities of 0.3, 0.6 and 1 g/cm3; pieces of laws meet.

    A CT number of 1400 is 1.124 g/cm3 by the phantom.
    """
    E = ImageModulus.model_validate(modulus(even, law))
    assert densities.modulus_of_density(law, np.array([0.3, 0.6, 1.0])) == pytest.approx(
        expected, abs=0.5
    )
    details = E.details(None)
    (words,) = (text for key, text in details.items() if key.startswith("E at 0.3, 0.6, 1 g/cm^3"))
    assert words.endswith(f"{expected[2]:,} MPa")
    assert details["image"] == "arrays of numpy: 60 x 60 x 60 voxels of 1 x 1 x 1 mm, int16"
    below, above = (
        densities.modulus_of_density(law, np.array([0.27, 0.60]) + step) for step in (0, 1e-9)
    )
    assert below == pytest.approx(above, rel=1.5e-3)
    ash = 0.877 * 1.124 + 0.0789
    assert E.densities(1400) == pytest.approx({"qct": 1.124, "ash": ash, "apparent": ash / 0.6})


def test_image_modulus_are_linear_between_voxels() -> None:
    """A linear field in an oblique image is exact to rounding."""
    rng = np.random.default_rng(0)
    affine = np.eye(4)
    affine[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] * [0.5, 0.7, 2.0]
    affine[:3, 3] = [10.0, -7.0, 900.0]
    at = np.moveaxis(np.indices((8, 9, 7)), 0, -1)
    x = at @ affine[:3, :3].T + affine[:3, 3]
    slope = np.array([3.0, -2.0, 0.5])
    image = Image(x @ slope, affine)
    points = rng.uniform(0, [7, 8, 6], size=(50, 3)) @ affine[:3, :3].T + affine[:3, 3]
    assert image.values_at(points) == pytest.approx(points @ slope, rel=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_image_modulus_bar_of_an_image_equals_that_of_a_table(tmp_path: Path, order: int) -> None:
    """E is 100 MPa up to 2 mm, 1 GPa from 8 mm, and linear between voxels."""
    density = np.interp(np.arange(40) - 20.0, [2, 8], [0.1, 1.0])
    numbers = np.broadcast_to((density - 0.004) / 0.0008, (40, 40, 40))
    E = modulus(write(tmp_path / "bar.npz", numbers), line(0.0))
    text = PULLED.replace("[[2 mm, 100 MPa], [8 mm, 1 GPa]]", json.dumps(E))
    works = [
        float(solved.problem.f.dot(solved.solver.u_and_q()[0]))
        for solved in (
            support.solve(t, f"mesh.order={order}", tagged=bar(20)) for t in (text, PULLED)
        )
    ]
    assert works[0] == pytest.approx(works[1], rel=1e-11)


def test_image_modulus_cells_are_stable_at_large_contrast(tmp_path: Path) -> None:
    """One voxel of ten is stiff. Weights of the quadrature are positive at second order."""
    numbers = np.where(np.random.default_rng(0).uniform(size=(40, 40, 40)) < 0.1, 1400, -90)
    E = modulus(write(tmp_path / "rugged.npz", numbers), "carter_hayes")
    text = PULLED.replace("[[2 mm, 100 MPa], [8 mm, 1 GPa]]", json.dumps(E))
    problem, _ = support.assemble(support.case(text, "mesh.order=2"), bar(8))
    K = problem.stiffness.K.convert("dense").getDenseArray()
    assert np.linalg.eigvalsh(K).min() > 0.0


def test_image_modulus_constant_image_is_a_constant(even: Path) -> None:
    """The case has contact at second order.

    Stiffnesses agree to rounding, and so displacements nearly.
    """
    given = modulus(even, "keyak")
    E = ImageModulus.model_validate(given).largest
    options = ("mesh.order=2", "mesh.curved=false", "solver.tolerance=1e-13")
    one, two, three = (
        support.solve(support.STEM, *options, f"regions.bone.youngs_modulus={text}")
        for text in (f"{E!r} MPa", json.dumps(given), json.dumps(given | {"per_cell": True}))
    )
    K = one.problem.stiffness.K
    for other in (two, three):
        assert (other.problem.stiffness.K - K).norm() < 1e-14 * K.norm()
        for region in ("stem", "cement", "bone"):
            assert (
                support.difference(other.displacement(region)[1], one.displacement(region)[1])
                < 3e-12
            )
            assert support.difference(other.stress(region), one.stress(region)) < 1e-11


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"calibration": None}, "'calibration' is missing"),
        (
            {"calibration": PHANTOM | {"slope": "0.8 g/cm^3"}},
            "GPa; expected 0.5 to 40 GPa. Is the unit wrong",
        ),
        (
            {"calibration": PHANTOM | {"slope": "0.0008 kg/m^3"}},
            r"E = 0\.\d+ GPa; expected 0.5 to 40",
        ),
        ({"law": line(-1.0)}, "no positive modulus"),
        ({"sha256": "0" * 64}, "has another checksum than in the case"),
        ({"density": "none.nii.gz"}, "no such file"),
    ],
)
def test_image_modulus_refuse_bad_input(even: Path, changes: dict[str, Any], message: str) -> None:
    given = {k: v for k, v in (modulus(even, "keyak") | changes).items() if v is not None}
    with pytest.raises(ValidationError, match=message):
        ImageModulus.model_validate(given)


def test_image_modulus_refuse_other_files(tmp_path: Path) -> None:
    path, cube = tmp_path / "image.npz", np.zeros((4, 4, 4))
    for values, affine, message in (
        (cube[0], np.eye(4), "in 2 dimensions"),
        (cube, np.diag([1, 1, 0, 1]), "spacing of its voxels"),
        (cube, np.eye(4) + 0.2 * np.eye(4, k=1), "not perpendicular"),
        (cube, np.eye(3), "cannot be read as an image"),
    ):
        np.savez(path, values=values, affine=affine)
        with pytest.raises(InputError, match=message):
            images.read(path)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match="cannot be read as an image"):
        images.read(path)


def test_image_modulus_refuse_an_image_in_other_axes(even: Path) -> None:
    """The bone of the stem is around the axis, where the image begins."""
    write(even, np.full((60, 60, 60), 1400), start=0.0)
    text = f"regions.bone.youngs_modulus={json.dumps(modulus(even, 'morgan_neck'))}"
    with pytest.raises(InputError, match=r"points are outside the image, such as \(-?\d+"):
        support.assemble(support.case(support.STEM, text))


@pytest.mark.parametrize(
    ("least", "cortex", "lost", "notes"),
    [
        (-1000, 1400, 0, []),
        (
            24,
            1400,
            0,
            ["its smallest CT number is 24, but air has -1000; is there no air, or was 1024 added"],
        ),
        (
            -1000,
            2024,
            0,
            [r"E 1\.5 mm below the bone's surface is 26\.9 GPa; expected less than 25"],
        ),
        (-1000, 1840, 7, ["7 voxels are not numbers"]),
    ],
)
def test_image_modulus_note_doubtful_ct_numbers(
    least: int,
    cortex: int,
    lost: int,
    notes: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The modulus of the cortex by the law is 23.5 GPa at 1840, and 26.9 GPa at 2024."""
    values = np.full((60, 60, 60), float(cortex))
    values[:5] = least
    values[0, 0, :lost] = np.nan
    E = ImageModulus.model_validate(modulus(write(tmp_path / "ct.npz", values), "morgan_neck"))
    monkeypatch.setattr(Patient, "skin", np.zeros((9, 3)))
    monkeypatch.setattr(Patient, "in_file", lambda patient, x, depth: x)
    doubts = E.doubts(Patient.model_construct(bone=Bone.model_construct()))
    assert len(doubts) == len(notes)
    assert all(re.search(note, text) for note, text in zip(notes, doubts, strict=True))
    (line,) = ["; ".join(E.image.summary)]
    assert (f"{lost} voxels are not numbers" in line) == bool(lost)


@pytest.mark.parametrize(("turned", "notes"), [(0.3, 0), (90.0, 0), (10.0, 1)])
def test_image_modulus_notes_a_ct_turned_against_the_labels(
    turned: float, notes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A different order of axes alone has no note."""
    c, s = math.cos(math.radians(turned)), math.sin(math.radians(turned))
    affine = np.eye(4)
    affine[:2, :2] = [[c, -s], [s, c]]
    values = np.full((60, 60, 60), 1000.0)
    values[:5] = -1000
    np.savez(tmp_path / "ct.npz", values=values, affine=affine)
    labels = write(tmp_path / "labels.npz", np.ones((9, 9, 9)))
    E = ImageModulus.model_validate(modulus(tmp_path / "ct.npz", "morgan_neck"))
    monkeypatch.setattr(Patient, "skin", np.full((9, 3), 20.0) @ affine[:3, :3].T)
    monkeypatch.setattr(Patient, "in_file", lambda patient, x, depth: x)
    bone = Bone.model_construct(image=Path(labels), label=1)
    doubts = E.doubts(Patient.model_construct(bone=bone))
    assert len(doubts) == notes
    assert all("turned by 10.0 deg against those of labels.npz" in text for text in doubts)
