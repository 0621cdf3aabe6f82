"""Bench test of a potted stem: laws with scatter by hand, faults, numbers of a bar."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from app.fatigue.laws import Logarithmic, Okazaki, Power, StemTest
from app.foundation.errors import InputError
from app.foundation.verdict import recorded
from tests import support

BAR = (support.CONFIGS / "verification/potted_bar.yaml").read_text()
# Strength 1000 - 50 log10 N, with a deviation of 20 MPa.
LINE = Logarithmic.model_validate(
    {"strength": "1000 MPa", "fall": "50 MPa", "ratio": 0.1, "deviation": "20 MPa"}
)
POWER = Power.model_validate({"intercept": 30.0, "slope": 9.0, "deviation": "10 MPa"})


def of_law(law: Logarithmic, ratio: float) -> StemTest:
    """A test of a million cycles with a law."""
    return StemTest.model_construct(law=law, ratio=ratio, cycles=1e6)


@pytest.mark.parametrize("law", [LINE, POWER, Okazaki()], ids=["logarithmic", "power", "okazaki"])
def test_potted_stem_endured_stress_is_the_inverse_of_damage(law: Logarithmic | Power) -> None:
    for cycles in (1e3, 5e6, 1e7):
        assert law.damage(law.endured(cycles)) == pytest.approx(1 / cycles, rel=1e-9)


def test_potted_stem_okazaki_passes_through_both_published_strengths() -> None:
    """Tensile strength 983 MPa, and 855 MPa after 1e7 cycles (Okazaki 2021, abstract)."""
    assert Okazaki().endured(1.0) == 983.0
    assert Okazaki().endured(1e7) == pytest.approx(855.0, abs=0.2)


def test_potted_stem_life_of_weak_stems_is_that_of_a_larger_stress() -> None:
    test = of_law(LINE, ratio=0.1)
    # 700 MPa: log10 N = (1000 - 700) / 50 = 6; two deviations weaker: (1000 - 740) / 50 = 5.2
    assert test.life(700.0) == pytest.approx(1e6)
    assert test.life(700.0, -2.0) == pytest.approx(10**5.2)
    assert test.failing(700.0) == pytest.approx(0.5)
    # 720 MPa is a deviation above what a mean stem endures: 84.13 % fail.
    assert test.failing(720.0) == pytest.approx(0.8413, abs=1e-4)
    assert of_law(LINE.model_copy(update={"deviation": 0.0}), ratio=0.1).failing(100.0) == 0.0


@pytest.mark.parametrize("law", [LINE, POWER])
def test_potted_stem_without_stress_lasts(law: Logarithmic | Power) -> None:
    assert of_law(law, 0.1).life(0.0) > 1e9


def test_potted_stem_stress_has_the_range_of_the_test() -> None:
    test = of_law(LINE, ratio=300 / 2300)
    assert test.stress(500.0) == pytest.approx(500.0 * (1 - 300 / 2300) / 0.9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            "stem_test.region=cement",
            r"stem_test.region: 'cement' is not one of the elastic regions",
        ),
        (
            "stem_test.head=bottom",
            "stem_test.head: no load acts on 'bottom'; boundaries with loads",
        ),
        ("stem_test.level=", "stem_test: 'level' is missing; this geometry has no neck cut"),
    ],
)
def test_potted_stem_faults_are_found_before_meshing(change: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        support.case(BAR, change)


def test_potted_stem_level_beside_the_stem_is_refused_before_the_solve(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"stem_test\.level: .* above 300 mm, where its stress"):
        support.run(BAR, tmp_path, "mesh.size=5 mm", "stem_test.level=300 mm")
    assert not (tmp_path / "out" / "history.csv").exists()


def test_potted_stem_verdict_has_stress_and_life(tmp_path: Path) -> None:
    run = support.run(BAR, tmp_path, "mesh.size=5 mm", "output.fields=false")
    summary = support.summary(run.folder)
    numbers = summary["stem_test"]["stem"]
    assert numbers["life_p05"] < numbers["life_median"] < math.inf
    (verdict,) = [v for v in recorded(summary) if v.where == "bench test"]
    assert f"{numbers['level_stress']:.0f} MPa at the level of the resin" in verdict.text
    assert "more than 1e+09 in the median" in verdict.text
