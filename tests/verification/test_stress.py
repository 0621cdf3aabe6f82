"""``mantle stress``: what it tries, on which meshes, and its judges."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.campaigns.batch import Options
from app.case.case import load
from app.results.reading import Run
from app.verification import changed_meshes, engine, judges
from app.verification.check import CONFIGS, within
from app.verification.engine import SUITES
from meshes import build
from meshes.data import cell_volumes
from meshes.quality import sicn
from tests import support


def test_the_plan() -> None:
    """Names are unique, cases resolve, each row has its share."""
    everything = SUITES["stress"]()
    small = [c for c in everything if within(c.tier, "default")]
    rows = Counter(c.group for c in small)
    assert {"augmentation", "penalty", "modulus", "poisson", "friction", "thin mantle"} < set(rows)
    assert {"loads", "units", "floating", "taper", "cycles", "increments"} < set(rows)
    assert {"symmetry", "bad cells", "heat", "layer", "creep", "cohesion"} < set(rows)
    assert len(small) == 257 and len(everything) == 580
    assert len({c.name for c in everything}) == len(everything)
    names = {c.name for c in small if c.name.startswith("augmentation_E_50:1_mu_0.4")}
    assert {name.split("_")[-1] for name in names} == {f"{10.0**k:.2g}" for k in range(-4, 5) if k}
    for c in everything:
        assert re.fullmatch(r"[^\s/]+", c.name)
        assert (c.judge is not None and c.tolerance > 0) or c.refusal
        assert all((CONFIGS / run.case).is_file() for run in c.runs)
    for name in ("stem", "taper"):
        text = (CONFIGS / "stress" / f"{name}.yaml").read_text(encoding="utf-8")
        assert f"run configs/stress/{name}.yaml" in text
    # Every override is one: what is refused at once is meant to be.
    some = [c for c in small if not any(run.mesh for run in c.runs)]
    refused = {c.name for c in some for *_, why in engine._planned(c, Path()) if why}
    assert len(some) > 150 and len(refused) == 3
    assert refused <= {c.name for c in some if c.group == "floating" and c.judge is None}


# Meshes


def blocks(*overrides: str) -> Any:
    case = load(CONFIGS / "blocks.yaml", ["mesh.size=4 mm", *overrides]).config
    return build(case.geometry, case.mesh, None)


def test_turned_and_scaled_meshes() -> None:
    data = blocks()
    R = changed_meshes.ROTATION
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1) and np.trace(R) == pytest.approx(
        1 + 2 * np.cos(np.radians(40))
    )
    whole = cell_volumes(data.points, data.cells).sum()
    turned = changed_meshes.CHANGES["turned"](data)
    assert cell_volumes(turned.points, turned.cells).sum() == pytest.approx(whole)
    small = changed_meshes.CHANGES["metres"](data)
    assert cell_volumes(small.points, small.cells).sum() == pytest.approx(1e-9 * whole)


def test_bad_cells_are_bad_and_fill_the_blocks() -> None:
    data = blocks()
    bad = changed_meshes.flattened(data, 0.012)
    quality = sicn(bad.points, bad.cells)
    assert 0.012 <= quality.min() < 0.05 < sicn(data.points, data.cells).min()
    for tag in data.regions.values():
        on = data.cell_tags == tag
        volume = cell_volumes(bad.points, bad.cells[on]).sum()
        assert volume == pytest.approx(cell_volumes(data.points, data.cells[on]).sum())


def test_a_quarter_mirrored_is_the_whole() -> None:
    case = load(
        CONFIGS / "cylinders.yaml", ["mesh.size=6 mm", "mesh.far_size=8 mm", "mesh.order=1"]
    ).config
    quarter = build(case.geometry, case.mesh, None)
    whole = changed_meshes.mirrored(quarter)
    volumes = cell_volumes(whole.points, whole.cells)
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(4 * cell_volumes(quarter.points, quarter.cells).sum())
    assert len(np.unique(np.round(whole.points, 7), axis=0)) == len(whole.points)
    assert not any(name.startswith("symmetry") for name in whole.boundaries)


# Judges


def test_judges_see_what_is_off(tmp_path: Path) -> None:
    """Real runs: a right one is right, another answer is not."""
    path = tmp_path / "case.yaml"
    twice, slack = "loads.press.pressure: 4 MPa", "interfaces.cement_metal.gap: 0.001 mm"
    text = (CONFIGS / "blocks.yaml").read_text(encoding="utf-8").replace("size: 2 mm", "size: 4 mm")
    path.write_text(f"{text}\nvariations: {{one: {{}}, twice: {{{twice}}}, slack: {{{slack}}}}}\n")
    support.on_ranks(1, "-m", "mantle", "run", path, "-o", tmp_path / "out")
    first, second, third = (Run(tmp_path / "out" / name) for name in ("one", "twice", "slack"))
    moduli, ratios = (17e3, 2200, 110e3), (0.3, 0.3, 0.3)
    assert judges.stack([first], moduli, ratios).error < 1e-9
    assert judges.stack([third], moduli, ratios).error > 1e-2
    assert judges.stack([second], moduli, ratios).error == pytest.approx(1, rel=1e-6)
    assert judges.same([first, first]).error == 0
    assert judges.same([second, first], lengths=2, stresses=2).error < 1e-9
    assert judges.same([second, first]).error == pytest.approx(1, rel=1e-6)
    assert judges.same([third, first]).error > 1e-2
    with pytest.raises(ValueError, match="not the same"):
        judges.same([first, first], points=2)
    assert judges.lawful([first]).error < 1e-9
    assert judges.close([second, first], factor=2).error == pytest.approx(1, rel=1e-6)
    assert judges.nothing_moves([first]).error == pytest.approx(2, rel=1e-6)


@pytest.mark.slow
def test_rows_end_to_end(tmp_path: Path) -> None:
    """An exact answer whatever the friction, and a body that nothing holds."""
    for pattern, outcome, count in (
        ("friction_incline", "passed", 3),
        ("floating_no_support", "refused", 1),
        ("friction_bar_pulled_off_0.3", "refused", 1),
    ):
        assert engine.run("stress", Options(tmp_path, 2, pattern))
        entries = json.loads((tmp_path / f"stress-{pattern}.json").read_text())
        assert [e["outcome"] for e in entries] == [outcome] * count
        assert (tmp_path / f"stress-{pattern}.png").stat().st_size > 5_000
    assert "nothing holds body 'bar'" in entries[0]["message"]
