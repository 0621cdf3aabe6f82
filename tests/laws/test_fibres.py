"""Fibres that follow an axis: rings against closed forms, and refused axes."""

from __future__ import annotations

import math
from typing import Literal

from mpi4py import MPI

import numpy as np
import pytest

from app.case.case import Case, load_case
from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.laws.fibres import Circumferential, Radial
from app.results.stresses import Stresses
from app.simulation.model import Model
from app.soundness import well_posedness
from app.system.timing import Timing
from meshes.distribute import TaggedMesh
from tests import support
from tests.cases.heated import Heated, cure, setting
from tests.support import build

RING = support.CONFIGS / "verification" / "fibre_ring.yaml"
LAYS = pytest.mark.parametrize("lay", ["circumferential", "radial"])
FREE = "{strain: [2e-3, 1e-3, 3e-3, 0, 0, 1e-3]}"


def ring(lay: str, *overrides: str) -> Case:
    return load_case(RING, (f"regions.ring.fibre.kind={lay}", *overrides)).config


def turned(tagged: TaggedMesh, shift: Floats) -> TaggedMesh:
    """The mesh in place, with its x axis moved to y, y to z and z to x."""
    x = tagged.mesh.geometry.x
    x[:] = np.roll(x, 1, axis=1) + shift
    return tagged


@LAYS
def test_fibres_ring_is_independent_of_its_axis(lay: str) -> None:
    shift = np.array([3.0, -7.0, 11.0])
    here = support.solve(ring(lay, "mesh.size=1 mm"))
    case = ring(
        lay,
        "mesh.size=1 mm",
        "regions.ring.fibre.axis=[-2, 0, 0]",
        "regions.ring.fibre.through=[50 mm, -7 mm, 11 mm]",
        "supports.symmetry_x.axis=y",
        "supports.symmetry_y.axis=z",
        "supports.ends.axis=x",
    )
    there = support.solve(case, tagged=turned(support.mesh(case), shift))
    u, moved = (s.displacement("ring")[1] for s in (here, there))
    assert support.difference(np.roll(u, 1, axis=1), moved) < 1e-9
    σ, moved = here.stress("ring"), there.stress("ring")
    assert support.difference(np.roll(σ, (1, 1), axis=(1, 2)), moved) < 1e-9


@pytest.mark.parametrize(("lay", "order"), [("circumferential", 1), ("radial", 2)])
def test_fibres_balances_close_with_free_strain(lay: str, order: int) -> None:
    """All forms of a region integrate at the same points."""
    case = ring(lay, "mesh.size=2 mm", f"mesh.order={order}", f"regions.ring.eigenstrains=[{FREE}]")
    assert support.solve(case, balances=True).balances.max() < 1e-9


@LAYS
def test_fibres_energy_is_half_the_work_of_pressure(lay: str) -> None:
    solved = support.solve(ring(lay, "mesh.size=1 mm"))
    stresses = Stresses(solved.problem)
    _, volumes = stresses.points_and_volumes("ring")
    energy = float((stresses.energy_density("ring") * volumes).sum())
    work = solved.problem.f.dot(solved.solver.u_and_q()[0])
    assert energy == pytest.approx(0.5 * work, rel=1e-9)


def test_fibres_cured_ring_is_elastic() -> None:
    """The ring is fully cured from the start.

    Two steps load it by pressure and uniform free strain.
    """
    text = RING.read_text().replace("ring.geo", str(RING.with_name("ring.geo")))
    change = "mesh.size=2 mm"
    rate = Heated.make(text, setting(cure("ring", initial=1.0)), change)
    for time in (0.5, 1.0):
        rate.problem.set_time(time)
        rate.set(1.0, 1e-3 * time, "ring")
        rate.step()
    strain = "regions.ring.eigenstrains=[{strain: 1e-3}]"
    total = support.solve(text, change, strain)
    computed, expected = rate.problem.u.x.array, total.problem.u.x.array
    assert support.difference(computed, expected) < 1e-10
    assert support.difference(rate.stress("ring"), total.stress("ring")) < 1e-9
    assert rate.balance.energy < 1e-9


