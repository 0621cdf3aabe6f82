"""A load of the user: the pressure of a fluid, which increases with depth.

A fluid of weight gamma per volume, with its surface at the height H, presses on a wall by
p = gamma (H - z). A load is one class with its keys and its work in a displacement, in UFL; mantle
finds the nodal forces. The wall is a block of width b, pressed on a floor by a pressure on its top,
and held by friction alone. The friction force is the resultant (any book on statics):

    F = gamma b H^2 / 2.
"""

from typing import Literal

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import create_box
from ufl import dot

from app.laws.contact_laws import Contact
from app.laws.loads import Load, Pressure
from app.laws.materials import Isotropic
from app.laws.supports import Fixed
from app.scene.scene import Stage, scene_of
from app.schema.units import Length, Number
from app.stepping.stages import assemble
from meshes.distribute import TaggedMesh


class FluidPressure(Load):
    """A pressure that increases linearly below the surface of a fluid."""

    kind: Literal["fluid_pressure"] = "fluid_pressure"
    boundary: str
    """Boundary of the geometry."""
    surface: Length
    """Height of the surface of the fluid."""
    weight: Number
    """Weight of the fluid per volume [N/mm^3]."""

    def work(self, v, body):
        """Return the work on a body in a displacement v (3,), a UFL form."""
        ds = body.ds(self.boundary)
        if ds is None:
            return 0
        pressure = body.constant(self.weight) * (body.constant(self.surface) - body.x[2])
        return -pressure * dot(body.n, v) * ds


b, H = 10.0, 20.0  # width of the wall, and its height [mm]
gamma = 1e-3  # [N/mm^3]

box = create_box(MPI.COMM_WORLD, [[0, 0, -4], [8, b, H]], [4, 4, 12])
mesh = TaggedMesh.from_markers(
    box,
    regions={"floor": lambda x: x[2] <= 0, "wall": lambda x: x[2] >= 0},
    boundaries={
        "ground": lambda x: np.isclose(x[2], -4),
        "wet": lambda x: np.isclose(x[0], 0) & (x[2] >= 0),
        "top": lambda x: np.isclose(x[2], H),
    },
)
scene = scene_of(
    regions={name: Isotropic(youngs_modulus="1 GPa", poisson_ratio=0.3) for name in mesh.regions},
    interfaces={"joint": Contact(friction_coefficient=0.6)},
    sides={"joint": (["floor"], ["wall"])},
    supports={"ground": Fixed(boundary="ground")},
    loads={
        "fluid": FluidPressure(boundary="wet", surface=f"{H} mm", weight=gamma),
        "push": Pressure(boundary="top", pressure="0.1 MPa"),
    },
    stages=[Stage(name="fill")],
)
analysis = assemble(scene, mesh)
analysis.run()
contact = analysis.problem.contact
friction = abs((contact.local.weight @ contact.state.force)[0])
friction_exact = gamma * b * H**2 / 2

if __name__ == "__main__":
    print(f"friction force {friction:.9f} N, gamma b H^2 / 2 = {friction_exact:.9f} N")
