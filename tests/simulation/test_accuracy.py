"""Mesh and order for an accuracy: by known laws of errors, within limits, and in a run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import pytest

from app.case.case import Case, load_case
from app.case.error_classes import MOTION_ERRORS
from app.cli import main
from app.foundation.errors import InputError
from app.simulation import accuracy
from app.simulation.model import Model
from app.soundness import cost, memory
from tests import support
from tests.cases.blocks import STACK

ASKED = STACK.replace("error: true", "accuracy: 5 %")


def chosen(*constants: float, walltime: float | None = None) -> tuple[Case, str, list[Case]]:
    """The choice if errors of slip are C h^p, and the cheap runs. A tiny gap does not count."""
    solved: list[Case] = []

    def solve(case: Case) -> dict[str, Any]:
        solved.append(case)
        order = case.mesh.order - 1
        error = 0.01 * constants[order] * case.mesh.size ** MOTION_ERRORS.orders[order]
        gap = {"gap_p99": 1e-9, "gap_p99_error": 1e-6}
        return {"interfaces": {"a": {"slip_p99": 0.01, "slip_p99_error": error} | gap}}

    return *accuracy.choose(MPI.COMM_SELF, support.case(ASKED), solve, walltime), solved


def test_accuracy_chooses_the_cheapest_mesh_within_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    for constants, order in (((0.4, 0.1), 2), ((0.05, 0.2), 1)):
        best, reason, solved = chosen(*constants)
        size = (0.05 / constants[order - 1]) ** (1 / MOTION_ERRORS.orders[order - 1])
        assert best.mesh.order == order and size / 1.16 < best.mesh.size <= size
        assert reason.startswith(
            f"chosen for a target of 5 %: {best.mesh.size:g} mm at order {order} ("
        )
        cheap = min(c.mesh.size for c in solved if c.mesh.order == order)
        assert best.mesh.size < cheap < 2.3 * best.mesh.size
    best, reason, solved = chosen(0.4, 0.3, walltime=8.0)
    assert reason.endswith("; a walltime of 8.0 s allows no finer mesh)")
    assert "(5 % exp" not in reason
    assert all(2 * cost.estimated_seconds(c) <= 8 for c in (best, *solved))
    monkeypatch.setattr(memory, "available_memory", lambda: 5e8)
    best, reason, solved = chosen(0.4, 0.3)
    assert reason.endswith("; 0.5 GB of memory allow no finer mesh)")
    assert all(1.5 * memory.needed(c) <= 5e8 for c in (best, *solved))


def test_accuracy_is_refused(tmp_path: Path) -> None:
    contact = "kind: contact, friction_coefficient: 0.3"
    for change in (
        ("5 %", "5 mm"),
        (contact, "kind: bonded"),
        ("output:", "variations: {a: {}}\noutput:"),
    ):
        why = "needs contact and a mesh that mantle makes; it cannot be used with variations"
        if "5 mm" in change:
            why = "'5 mm' is not a number"
        (tmp_path / "case.yaml").write_text(ASKED.replace(*change))
        with pytest.raises(InputError, match=rf"case.yaml:\d+:\d+: output.accuracy: {why}"):
            load_case(tmp_path / "case.yaml")


def test_accuracy_reached_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "case.yaml", tmp_path / "out"
    path.write_text(
        STACK.replace("size: 1 mm", "size: 2 mm").replace("coefficient: 0.3", "coefficient: 0.01")
    )
    assert main(["run", str(path), "--accuracy", "40%", "-o", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text())
    numbers, shares = summary["interfaces"]["lower_upper"], []
    for keys in (("gap_p99", "slip_p99", "motion_p99"), ("pressure_p95", "shear_p95")):
        least = 0.1 * max(numbers[key] for key in keys)
        shares += [numbers[f"{key}_error"] / max(numbers[key], least) for key in keys]
    assert f"{100 * max(shares):.2g} % reached (largest error: lower upper" in summary["accuracy"]
    mesh = load_case(out / "case.yaml").config.mesh
    assert f"target of 40 %: {mesh.size:g} mm at order {mesh.order} (" in summary["accuracy"]
    assert summary["accuracy"] in capsys.readouterr().out


@pytest.mark.parametrize(
    "error",
    [
        InputError("output.probes.gauge: the surface bends below it"),
        ArithmeticError("CHOLMOD: pivot 5 of 10 unknowns"),
        MemoryError(),
        PETSc.Error(55),
    ],
    ids=lambda error: type(error).__name__,
)
def test_accuracy_companion_that_cannot_be_solved_is_left_out(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run has its numbers, whether the case does not fit the mesh or a factorization fails."""

    def refuse(model: Model, case: Case) -> None:
        raise error

    monkeypatch.setattr(Model, "_numbers_of_companion", refuse)
    summary = support.run(STACK, tmp_path).summary
    assert summary["status"] == "converged" and summary["error"]["companions"] == []
    assert summary["error"]["failed"]
