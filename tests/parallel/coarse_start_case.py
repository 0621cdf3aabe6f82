"""A stem solved from rest and from a coarse model on these ranks, started by `test_ranks`."""

from __future__ import annotations

import json
import sys
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import patch

from mpi4py import MPI

import numpy as np

from app.simulation import model as models
from tests.cases import coarse_start_stem

if __name__ == "__main__":
    comm = MPI.COMM_WORLD
    starts = []
    for settings in ({}, coarse_start_stem.ALWAYS):
        with patch.multiple(models, **settings) if settings else nullcontext():
            model, steps = coarse_start_stem.go()
        j = model.mechanics.problem.contact
        of_rank = np.hstack([j.state.jump, j.state.force])
        starts.append((j.gather(of_rank), steps[0].outcome.residuals[0]))
    (cold, first), (warm, then) = starts
    if comm.rank == 0:
        numbers = {"difference": abs(warm - cold).max() / abs(cold).max(), "start": then / first}
        Path(sys.argv[1]).write_text(json.dumps(numbers))
