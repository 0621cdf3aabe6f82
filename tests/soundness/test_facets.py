"""Bodies that only the facets of a mesh hold have no solution."""

from __future__ import annotations

import re

import numpy as np
import pytest

from app.foundation.errors import ConvergenceError
from tests import support

STEM = (support.CONFIGS / "stress" / "stem.yaml").read_text(encoding="utf-8")
SMOOTH = tuple(
    f"interfaces.{name}.friction_coefficient=0" for name in ("stem_cement", "cement_bone")
)
TWIST = (
    "loads.lateral={kind: force, boundary: stem_top, force: [0 N, 10 N, 0 N], "
    "at: [100 mm, 0 mm, 24 mm]}"
)


def moved(*overrides: str) -> float:
    """Run the first stage and return the largest jump [mm]."""
    analysis = support.analysis(support.case(STEM, *overrides))
    sizes: list[float] = []

    def note(step: object, trial: object) -> None:
        sizes.append(float(np.abs(trial.jump).max()))  # type: ignore[attr-defined]

    stepper = analysis.load_stepper(note, pytest.fail)
    assert stepper is not None
    stepper.run_stage(0, analysis.scene.stages[0], lambda: None)
    return sizes[-1]


@pytest.mark.parametrize(
    ("overrides", "mode"),
    [((TWIST,), "rotate about z"), (("geometry.taper=0 deg",), "move along z")],
)
def test_facets_frictionless_stem_is_free(overrides: tuple[str, ...], mode: str) -> None:
    """A smooth stem can rotate in its taper (case 1) or slide out of a cylinder (case 2)."""
    with pytest.raises(ConvergenceError) as caught:
        moved(*SMOOTH, *overrides)
    assert re.search(rf"nothing holds body 'stem': .* free to {mode}", str(caught.value))


def test_facets_bodies_held_by_curved_facets_alone_are_named() -> None:
    """Only curved facets resist the rotation of a smooth stem, and the error says so."""
    with pytest.raises(ConvergenceError) as caught:
        moved(*SMOOTH, TWIST, "mesh.order=2")
    message = str(caught.value)
    assert re.search(
        "only the facets of the mesh hold body 'stem': .* free to rotate about z", message
    )


@pytest.mark.parametrize("overrides", [SMOOTH, (TWIST,), (*SMOOTH, "mesh.size=5 mm")])
def test_facets_bodies_held_by_surfaces_are_held(overrides: tuple[str, ...]) -> None:
    """A smooth taper holds a stem that is pressed into it; friction holds a stem under a torque."""
    assert moved(*overrides) > 0


@pytest.mark.parametrize("friction", [0, 0.3, 1])
def test_facets_frictionless_stem_is_free_for_any_friction_in_bone(friction: float) -> None:
    """A stem without friction, pushed aside, leaves its cement. Friction in bone does not hold it.

    The friction is that of the cement in the bone.
    """
    changes = (
        SMOOTH[0],
        f"interfaces.cement_bone.friction_coefficient={friction}",
        "loads.hip.force=[300 N, 0 N, 0 N]",
    )
    with pytest.raises(ConvergenceError, match=r"nothing holds body 'stem': .* along z, and the "):
        support.solve(support.STEM, *changes)
