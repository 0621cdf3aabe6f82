"""A run that is interrupted after any step and continued has the same numbers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.case.case import Case, load_case
from app.case.summary import Summary
from app.foundation.errors import StoppedError
from app.results.reading import Run
from app.simulation import accuracy
from app.simulation import model as models
from app.simulation.model import Model
from app.simulation.session import run
from app.system.folders import saved
from tests import support
from tests.cases import coarse_start_stem, coupled, restarted, worn_ball
from tests.cases.blocks import REMODELLED, TORN
from tests.cases.shipped import COARSE
from tests.cases.stems import CREEPING, SETTING
from tests.cases.turning_head import COCR, CUP, DRIVEN, stages

FIELDS = "output.fields=false"


KINDS = {
    "as it is": (),
    "rigid": (
        "regions.upper={rigid: true}",
        "supports.press.z=-0.005 mm",
        "supports.slide.x=0.006 mm",
    ),
    "second order": ("mesh.order=2",),
    "let go": ("supports.clamp={kind: fixed, boundary: lower_x_max, stages: [press, back]}",),
    "augmented more": ("solver.augmentation_factor=100",),
    "tiring": (
        "fatigue={region: upper, spectrum: {slide: 1e6}, laws: {m: {kind: murphy_2000}}}",
        "stages.2.cycles=2",
        "fatigue.spectrum.back=1e5",
    ),
}


@dataclass(frozen=True)
class Restart:
    """A case, and its interruptions.

    Attributes:
        text: The case.
        overrides: ``key.path=value``, as after ``--set``.
        after: It goes on from each of these checkpoints, one of which is after every step.
        changing: A column of the table that has begun to change at each of them, and goes on.
        relative: Relative difference of numbers.
        nothing: Absolute difference of numbers.
    """

    text: str
    overrides: tuple[str, ...] = ()
    after: tuple[int, ...] = ()
    changing: str = ""
    relative: float = restarted.NUMBERS
    nothing: float = restarted.NOTHING


RESTARTS = {
    **{
        f"rubbing, {kind}": Restart(restarted.RUBBING, (FIELDS, *changes), (1, 2))
        for kind, changes in KINDS.items()
    },
    # Within setting, and after the holder has let go.
    "setting": Restart(restarted.SETTING, (FIELDS,), (-6, -2)),
    "breaking": Restart(
        (support.CONFIGS / "verification/cohesive_bar.yaml").read_text(),
        TORN,
        (1, 4),
        "lower_upper dissipation [N mm]",
    ),
    "creeping": Restart(CREEPING, ("mesh.order=1",), (3, 8), "creep cycles [-]"),
    "remodelling": Restart(REMODELLED, (), (3, 6), "bone mass [g]"),
    "deformable head": Restart(
        CUP.replace("regions:", "stages: []\nregions:"), (COCR, DRIVEN, stages(3)), (2,)
    ),
    # In the second cycle of a ball that turns and wears, and while it warms.
    "worn ball": Restart(
        worn_ball.CASE,
        (*worn_ball.WARM, "stages.1.cycles=2"),
        (9, 15),
        nothing=1e-6,
    ),
    # Setting, cooling, ten years of walking, and a stance.
    "life": Restart(
        (support.CONFIGS / "life.yaml").read_text(),
        tuple(COARSE["life.yaml"]),
        (-3,),
        "creep cycles [-]",
        relative=1e-5,
        nothing=1e-7,
    ),
}
SLOW = {"life"}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n in SLOW else ()) for n in RESTARTS]
)
def test_session_restart_from_a_checkpoint(tmp_path: Path, name: str) -> None:
    this = RESTARTS[name]
    case, files = restarted.whole(this.text, tmp_path, *this.overrides)
    balance = support.summary(tmp_path / "whole")["balance"]
    assert max(v for key, v in balance.items() if key != "heat_quadrature") < 1e-8
    if this.changing:
        names, *table = restarted.rows(tmp_path / "whole")
        # Steps of heat alone have no value.
        values = [row[names.index(this.changing)] for row in table]
        column = [float(value) for value in values if value]
        assert all(column[0] != column[number] != column[-1] for number in this.after)
    for number in this.after:
        part = restarted.on(case, tmp_path, files[number], *this.overrides)
        restarted.assert_same(tmp_path / "whole", part, this.relative, this.nothing)


EVERY = {
    **{f"rubbing, {kind}": (restarted.RUBBING, changes) for kind, changes in KINDS.items()},
    "setting": (restarted.SETTING, ()),
    "coupled, adaptive": (coupled.CASE, ("stages.1.adaptive=true",)),
    "coupled": (coupled.CASE, ()),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_session_restart_from_every_checkpoint(tmp_path: Path, name: str) -> None:
    text, changes = EVERY[name]
    case, files = restarted.whole(text, tmp_path, FIELDS, *changes)
    for file in files:
        part = restarted.on(case, tmp_path, file, FIELDS, *changes)
        restarted.assert_same(tmp_path / "whole", part)


def test_session_restart_with_nested_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in coarse_start_stem.ALWAYS.items():
        monkeypatch.setattr(models, name, value)
    options = (FIELDS, *coarse_start_stem.TURNS)
    case, files = restarted.whole(coarse_start_stem.STEM, tmp_path, *options)
    # Before the turn, which is where a coarse model is asked.
    part = restarted.on(case, tmp_path, files[0], *options)
    # Loads of 900 N are balanced to 1e-7 N.
    restarted.assert_same(tmp_path / "whole", part, nothing=1e-7)


# Coarse, and for heat not for long.
COARSER = ("mesh.size=6 mm", "mesh.far_size=12 mm", FIELDS)
SHIPPED = {
    "blocks": ("mesh.size=3 mm", FIELDS),
    "intact": COARSER,
    "thermal_rings": ("mesh.size=0.8 mm", "time.tolerance=0.02 K", FIELDS),
    "cylinders": ("mesh.size=4 mm", "mesh.far_size=8 mm", FIELDS),
    "stance": COARSER,
    "cure": (*COARSER, "stages.0.increments=2"),
    "thermal_100C": COARSER,
    # At first order every line around the stem is an edge: Newton fails often, and rounding decides
    # which load steps are halved.
    "residual": (
        "mesh.size=8 mm",
        "mesh.along=12 mm",
        "mesh.around=16",
        "mesh.order=2",
        FIELDS,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_session_restart_of_shipped_cases(tmp_path: Path, name: str) -> None:
    text = (support.CONFIGS / f"{name}.yaml").read_text()
    case, files = restarted.whole(text, tmp_path, *SHIPPED[name])
    n = len(files)
    for k in sorted({0, n // 3, 2 * n // 3, max(n - 2, 0)}):
        part = restarted.on(case, tmp_path, files[k], *SHIPPED[name])
        # Loads of thousands of N are balanced to 1e-10 of them.
        restarted.assert_same(tmp_path / "whole", part, nothing=1e-6)


def test_session_restart_after_interrupted_companions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = (FIELDS, "output.error=true", "mesh.size=1.5 mm", "mesh.far_size=1.5 mm")
    case, _ = restarted.whole(restarted.RUBBING, tmp_path, *options)
    stop: list[str] = []
    monkeypatch.setattr("app.system.stopping.signals", lambda: lambda: stop[0] if stop else "")
    errors = accuracy.add_errors

    def interrupted(*arguments: Any) -> Any:
        stop.append("SIGTERM")
        return errors(*arguments)

    out = tmp_path / "out"
    out.mkdir()
    monkeypatch.setattr(accuracy, "add_errors", interrupted)
    with pytest.raises(StoppedError, match="in its companions"):
        run(load_case(case, options), out)
    assert saved(out) and not (out / "DONE").exists()
    stop.clear()
    monkeypatch.setattr(accuracy, "add_errors", errors)
    run(load_case(case, options), out, restart="auto")
    restarted.assert_same(tmp_path / "whole", out)
    assert restarted.numbers(out)[".error.companions.0"]


def test_session_restart_numbers_after_a_stop_in_a_companion_on_the_same_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The companion with other load steps has the matrices and unknowns of the run."""
    options = (FIELDS, "output.error=true", "mesh.size=50 mm", "mesh.far_size=50 mm")
    case, _ = restarted.whole(restarted.RUBBING, tmp_path, *options)
    models_of_companions = []
    solve = Model.numbers_of_companion

    def stopped(model: Model, companion: Case) -> Summary:
        numbers = solve(model, companion)
        models_of_companions.append(model.deforms_like(companion))
        if models_of_companions[-1]:
            raise StoppedError("SIGTERM")
        return numbers

    monkeypatch.setattr(Model, "numbers_of_companion", stopped)
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(StoppedError, match="in its companions"):
        run(load_case(case, options), out)
    assert models_of_companions[-1]
    whole, part = restarted.numbers(tmp_path / "whole"), restarted.numbers(out)
    assert support.summary(out)["status"] == "stopped"
    for name in ("interfaces", "regions"):
        numbers = {k: v for k, v in part.items() if k.startswith(f".{name}.")}
        assert numbers and numbers.items() <= whole.items()


