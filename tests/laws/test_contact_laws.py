"""Laws of contact: what their keys mean at points, for the solver and for other modules."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError

from app.foundation.arrays import Bools, Floats
from app.foundation.errors import InputError
from app.laws.contact_laws import OFF_BONE, Contact, Penalty
from app.laws.values import NoStem


def contact(**keys: object) -> Contact:
    return Contact.model_validate({"kind": "contact", "friction_coefficient": 0.3, **keys})


def heights(*z: float) -> Floats:
    return np.array([[0.5, -1.0, height] for height in z])


class HalfBare(NoStem):
    """A stem without bone at negative x."""

    def off_bone(self, interface: str, x: Floats) -> Bools:
        return np.asarray((x[:, 0] < 0) & (interface == "stem_bone"))


def test_contact_laws_friction_varies_by_zone() -> None:
    """The later zone counts where two overlap; the largest coefficient decides what is compiled."""
    zones = {
        "coating": {"above": "10 mm", "below": "30 mm", "friction_coefficient": 0.9},
        "polished": {"above": "20 mm", "friction_coefficient": 0.1},
    }
    law = contact(zones=zones)
    assert law.largest_friction == 0.9
    assert law.form == ("contact", True) and list(law.constants) == ["μ"]
    at_points = law.constants_at_points("joint", NoStem())
    coefficients = at_points["μ"](heights(5, 15, 25, 40))
    np.testing.assert_array_equal(coefficients, [0.3, 0.9, 0.1, 0.1])


def test_contact_laws_without_friction_have_no_coefficient() -> None:
    law = contact(friction_coefficient=0)
    assert law.form == ("contact", False)
    assert law.constants == {} and law.constants_at_points("joint", NoStem()) == {}
    # A zone alone may have friction.
    rough = contact(friction_coefficient=0, zones={"rough": {"friction_coefficient": 0.5}})
    assert rough.form == ("contact", True)


@pytest.mark.parametrize(
    ("keys", "has_initial_gap", "is_press_fit", "overlaps"),
    [
        ({}, False, False, False),
        ({"gap": "0.1 mm"}, True, False, False),
        ({"gap": "-0.1 mm"}, True, False, True),
        # The sign of an expression is not known without points.
        ({"gap": "-0.01 * x"}, True, False, False),
        ({"interference": "0.05 mm"}, True, True, True),
        ({"zones": {"tip": {"interference": "0.05 mm"}}}, True, True, True),
        ({"zones": {"tip": {"gap": "-0.05 mm"}}}, True, False, True),
        ({"zones": {"tip": {"gap": "0.05 mm"}}}, True, False, False),
        ({"zones": {"tip": {"friction_coefficient": 0.1}}}, False, False, False),
    ],
)
def test_contact_laws_gap_press_fit_and_overlap(
    keys: dict[str, object], has_initial_gap: bool, is_press_fit: bool, overlaps: bool
) -> None:
    law = contact(**keys)
    assert (law.has_initial_gap, law.is_press_fit, law.overlaps_initially) == (
        has_initial_gap,
        is_press_fit,
        overlaps,
    )


def test_contact_laws_gap_is_large_where_bone_never_touches() -> None:
    """Elsewhere an interference is a negative gap. Other interfaces have bone everywhere."""
    x = np.array([[1.0, 0.0, 5.0], [-1.0, 0.0, 5.0]])
    law = contact(interference="0.05 mm")
    gap = law.gap_field("stem_bone", HalfBare())(x)
    np.testing.assert_allclose(gap, [-0.05, OFF_BONE])
    np.testing.assert_allclose(law.gap_field("other", HalfBare())(x), [-0.05, -0.05])


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("0.02 mm", [0.02, 0.02, 0.02]),
        ("0.001 * z", [0.0, 0.03, 0.06]),
        ([["0 mm", "0 mm"], ["60 mm", "0.04 mm"]], [0.0, 0.02, 0.04]),
    ],
)
def test_contact_laws_interference_is_a_number_an_expression_or_a_table(
    given: object, expected: list[float]
) -> None:
    gap = contact(interference=given).gap_field("joint", NoStem())(heights(0, 30, 60))
    np.testing.assert_allclose(-gap, expected, atol=1e-15)


@pytest.mark.parametrize("key", ["gap", "interference"])
def test_contact_laws_expressions_have_the_bounds_of_numbers(key: str) -> None:
    """An interference above 1 mm is refused, as the number is."""
    sign = -1.0 if key == "gap" else 1.0
    gap = contact(**{key: f"{sign * 0.5} + 0 * z"}).gap_field("joint", NoStem())(heights(0, 30))
    np.testing.assert_allclose(gap, -0.5)
    with pytest.raises(InputError, match=f"interfaces.joint.{key}: .* at \\(0.5, -1, 30\\) mm"):
        contact(**{key: f"{sign} * (0.5 + 0.1 * z)"}).gap_field("joint", NoStem())(heights(0, 30))


def test_contact_laws_interference_acts_on_flanks_alone() -> None:
    class Stem(NoStem):
        def on_flanks(self, x: Floats) -> Bools:
            return np.asarray(x[:, 2] > 1.0)

    gap = contact(interference="0.02 mm").gap_field("joint", Stem())(heights(0, 2))
    np.testing.assert_allclose(gap, [0.0, -0.02])


def test_contact_laws_gap_of_a_zone_replaces_that_of_the_interface() -> None:
    """Between table heights of 0 and 10 mm the interference is linear."""
    law = contact(
        interference=[["0 mm", "0 mm"], ["10 mm", "0.1 mm"]],
        zones={"top": {"above": "8 mm", "gap": "0.2 mm"}},
    )
    gap = law.gap_field("joint", NoStem())(heights(0, 5, 9))
    np.testing.assert_allclose(gap, [0, -0.05, 0.2], atol=1e-15)
    assert law.zone_heights == {"top": (8.0, math.inf)}
    assert law.table_heights == {("interference",): (0.0, 10.0)}


def test_contact_laws_layers() -> None:
    """A layer is rigid along the normal by default; a penalty is a layer of equal stiffnesses."""
    assert contact().layer is None and not contact().compresses
    tangential = contact(elastic_layer={"tangential": "40 MPa/mm"})
    assert tangential.layer == (math.inf, 40.0) and not tangential.compresses
    both = contact(elastic_layer={"normal": "90 MPa/mm", "tangential": "40 MPa/mm"})
    assert both.layer == (90.0, 40.0) and both.compresses
    keys = {"kind": "penalty", "friction_coefficient": 0.3, "penalty": "500 MPa/mm"}
    penalty = Penalty.model_validate(keys)
    assert penalty.layer == penalty.spring_stiffness == (500.0, 500.0)
    assert penalty.is_contact and penalty.can_open
    # The same form: both laws share their compiled code.
    assert penalty.form == contact().form


def test_contact_laws_augmentation_is_given_or_follows_the_bodies() -> None:
    softest_stiffness = np.array([10.0, 20.0])
    np.testing.assert_allclose(contact().augmentation_of(softest_stiffness, 0.5), [5, 10])
    given = contact(augmentation="7 MPa/mm")
    assert given.augmentation_of(softest_stiffness, 0.5) == 7.0


@pytest.mark.parametrize(
    ("keys", "key", "words"),
    [
        ({"gap": "1 mm", "interference": "1 mm"}, "interference", "is the opposite of `gap`"),
        ({"gap": "-2 mm"}, "gap", "a negative gap is a radial interference"),
        ({"interference": "2 mm"}, "interference", "is radial, and 0.01 to 0.02 mm"),
        (
            {"friction_coefficient": 0, "friction_heating": 0.5},
            "friction_heating",
            "a friction_coefficient above 0",
        ),
        ({"quadrature": 48}, "quadrature", "needs `sliding: finite`"),
        ({"between": ["a", "b"]}, "between", "needs `sliding: finite`"),
        (
            {"sliding": "finite", "elastic_layer": {"tangential": "1 MPa/mm"}},
            "elastic_layer",
            "small sliding",
        ),
    ],
)
def test_contact_laws_refuse_contradictions(keys: dict[str, object], key: str, words: str) -> None:
    with pytest.raises(ValidationError) as refused:
        contact(**keys)
    assert words in str(refused.value)
    assert any(key in str(error) for error in refused.value.errors())


def test_contact_laws_gap_history_without_a_gap_has_no_effect() -> None:
    law = contact(gap_history=[1, 0])
    assert law.gap_multipliers == (1, 0)
    assert ("gap_history",) in law.without_effect
    assert ("gap_history",) not in contact(gap="0.1 mm", gap_history=[1, 0]).without_effect


def test_contact_laws_finite_sliding_has_boundaries_and_points() -> None:
    law = contact(sliding="finite", between=["head", "cup"], quadrature=48)
    assert law.finite_sliding and law.sliding_boundaries == ("head", "cup")
    assert law.mortar_points == 48
    assert contact(sliding="finite").mortar_points == 12
    assert not contact().finite_sliding and contact().sliding_boundaries is None
