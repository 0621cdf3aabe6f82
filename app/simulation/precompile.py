"""Compile what the shipped cases need, when an image is built.

    python3 -m app.simulation.precompile

Compiled forms depend on materials, laws and orders, not on the mesh: each case is set up, not
solved, with elements of first and second order. Each in a process of its own, as when it is run:
the names of compiled expressions depend on what a process has made before them.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path

from mpi4py import MPI

import numpy as np

import configs
import meshes
from app.case.case import Case, load
from app.case.femurs import BONE, Femur, IntactFemur
from app.case.geometries import Blocks
from app.mechanics.contact_law import PointLaw
from app.scene.laws import Coulomb
from app.simulation.model import Model
from app.system import form_cache
from app.system.timing import Timing
from meshes.data import MeshData
from meshes.distribute import TaggedMesh, distribute
from meshes.tags import number

log = logging.getLogger("mantle")

ORDERS = (1, 2)
COARSER = 2.0
EDGE = 10.0  # mm


class Tiny(Model):
    """A model that is never solved: of a femur, a few cells stand for it."""

    def _mesh(self, comm: MPI.Comm) -> tuple[TaggedMesh, str, None]:
        if isinstance(self._case.geometry, Femur | IntactFemur):
            return distribute(stacked(self._case), comm), "", None
        tagged, digest, _ = super()._mesh(comm)
        return tagged, digest, None


def stacked(case: Case) -> MeshData:
    """The bodies of a femur as blocks, one upon the other; its bone is of two halves."""
    femur = case.geometry
    size = f"[{EDGE}, {EDGE}, {EDGE}] mm"
    names = [*(name for name in femur.region_names if name not in BONE), "bone"]
    blocks = Blocks.model_validate({"blocks": [{"name": n, "size": size} for n in names]})
    data = meshes.build(blocks, case.mesh.model_copy(update={"size": EDGE / 2, "far_size": None}))
    tags = number(femur.region_names)
    middle = data.points[data.cells[:, :4], 0].mean(axis=1)
    bone = np.where(middle < EDGE / 2, *(tags[name] for name in BONE))
    cells = np.where(data.cell_tags == data.regions["bone"], bone, data.cell_tags)
    # Away from the interfaces, as on the femur.
    sides = dict.fromkeys(femur.boundary_names, "top") | {"stem_trunnion": "bottom"}
    return replace(
        data,
        cell_tags=cells.astype(np.int32),
        regions=tags,
        boundaries={name: data.boundaries[sides[name]] for name in femur.boundary_names},
        interfaces=femur.interface_sides,
    )


def warm(path: Path, order: int) -> None:
    """Set a case up on a coarse mesh with elements of an order."""
    mesh = load(path).config.mesh
    sizes = {"size": mesh.size, "far_size": mesh.far_size}
    overrides = [f"mesh.order={order}", "output.error=false", "output.probes={}"]
    overrides += [f"mesh.{name}={COARSER * size} mm" for name, size in sizes.items() if size]
    case = load(path, overrides).config
    form_cache.share()
    model = Tiny(case, MPI.COMM_SELF, {}, Timing(), str)
    for m in model.mechanics:
        m.balance(np.zeros(3))


def laws() -> None:
    """Compile the contact law of points on one to three faces, without friction and with it."""
    faces, frictional = np.array([*product((1, 2, 3), (0, 1))]).T
    normals = np.broadcast_to(np.eye(3), (len(faces), 3, 3))
    PointLaw(MPI.COMM_SELF, normals, faces, (Coulomb(0.0), Coulomb(0.3)), frictional)


def _alone(arguments: tuple[str, ...]) -> None:
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-m", "app.simulation.precompile", *arguments], check=True)
    log.info("%s: %.1f s", " ".join(arguments), time.perf_counter() - begin)


def main() -> None:
    """Set all cases up that stand in the folder of cases itself."""
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    paths = sorted(map(str, configs.FOLDER.glob("*.yaml")))
    parts = [("laws",), *((path, str(order)) for order in ORDERS for path in paths)]
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        list(pool.map(_alone, parts))


if __name__ == "__main__":
    match sys.argv[1:]:
        case []:
            main()
        case ["laws"]:
            laws()
        case [path, order]:
            warm(Path(path), int(order))