@pytest.mark.parametrize("linear", ["auto", "condensed"])
def test_session_restart_before_mechanics_were_solved(linear: str, tmp_path: Path) -> None:
    """The balance of energy begins at rest, not at the temperatures of the first checkpoint.

    The pattern of the stiffness changes between the stages.
    """
    steps = "time={tolerance: 0.5 K, mechanical_step: 10 K}"
    options = ("stages.0.adaptive=true", steps, f"solver.linear={linear}")
    case, files = restarted.whole(SETTING, tmp_path, *options)
    restarted.assert_same(tmp_path / "whole", restarted.on(case, tmp_path, files[0], *options))


def test_session_restart_appends_fields_to_their_file(tmp_path: Path) -> None:
    case, files = restarted.whole(restarted.RUBBING, tmp_path)
    whole = Run(tmp_path / "whole")
    before = [whole.displacement(k) for k in range(len(whole.times))]
    # In another folder they begin at the checkpoint: the last step is there in any case.
    for file, left in ((files[3], 2), (files[-1], 1)):
        part = Run(restarted.on(case, tmp_path, file))
        assert list(part.times) == list(whole.times[-left:])
        assert np.allclose(part.displacement(), before[-1], rtol=1e-6, atol=1e-9)
    # Whatever was written after the checkpoint is written again.
    run(load_case(case), tmp_path / "whole", restart=str(files[2]))
    again = Run(tmp_path / "whole")
    assert list(again.times) == list(whole.times)
    for k, u in enumerate(before):
        assert np.allclose(again.displacement(k), u, rtol=1e-6, atol=1e-9)


def test_session_restart_writes_the_heat_flux_of_a_finished_run(tmp_path: Path) -> None:
    """No step is left; the conductance follows the pressure of the checkpoint."""
    case, files = restarted.whole(coupled.CASE, tmp_path)
    part = restarted.on(case, tmp_path, files[-1])
    flux, expected = (
        Run(folder).on_points("lower_upper_heat_flux") for folder in (part, tmp_path / "whole")
    )
    assert np.abs(expected).max() > 1e4
    np.testing.assert_allclose(flux, expected, rtol=1e-6)
