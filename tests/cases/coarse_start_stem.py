"""A stem whose load steps start from a coarse model."""

from __future__ import annotations

from mpi4py import MPI

from app.mechanics.contact import TrialState
from app.simulation.model import Model
from app.stepping.load_steps import LoadStep
from app.system.timing import Timing
from tests import support

STEM = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
           length: 24 mm, taper: 1.5 deg}
mesh: {order: 1, size: 2.5 mm, far_size: 2.5 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.3}
  cement_bone: {kind: contact, friction_coefficient: 0.5}
supports:
  outer: {kind: fixed, boundary: bone_surface}
loads:
  push: {kind: force, boundary: stem_top, force: [200 N, 0 N, -900 N]}
stages:
  - {name: push, increments: 3}
"""

# A press fit, then a push: the second stage turns off the line of the first.
TURNS = (
    "interfaces.stem_cement.gap=-0.004 mm",
    "interfaces.stem_cement.gap_history=[1, 1]",
    "loads.push.history=[0, 1]",
    "stages=[{name: fit}, {name: push, increments: 2}]",
)

# Start from a coarse model although this one is small.
ALWAYS = {"LARGE": 1000}


def go(*overrides: str) -> tuple[Model, list[LoadStep]]:
    """Solve the stem."""
    model = Model(support.case(STEM, *overrides), MPI.COMM_WORLD, {}, Timing(), str)
    steps: list[LoadStep] = []

    def on_step(step: LoadStep, trial: TrialState | None) -> None:
        steps.append(step)

    model.run(on_step, on_trouble=print)
    return model, steps
