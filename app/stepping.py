"""Through the stages of a scene: load steps where a stage takes no time, else time steps."""

from __future__ import annotations

from collections.abc import Sequence

from app.motion import Motion
from app.terms import Stage


def run(stages: Sequence[Stage], motion: Motion) -> None:
    """Take a model through its stages.

    Args:
        stages: Parts of the loading.
        motion: Its mechanics, at rest at time 0.

    Raises:
        ConvergenceError: A step cannot be made smaller or may not be, or a body runs away.
    """
    for k, stage in enumerate(stages):
        motion.load(k, stage)