@LAYS
def test_fibres_frames_rotate_with_the_fibre(lay: Literal["circumferential", "radial"]) -> None:
    kind = Radial if lay == "radial" else Circumferential
    fibre = kind.model_construct(axis=(0.0, 0.6, 0.8), through=(1.0, 2.0, 3.0))
    x = np.random.default_rng(1).normal(size=(5, 3))
    frames = fibre.frames(x)
    assert np.einsum("nki,nkj->nij", frames, frames) == pytest.approx(
        np.broadcast_to(np.eye(3), (5, 3, 3))
    )
    assert np.linalg.det(frames) == pytest.approx(np.ones(5))
    m, away = frames[:, :, 2], x - fibre.through
    assert m @ fibre.axis == pytest.approx(0)
    along = np.einsum("ni,ni->n", m, away)
    away = np.linalg.norm(np.cross(fibre.axis, away), axis=1)
    assert along == pytest.approx(away if lay == "radial" else 0 * away, abs=1e-12)


# Heat

HOT = """
geometry: {kind: file, path: RING}
mesh: {size: 0.5 mm, order: 1}
regions:
  ring:
    kind: conductor
    tissue: other
    thermal: {axial_conductivity: 0.9 W/(m K), transverse_conductivity: 0.3 W/(m K),
              fibre: {kind: radial}, density: 1000 kg/m^3, specific_heat: 1000 J/(kg K),
              initial_temperature: 40 degC}
heat:
  warm: {kind: temperature, boundary: inside, temperature: 50 degC}
  cold: {kind: temperature, boundary: outside, temperature: 40 degC}
stages: [{name: conduct, steady: true}]
""".replace("RING", str(RING.with_name("ring.geo")))


@pytest.mark.parametrize(("lay", "conductivity"), [("radial", 0.9), ("circumferential", 0.3)])
@pytest.mark.parametrize("overrides", [(), ("mesh.order=2", "mesh.curved=true")])
def test_fibres_heat_through_a_ring(
    lay: str, conductivity: float, overrides: tuple[str, ...]
) -> None:
    """A quarter of 2 π k L ΔT / log(b / a) flows.

    The k is that of the fibre only if the fibre is radial.
    """
    case = support.case(HOT, f"regions.ring.thermal.fibre.kind={lay}", *overrides)
    model = Model(case, MPI.COMM_WORLD, {}, Timing(), lambda: "")
    model.run(on_trouble=print)
    flow = model.numbers(None)["thermal"]["flows"]["into"]["warm"]
    exactly = math.pi / 2 * conductivity * 0.5 * 10 / math.log(2)
    assert flow == pytest.approx(exactly, rel=3e-3)


# Where the axis runs


@pytest.mark.parametrize(
    ("through", "axis", "refused"),
    [
        ("[0 mm, 0 mm, 0 mm]", "[0, 0, 1]", False),
        ("[4.9 mm, 0 mm, 0 mm]", "[0, 0, 1]", False),
        ("[0 mm, 0 mm, -1 mm]", "[1, 1, 0]", False),
        ("[5 mm, 0 mm, 9 mm]", "[0, 0, 1]", True),  # an edge of the mesh
        ("[5 mm, 5 mm, 0 mm]", "[0, 0, -3]", True),
        ("[0 mm, 0 mm, 1 mm]", "[1, 1, 0]", True),
        ("[0 mm, 8 mm, 0 mm]", "[1, 0, 0]", True),  # in a face of the mesh
    ],
)
@pytest.mark.parametrize("of_heat", [False, True])
def test_fibres_refuse_an_axis_inside_the_region(
    through: str, axis: str, refused: bool, of_heat: bool
) -> None:
    key = "regions.ring.thermal.fibre" if of_heat else "regions.ring.fibre"
    changes = (f"{key}.through={through}", f"{key}.axis={axis}", "mesh.size=2 mm")
    case = support.case(HOT, *changes) if of_heat else ring("radial", *changes)
    computed = well_posedness.mesh_parts(case, build(case))
    if not refused:
        well_posedness.check_on_mesh(case, computed)
        return
    with pytest.raises(InputError, match=rf"^{key}: its axis meets the region, e.g. at \(.*axis o"):
        well_posedness.check_on_mesh(case, computed)
