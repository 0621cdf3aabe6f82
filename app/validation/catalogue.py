"""All experiments, by name."""

from __future__ import annotations

from app.validation import bearings, interfaces

EXPERIMENTS = {
    experiment.name: experiment for experiment in (interfaces.PUSH_OUT, bearings.WEAR_SIZE)
}
