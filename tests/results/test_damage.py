"""Damage of interfaces: size of the process zone, patches without bond, finishes of a stem."""

from __future__ import annotations

import numpy as np
import pytest

from app.case import library
from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.laws.traction_laws import Cohesive
from app.laws.values import Patches
from app.results.damage import zone
from tests import support

SATIN = (
    "{finish: satin, friction_coefficient: 0.3, stiffness: 300 MPa/mm, tensile_strength: 0.3 MPa"
)
ENERGIES = "tensile_energy: 0.1 N/mm, shear_energy: 0.1 N/mm"


def disc(n: int) -> tuple[Floats, Floats]:
    """Corners (f, 3, 3) and areas (f,) of triangles on a square of side 40 mm, n cells a side."""
    i, j = np.meshgrid(np.arange(n), np.arange(n))
    cell = np.stack([i, j], axis=-1).reshape(-1, 1, 2)
    halves = [np.array(half) for half in ([[0, 0], [1, 0], [0, 1]], [[1, 0], [1, 1], [0, 1]])]
    flat = np.concatenate([cell + half for half in halves]) * 40 / n - 20
    x = np.concatenate([flat, np.zeros((*flat.shape[:2], 1))], axis=2)
    return x, np.full(len(x), (40 / n) ** 2 / 2)


def test_damage_process_zone_has_the_width_of_the_ring() -> None:
    """Spent energy falls from 1 to 0 between two circles, or two lines."""
    x, area = disc(160)
    cell = 40 / 160
    r = np.hypot(x[..., 0], x[..., 1])
    assert zone(x, np.clip((12 - r) / 5, 0, 1), area) == pytest.approx(5, abs=cell / 2)
    for width in (4, 8):
        front = np.clip((x[..., 1] + 5) / width, 0, 1)
        assert zone(x, front, area) == pytest.approx(width, abs=cell / 2)
    # Without a slope it is the surface.
    assert zone(x, np.zeros(x.shape[:2]), area) == 0
    assert zone(x, np.full(x.shape[:2], 0.3), area) == pytest.approx(40 * np.sqrt(2))


def test_damage_unbonded_patches_depend_on_the_seed_alone() -> None:
    x = 50 * np.random.default_rng(1).random((200_000, 3))
    patches = Patches(share=0.3, patch="5 mm", seed=1)
    unbonded = patches(x)
    # 1,000 cubes: a standard deviation of 0.014.
    assert unbonded.mean() == pytest.approx(0.3, abs=0.045)
    assert np.array_equal(unbonded[::7], patches(x[::7]))
    assert 0.1 < np.mean(unbonded != Patches(share=0.3, patch="5 mm", seed=2)(x)) < 0.6
    # Points 0.05 mm apart are in one patch but where a face of it is between them.
    near = patches(x + np.array([0.05, 0, 0]))
    assert np.mean(unbonded != near) == pytest.approx(2 * 0.3 * 0.7 * 0.05 / 5, rel=0.2)
    assert not Patches(share=0, patch="5 mm")(x).any()
    assert Patches(share=1, patch="5 mm")(x).all()


def law(text: str) -> Cohesive:
    """The law of a stem in cement by a text."""
    interface = support.case("base: stance", f"interfaces.stem_cement={text}").interfaces[
        "stem_cement"
    ]
    assert isinstance(interface, Cohesive)
    return interface


def test_damage_finish_gives_only_shear_strength() -> None:
    satin = law(f"{SATIN}, {ENERGIES}, unbonded: {{share: 10 %}}}}")
    assert (satin.shear_strength, satin.tensile_strength) == (0.38, 0.3)
    assert satin.unbonded == Patches(share=0.1, patch="5 mm")
    assert "Mueller" in (satin.source or "")
    assert law(f"{SATIN}, {ENERGIES}, unbonded: 5 %}}").unbonded == 0.05


@pytest.mark.parametrize("name", sorted(library.read().data["finishes"]))
def test_damage_finish_without_energy_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="No value is known for stem and cement: give it"):
        law(f"{SATIN.replace('satin', name)}}}")
