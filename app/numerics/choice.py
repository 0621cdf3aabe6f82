"""The choice between condensing bodies onto the jumps of contact and a Krylov method, by time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.system.layout import duration

# Measured on one core.
FACTORS = 48e9  # operations per second of sparse factors
SINGLE = 86e9  # operations per second of dense factors in single precision
BYTES = 10e9  # bytes per second of back-substitutions
# Newton iterations from rest, and of a later solve.
FROM_REST = 12
ITERATIONS = 5.5
# Seconds of imports and analysis, and of setting the matrices up per unknown.
START = 0.3
ASSEMBLY = 1.5e-5
# Seconds of a solve by a Krylov method per unknown, by order; a later solve over the first.
KRYLOV = {1: 1e-4, 2: 9.5e-5}
LATER = {1: 0.4, 2: 0.5}
# Efficiency of ranks of a Krylov method, and of threads of rank 0.
SPEEDUP = 0.9
# Part of the memory that factors may take.
MEMORY = 0.5
# Operations of factors fall with this power of the number of ranks that share them.
DIVIDED = 1.4


@dataclass(frozen=True)
class SolverChoice:
    """Times of both ways for all solves of contact.

    Attributes:
        order: Of the displacement.
        size, jumps: Unknowns of displacement, and jumps.
        solves: Number of solves.
        setting: Whether the stiffness changes, so that the bodies are factored for each.
        memory: Of a rank [byte].
        ranks: Number of ranks.
        factors: Operations of the factors of the bodies on the rank that has most, and entries of
            all; estimated if they are not known.
    """

    order: int
    size: float
    jumps: float
    solves: float
    setting: bool = False
    memory: float = math.inf
    ranks: int = 1
    factors: tuple[float, float] | None = None

    @property
    def work(self) -> tuple[float, float]:
        """Operations of the factors on the rank that has most, and entries of all.

        Estimated on one rank within a sixth (entries: a tenth) in hips of 24,000 to 153,000
        unknowns, within a third at 850,000.
        """
        n, m = self.size, self.jumps
        operations = 15 * n**2.05 + 1.1 * m**2.91 - m**3 / 3
        entries = 6 * n**1.44 + 1.1 * m**1.95
        return self.factors or (operations / self.ranks**DIVIDED, entries)

    @property
    def condensed(self) -> float:
        """Time of condensation [s]."""
        operations, entries = self.work
        setup = operations / FACTORS + ASSEMBLY * self.size / self._speedup
        lu = (2 / 3) * (0.64 * self.jumps) ** 3 / (SINGLE * self._speedup)
        iteration = lu + (32 * self.jumps**2 + 8 * entries / self.ranks) / BYTES
        setup *= self.solves if self.setting else 1
        return START + setup + (FROM_REST + ITERATIONS * (self.solves - 1)) * iteration

    @property
    def krylov(self) -> float:
        """Time of a Krylov method [s]."""
        later = LATER[self.order] * (self.solves - 1)
        return KRYLOV[self.order] * self.size * (1 + later) / self._speedup

    @property
    def _speedup(self) -> float:
        """Speed of all ranks over that of one."""
        return SPEEDUP * self.ranks if self.ranks > 1 else 1.0

    @property
    def needed(self) -> float:
        """Memory of condensation on rank 0 [byte]."""
        return 1.3 * 8 * self.work[1] / self.ranks + 20 * self.jumps**2

    @property
    def fits(self) -> bool:
        """Whether there is the memory for condensation."""
        return self.needed < MEMORY * self.memory

    def condenses(self, linear: str) -> bool:
        """Whether it is condensed; ``linear`` is auto, condensed or another method."""
        less = linear == "auto" and self.condensed < self.krylov
        return self.fits and (less or linear == "condensed")

    def words(self, condensed: bool) -> str:
        """The way taken, and the other."""
        solves = f"{self.solves:g} solve{'s' if self.solves > 1 else ''}"
        bodies, krylov = duration(self.condensed), duration(self.krylov)
        size = f"{self.needed / 1e9:.2g} GB{'' if self.fits else ', too much'}"
        if condensed:
            way = f"{solves}, bodies condensed onto the jumps: about {bodies}, {size}"
            return f"{way}; by a Krylov method {krylov}"
        return f"{solves} by a Krylov method: about {krylov}; bodies condensed {bodies}, {size}"
