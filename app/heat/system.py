"""Heat as the solver sees it: temperature, and temperature jumps where there are any."""

from __future__ import annotations

from dataclasses import replace

from petsc4py import PETSc

from app.heat.conduction import Conduction
from app.numerics.active_set import ActiveSet
from app.numerics.preconditioners import INTERFACE, MULTIGRID, Options, is_direct
from app.numerics.system import Measure, System

# Heat is asked for this part of the solver's tolerance: errors of hundreds of solves add up in its
# balance, and temperatures are kept between their bounds to 1e-9 of the range.
STRICTER = 1e-2
KEPT_FACTORS: Options = {
    "pc_type": "python",
    "pc_python_type": "app.heat.preconditioner.KeptFactors",
}


class HeatSystem(System):
    """The implicit solve that ``conduction.begin`` prepared."""

    prefix = "mantle_heat_"
    # Nearly linear: two iterations do if the first is solved well.
    newton: Options = {"ksp_rtol": 1e-5}  # noqa: RUF012

    def __init__(self, conduction: Conduction) -> None:
        """Wrap the operators."""
        self._conduction, self.comm = conduction, conduction.comm
        # Conduction has no states to change.
        self.active = ActiveSet(self.comm)

    @property
    def version(self) -> int:
        """Changes of the matrices from one time step to the next."""
        return self._conduction.version

    def blocks(self) -> dict[str, PETSc.Vec]:
        """Temperature, and with finite conductance its jumps."""
        # No interface, no second block.
        return dict(
            zip(("temperature", "temperature_jump"), self._conduction.vectors(), strict=False)
        )

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """Capacity, conduction and exchange; conductance."""
        return [list(row) for row in self._conduction.matrix]

    def options(self, linear: str) -> dict[str, Options]:
        """Both blocks at once if direct; multigrid for the temperature, direct for the jumps."""
        if is_direct(linear, self._conduction.matrix[0][0].getSize()[0]):
            # Jumps are strong where conductance is low: taken in turns they take many turns.
            return {"": KEPT_FACTORS}
        every: dict[str, Options] = {"temperature": MULTIGRID, "temperature_jump": INTERFACE}
        return {name: every[name] for name in self.blocks()}

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Put given temperatures into a state."""
        self._conduction.impose(x)

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """Heat that is lacking."""
        self._conduction.residual(x, f)

    def jacobian(self, x: list[PETSc.Vec]) -> None:
        """Complete the matrices."""
        self._conduction.jacobian(x)

    def measure(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> list[Measure]:
        """Heat that is lacking, beside that stored, brought in and let through [N mm/s]."""
        m = self._conduction.measure(x, f)
        return [replace(m, scale=STRICTER * m.scale)]
