"""Scenes from laws by name, without a case."""

from __future__ import annotations

import pytest

from app.foundation.errors import InputError
from app.laws.contact_laws import Contact
from app.laws.materials import Isotropic
from app.scene.scene import Stage, scene_of


def test_scene_puts_the_jump_on_the_softer_side() -> None:
    scene = scene_of(
        {
            "soft": Isotropic(youngs_modulus="1 GPa", poisson_ratio=0.3),
            "stiff": Isotropic(youngs_modulus="2 GPa", poisson_ratio=0.3),
        },
        [Stage(name="load")],
        interfaces={"joint": Contact(friction_coefficient=0.3)},
        sides={"joint": (["soft"], ["stiff"])},
    )
    (joint,) = scene.parting_interfaces
    assert (joint.master, joint.slave, joint.swapped) == (("stiff",), ("soft",), True)
    assert joint.modulus == 1000.0
    assert scene.time is None


def test_scene_needs_the_sides_of_an_interface() -> None:
    law = Contact(friction_coefficient=0.3)
    with pytest.raises(InputError, match=r"interfaces\.joint: expected the regions on its two"):
        scene_of({}, [Stage(name="load")], interfaces={"joint": law})
