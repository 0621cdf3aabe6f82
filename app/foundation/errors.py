"""Errors, by exit code.

Every error that a user can cause or meet is one of these; the command line prints its message once,
on rank 0, and leaves with its ``exit_code``. Anything else is an internal error (70).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

from app.foundation.verdict import Verdict, story


class MantleError(Exception):
    """An error with verdicts for the user and an exit code. A text becomes a verdict."""

    exit_code = 70

    def __init__(self, findings: str | Verdict | Sequence[str | Verdict]) -> None:
        finding_list = [findings] if isinstance(findings, str | Verdict) else findings
        self.verdicts = [v if isinstance(v, Verdict) else Verdict(v) for v in finding_list]
        super().__init__(self.message())

    def message(self) -> str:
        """Return the message: a line for each verdict."""
        return "\n".join(map(str, self.verdicts))


class InputError(MantleError):
    """The input is wrong; holds one message per defect.

    A message is ``file:line:column: key: what is wrong; what is allowed``.
    """

    exit_code = 2

    @property
    def messages(self) -> list[str]:
        """A message for each defect."""
        return [str(v) for v in self.verdicts]


class GeometryError(MantleError):
    """The geometry cannot be built or the mesh is not good enough."""

    exit_code = 3


class ConvergenceError(MantleError):
    """The equations could not be solved: where, why, what to try."""

    exit_code = 4

    def message(self) -> str:
        """Return the message: the failure, its circumstances, then its remedy."""
        return story(self.verdicts)


class StoppedError(MantleError):
    """Stopped by a signal, a limit or a full disk, with the state saved."""

    exit_code = 5


class UnusableError(MantleError):
    """Solved, but do not use the numbers: out of balance, large displacements, or not fitted."""

    exit_code = 6


class EnvironmentProblem(MantleError):
    """A package, a compiler or MPI is missing or unusable."""

    exit_code = 69


class RankError(MantleError):
    """An error on one rank, unknown to the others, which have to be ended."""

    def __init__(self, error: MantleError) -> None:
        super().__init__(str(error))
        self.exit_code = error.exit_code


@contextmanager
def stack_needed(petsc: bool = True) -> Iterator[None]:
    """Turn a missing package of the solver stack into an error of the environment.

    PETSc is started without its files of options: the one in the working folder may be another's.

    Raises:
        EnvironmentProblem: A package from outside mantle is missing.
    """
    try:
        if petsc:
            import mpi4py.MPI  # noqa: F401  (libraries of wheels find MPI by it)
            import petsc4py

            petsc4py.init(["mantle", "-skip_petscrc"])
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] in PACKAGES:
            raise
        raise EnvironmentProblem(
            f"the Python package {error.name} is missing; mantle doctor lists what is installed"
        ) from error


# Packages of the program.
PACKAGES = ("app", "configs", "forms", "mantle", "meshes")
# Errors with different exit codes.
KINDS_OF_ERRORS = (
    InputError,
    GeometryError,
    ConvergenceError,
    StoppedError,
    UnusableError,
    EnvironmentProblem,
)


# Meaning of each exit code of ``mantle``.
EXIT_CODES = {
    0: "done",
    1: "a verification problem fails, or a benchmark cannot be measured",
    InputError.exit_code: "wrong input",
    GeometryError.exit_code: "no geometry or mesh can be made",
    ConvergenceError.exit_code: "not converged",
    StoppedError.exit_code: "stopped, with the state saved",
    UnusableError.exit_code: "solved, but the numbers must not be used",
    EnvironmentProblem.exit_code: "the environment is at fault: a package, a compiler, MPI",
    MantleError.exit_code: "internal error",
}


def worst_error(codes: Iterable[int], message: str) -> MantleError:
    """Error with the highest of the exit codes of failed runs; unknown codes count as 70."""
    kinds: dict[int, type[MantleError]] = {kind.exit_code: kind for kind in KINDS_OF_ERRORS}
    worst_kind = max(
        (kinds.get(code, MantleError) for code in codes), key=lambda kind: kind.exit_code
    )
    return worst_kind(message)
