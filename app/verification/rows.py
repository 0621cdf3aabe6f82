"""Cases that ``mantle stress`` varies, and the names of its rows."""

from __future__ import annotations

from app.errors import Reason
from app.verification.check import Check, CheckRun, Judge

STEM, TAPER, STACK = "stress/stem.yaml", "stress/taper.yaml", "blocks.yaml"
BAR, RINGS, WALL, INCLINE, COOK = (
    f"verification/{name}.yaml"
    for name in ("foundation_bar", "lame_plane_strain", "wall", "incline", "cook")
)
# Tolerance where a closed form is compared with a mesh.
MESH = 0.02


def run(case: str, *overrides: str, mesh: str = "") -> CheckRun:
    """A run of a case with some overrides, on a mesh that may be changed first."""
    return CheckRun(case, overrides, mesh)


def row(
    name: str,
    runs: CheckRun | tuple[CheckRun, ...],
    judge: Judge | None,
    tolerance: float = 0.0,
    refusal: Reason | None = None,
    tier: str = "default",
) -> Check:
    """A check named ``what is varied/what else is set/value``; the first is its group."""
    group, own = name.partition("/")[0], name.replace("/", "_").replace(" ", "_")
    runs = (runs,) if isinstance(runs, CheckRun) else runs
    return Check(own, "", runs, judge, tolerance, None, refusal, tier, group)
