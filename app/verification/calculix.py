"""CalculiX on the arrays of a case: its input file, and the displacement in its results.

Contact is of type SURFACE TO SURFACE: a penalty at the integration points of matched facets, with a
stick slope for friction. Both are numbers that its user chooses. On the tapered stem 1e4 with 1e3
MPa/mm and 1e5 with 1e4 converge; 1e5 with 1e5, 1e6 with 1e4 and contact of nodes to surfaces do not
at 5 mm.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import batched
from pathlib import Path

import numpy as np

from app.arrays import Bools, Floats, Ints
from app.errors import InputError
from app.verification.peer_model import PeerModel

# The faces S1 to S4 of a C3D4, by the node that each leaves out.
FACE_WITHOUT = {3: 1, 2: 2, 0: 3, 1: 4}
FIELD = 12  # characters of a number in a .frd file


def input_text(model: PeerModel, penalty: float, slope: float) -> str:
    """The input file of a model: one step, small displacements, displacement of all nodes.

    Args:
        model: The model.
        penalty: Pressure per penetration [MPa/mm].
        slope: Shear per slip of points that stick [MPa/mm].
    """
    return "\n".join(_lines(model, penalty, slope)) + "\n"


def _lines(model: PeerModel, penalty: float, slope: float) -> Iterator[str]:
    yield "*NODE, NSET=ALL"
    for k in range(len(model.points)):
        yield f"{k + 1}, " + ", ".join(map(_real, model.points[k]))
    for r in range(len(model.young)):
        yield f"*ELEMENT, TYPE=C3D4, ELSET=R{r}"
        for k in np.flatnonzero(model.region == r):
            yield f"{k + 1}, " + ", ".join(str(node + 1) for node in model.cells[k])
        yield f"*MATERIAL, NAME=M{r}"
        yield "*ELASTIC"
        yield f"{_real(model.young[r])}, {_real(model.poisson[r])}"
        yield f"*SOLID SECTION, ELSET=R{r}, MATERIAL=M{r}"
    yield "*NSET, NSET=FIXED"
    yield from _listed(model.fixed + 1)
    for i, face in enumerate(model.interfaces):
        for side, cells, nodes in (
            ("A", face.first_cells, face.first),
            ("B", face.second_cells, face.second),
        ):
            yield f"*SURFACE, NAME={side}{i}, TYPE=ELEMENT"
            for cell, number in zip(cells, _faces(model.cells[cells], nodes), strict=True):
                yield f"{cell + 1}, S{number}"
        yield f"*SURFACE INTERACTION, NAME=I{i}"
        yield "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"
        yield _real(penalty)
        if face.friction:
            yield "*FRICTION"
            yield f"{_real(face.friction)}, {_real(slope)}"
        # Slave and master.
        yield f"*CONTACT PAIR, INTERACTION=I{i}, TYPE=SURFACE TO SURFACE"
        yield f"B{i}, A{i}"
    yield "*BOUNDARY"
    yield "FIXED, 1, 3"
    yield "*STEP"
    yield "*STATIC"
    yield "1., 1."
    yield "*CLOAD"
    for k, c in np.argwhere(model.forces):
        yield f"{k + 1}, {c + 1}, {_real(model.forces[k, c])}"
    yield "*NODE FILE"
    yield "U"
    yield "*END STEP"


def _real(value: float) -> str:
    """A number: the program reads the first 20 characters of one."""
    return f"{value:.12e}"


def _listed(numbers: Ints) -> Iterable[str]:
    return (", ".join(map(str, some)) for some in batched(numbers, 12))


def _faces(cells: Ints, nodes: Ints) -> list[int]:
    """Number of the face of each cell (k, 4) that has some nodes (k, 3)."""
    out: Bools = ~(cells[:, :, None] == nodes[:, None, :]).any(axis=2)
    return [FACE_WITHOUT[int(k)] for k in np.argmax(out, axis=1)]


def displacement(path: Path, count: int) -> Floats:
    """Displacement of the nodes at the end of the step, from a .frd file (n, 3) [mm].

    Args:
        path: The file.
        count: Number of nodes.

    Raises:
        InputError: It holds no displacement at time 1: the program has not come to the end.
    """
    found: Floats | None = None
    time, inside = 0.0, False
    for line in path.read_text(encoding="ascii", errors="replace").splitlines():
        if line.startswith("  100C"):
            time = float(line[12:24])
        elif line.startswith(" -4"):
            inside = line.split()[1] == "DISP" and abs(time - 1.0) < 1e-6
            found = np.full((count, 3), np.nan) if inside else found
        elif line.startswith(" -3"):
            inside = False
        elif inside and found is not None and line.startswith(" -1"):
            row = int(line[3:13]) - 1
            found[row] = [float(line[13 + FIELD * k : 13 + FIELD * (k + 1)]) for k in range(3)]
    if found is None or np.isnan(found).any():
        raise InputError(f"{path}: holds no displacement of all nodes at the end of the step")
    return found
