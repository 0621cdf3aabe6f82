"""mantle: thermomechanics of cemented joint replacements, from Python.

    >>> import mantle
    >>> case = mantle.load("stance.yaml", **{"mesh.size": "5 mm"})
    >>> print(mantle.check(case))
    >>> results = mantle.run(case, "out/stance", progress=lambda step: print(step.time))
    >>> results.summary["interfaces"]["stem_cement"]["slip_p99"]  # mm

All numbers are in mm, N, MPa, s and degC. The errors are here, and what an extension needs:
`Traction`, `Frictional`, `InterfaceLaw`, `Load`, `Quantity`, `add_quantity`. ``import mantle`` does
not start MPI and PETSc: the functions that need them do.
"""

from __future__ import annotations

import sys

from app import __version__ as __version__
from app.case.quantities import Quantity as Quantity
from app.case.quantities import add_quantity as add_quantity
from app.command_line.actions import check as check
from app.command_line.actions import load as load
from app.command_line.actions import mesh as mesh
from app.command_line.actions import read as read
from app.command_line.actions import run as run
from app.foundation.errors import ConvergenceError as ConvergenceError
from app.foundation.errors import EnvironmentProblem as EnvironmentProblem
from app.foundation.errors import GeometryError as GeometryError
from app.foundation.errors import InputError as InputError
from app.foundation.errors import MantleError as MantleError
from app.foundation.errors import StoppedError as StoppedError
from app.foundation.errors import UnusableError as UnusableError
from app.laws.interface_laws import Frictional as Frictional
from app.laws.interface_laws import InterfaceLaw as InterfaceLaw
from app.laws.loads import Load as Load
from app.laws.traction_laws import Traction as Traction

if __name__ == "__main__":
    from app.cli import main

    sys.exit(main())
