"""Made-up predictions and measurements."""

from __future__ import annotations

from app.validation.records import ExperimentRecord, MeasuredQuantity, Prediction


def prediction(samples: list[float], value: float = 2.0, discretization: float = 0.1) -> Prediction:
    """A prediction whose band is from the least to the largest sample."""
    return Prediction(
        text="shear strength",
        unit="MPa",
        value=value,
        discretization=discretization,
        band=(min(samples), max(samples)),
        failure="Outside of the band.",
        follows={"mesh.size": 0.5},
        samples=samples,
    )


def measured(
    value: float | None = None,
    between: tuple[float, float] | None = None,
    uncertainty: float | None = None,
) -> MeasuredQuantity:
    """A measured strength."""
    return MeasuredQuantity(
        value=value, range=between, uncertainty=uncertainty, unit="MPa", source="made up"
    )


def record(inputs: str, quantities: dict[str, Prediction]) -> ExperimentRecord:
    """A record of an experiment with a hash of its inputs."""
    return ExperimentRecord(
        title="made up",
        blind=True,
        commit="0123456789ab",
        date="2026-11-28",
        inputs=inputs,
        seed=1,
        runs=3,
        quantities=quantities,
    )
