"""Blocks of a box whose interfaces meet on lines and in points."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from meshes import write_msh
from meshes.data import MeshData
from tests.cases.blocks import box

MODULUS = 700.0  # MPa
POISSON = 0.25
PRESSURE = 3.0  # MPa


# Blocks of a box 4 x 3 x 4 mm by the centres of cells.
T = {
    "left": lambda x: (x[:, 2] < 2) & (x[:, 0] < 2),
    "right": lambda x: (x[:, 2] < 2) & (x[:, 0] > 2),
    "top": lambda x: x[:, 2] > 2,
}
LYING_T = {
    "upper": lambda x: (x[:, 0] > 2) & (x[:, 2] > 2),
    "lower": lambda x: (x[:, 0] > 2) & (x[:, 2] < 2),
    "side": lambda x: x[:, 0] < 2,
}
CROSS = {
    "a": lambda x: (x[:, 0] < 2) & (x[:, 2] < 2),
    "b": lambda x: (x[:, 0] > 2) & (x[:, 2] < 2),
    "c": lambda x: (x[:, 0] < 2) & (x[:, 2] > 2),
    "d": lambda x: (x[:, 0] > 2) & (x[:, 2] > 2),
}
EIGHT = {
    f"b{i}{j}{k}": lambda x, at=(i, j, k): ((x > [2, 1.5, 2]) == np.array(at, bool)).all(axis=1)
    for i, j, k in product((0, 1), repeat=3)
}
THREE_UNDER_ONE = {
    "one": lambda x: (x[:, 2] < 2) & (x[:, 0] < 1),
    "two": lambda x: (x[:, 2] < 2) & (x[:, 0] > 1) & (x[:, 0] < 3),
    "three": lambda x: (x[:, 2] < 2) & (x[:, 0] > 3),
    "top": lambda x: x[:, 2] > 2,
}


def pairs(data: MeshData) -> list[tuple[str, str]]:
    """Regions that share facets."""
    cell, _, behind = data.facets_between_regions
    names = {tag: name for name, tag in data.regions.items()}
    both = np.sort(np.column_stack([data.cell_tags[cell], data.cell_tags[behind]]), axis=1)
    return [(names[a], names[b]) for a, b in np.unique(both, axis=0).tolist()]


def scene(
    folder: Path,
    blocks: dict[str, Any],
    *laws: dict[str, Any],
    cells: Sequence[int] = (4, 3, 4),
    size: Sequence[float] = (4.0, 3.0, 4.0),
    turn: int = 0,
    order: int = 1,
) -> dict[str, Any]:
    """Blocks in a frictionless box under pressure. Interfaces take the laws in turn.

    The order of the interfaces is shifted by some places.
    """
    data = box(blocks, size, cells)
    write_msh(data, folder / "blocks.msh")
    every = pairs(data)
    every = every[turn:] + every[:turn]
    sides = {f"{a}_{b}": [[a], [b]] for a, b in every}
    return {
        "geometry": {"kind": "file", "path": str(folder / "blocks.msh"), "interfaces": sides},
        "mesh": {"order": order, "size": "1 mm"},
        "regions": {
            name: {
                "youngs_modulus": f"{MODULUS} MPa",
                "poisson_ratio": POISSON,
                "tissue": "other",
            }
            for name in blocks
        },
        "interfaces": {name: dict(laws[k % len(laws)]) for k, name in enumerate(sides)},
        "supports": {
            name: {"kind": "roller", "boundary": name, "axis": name[0]}
            for name in ("x0", "x1", "y0", "y1", "z0")
        },
        "loads": {"press": {"kind": "pressure", "boundary": "z1", "pressure": f"{PRESSURE} MPa"}},
    }


def press_on_all_sides(text: dict[str, Any]) -> None:
    """Press a scene with the same pressure on all sides. Three sides are on rollers."""
    text["supports"] = {name: text["supports"][name] for name in ("x0", "y0", "z0")}
    text["loads"] = {
        name: {"kind": "pressure", "boundary": name, "pressure": f"{PRESSURE} MPa"}
        for name in ("x1", "y1", "z1")
    }


def contact(friction: float) -> dict[str, Any]:
    return {"kind": "contact", "friction_coefficient": friction}


# Next to a line where three bodies meet, one interface has an edge.
EDGE = {
    "foot": lambda x: (x[:, 1] > 1) & (x[:, 1] < 2) & (x[:, 2] < 2),
    "side": lambda x: x[:, 1] > 2,
    "rest": lambda x: (x[:, 1] < 1) | ((x[:, 1] < 2) & (x[:, 2] > 2)),
}
# The edge is at a corner of the interface.
CORNER = EDGE | {
    "foot": lambda x: EDGE["foot"](x) & (x[:, 0] > 2),
    "rest": lambda x: EDGE["rest"](x) | (EDGE["foot"](x) & (x[:, 0] < 2)),
}
# Strong enough to hold any pressure of these tests.
STRONG = {
    "kind": "cohesive",
    "friction_coefficient": 0.2,
    "stiffness": "5e4 MPa/mm",
    "tensile_strength": "8 MPa",
    "shear_strength": "8 MPa",
    "tensile_energy": "0.3 N/mm",
    "shear_energy": "0.3 N/mm",
}
