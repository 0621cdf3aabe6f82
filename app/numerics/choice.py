"""The choice between condensing bodies onto the jumps of contact and a Krylov method, by size.

The limits are where both take the same time, measured on one core on stances of 5,000 to 850,000
unknowns (docs/verification.md, "Cost of contact").
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.foundation.layout import count

# Unknowns of displacement of second order up to which one solve is faster condensed.
SECOND_ORDER_LIMIT = 60_000
# For n solves the limit is n to this power times as high: 2 at 90,000 unknowns, 4 at 120,000.
SOLVES_POWER = 2 / 3
# Unknowns of first order, where jumps are a quarter of all, up to which several solves are faster.
FIRST_ORDER_LIMIT = 8_000
# Number of solves from which they are.
FIRST_ORDER_SOLVES = 4
# Unknowns whose first solve by a Krylov method takes as long as condensation takes to start, 0.3 s.
SMALLEST_CONDENSED = 3_500
# A later solve by a Krylov method over the first.
LATER_SOLVE_RATIO = 0.4
# Fraction of the memory that factors may take.
MEMORY_SHARE = 0.5


@dataclass(frozen=True)
class SolverChoice:
    """Sizes that decide how contact is solved.

    Attributes:
        order: Order of the displacement.
        size: Unknowns of displacement.
        jumps: Unknowns of jumps.
        solves: Number of solves.
        changes_stiffness: True if the stiffness changes and bodies are factored for each solve.
        memory: Memory of a rank [byte].
        ranks: Number of ranks.
        entries: Entries of all factors of the bodies; estimated if they are not known.
    """

    order: int
    size: float
    jumps: float
    solves: float
    changes_stiffness: bool = False
    memory: float = math.inf
    ranks: int = 1
    entries: float = 0.0

    @property
    def limit(self) -> float:
        """Unknowns of displacement up to which the bodies are condensed."""
        solves = 1.0 if self.changes_stiffness else self.solves
        if self.order == 1:
            return FIRST_ORDER_LIMIT if solves >= FIRST_ORDER_SOLVES else 0.0
        return SECOND_ORDER_LIMIT * solves**SOLVES_POWER

    @property
    def memory_needed(self) -> float:
        """Memory of condensation on rank 0 [byte]; estimated entries are right to a tenth."""
        entries = self.entries or 6 * self.size**1.44 + 1.1 * self.jumps**1.95
        return 1.3 * 8 * entries / self.ranks + 20 * self.jumps**2

    @property
    def fits(self) -> bool:
        """True if the memory suffices for condensation."""
        return self.memory_needed < MEMORY_SHARE * self.memory

    def condenses(self, linear: str) -> bool:
        """Return True if bodies are condensed; ``linear`` is auto, condensed or another method."""
        worth_condensing = (
            self.size * (1 + LATER_SOLVE_RATIO * (self.solves - 1)) > SMALLEST_CONDENSED
        )
        is_faster = linear == "auto" and worth_condensing and self.size <= self.limit
        return self.fits and (is_faster or linear == "condensed")

    def description(self, linear: str, condensed: bool) -> str:
        """Return the chosen method and the reason, as text.

        Args:
            linear: Method in the case: auto, condensed or another one.
            condensed: True if bodies are condensed.
        """
        solves = "1 solve" if self.solves == 1 else f"{self.solves:g} solves"
        if condensed:
            memory = _gigabytes(self.memory_needed)
            size = f"{count(self.size)} displacement unknowns"
            return f"{solves} of {size} by condensation onto the jumps, {memory}"
        return f"{solves} by a Krylov method, because {self._reason_against(linear)}"

    def _reason_against(self, linear: str) -> str:
        """Reason why bodies are not condensed, as text."""
        if linear not in ("auto", "condensed"):
            return f"solver.linear is {linear}"
        if not self.fits:
            needed = _gigabytes(self.memory_needed)
            allowed = _gigabytes(MEMORY_SHARE * self.memory)
            return f"condensation needs {needed} of memory and may take {allowed}"
        if self.condenses(linear):
            return "there is no library for the factors of condensation"
        if self.limit == 0.0:
            return f"at first order condensation is faster from {FIRST_ORDER_SOLVES} solves on"
        if self.size > self.limit:
            limit_text = f"{count(self.limit)}, the limit of condensation"
            return f"{count(self.size)} displacement unknowns exceed {limit_text}"
        return f"condensation is not faster for {count(self.size)} displacement unknowns"


def _gigabytes(size: float) -> str:
    """Memory [bytes] in GB as text: two digits, and no power of ten."""
    rounded = float(f"{size / 1e9:.2g}")
    return f"{rounded:,g} GB"
