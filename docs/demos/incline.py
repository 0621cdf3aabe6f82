"""Block on an incline: at rest below the angle of friction, and sliding above it.

A block rests on a ramp with an inclination a under its weight. Equilibrium asks for the ratio

    T / N = tan a

of the friction force to the normal force. Coulomb's law grants it while tan a < mu; on a steeper
ramp nothing holds the block (Coulomb 1785; any book on statics).
"""

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import create_box

from app.foundation.errors import ConvergenceError
from app.laws.contact_laws import Contact
from app.laws.loads import BodyForce
from app.laws.materials import Isotropic
from app.laws.supports import Fixed
from app.scene.scene import Stage, scene_of
from app.stepping.stages import assemble
from meshes.distribute import TaggedMesh

mu = 0.3  # friction coefficient: its angle is 16.7 degrees
weight = 1e-3  # of the block [N/mm^3]
wood = Isotropic(youngs_modulus="10 GPa", poisson_ratio=0.3)


def friction_over_normal(degrees: float) -> float:
    """Ratio of friction to normal force of a block at rest.

    Raises:
        ConvergenceError: The block slides.
    """
    a = np.radians(degrees)
    box = create_box(MPI.COMM_WORLD, [[0, 0, 0], [20, 10, 6]], [8, 4, 4])
    mesh = TaggedMesh.from_markers(
        box,
        regions={"ramp": lambda x: x[2] <= 3, "block": lambda x: x[2] >= 3},
        boundaries={"ground": lambda x: np.isclose(x[2], 0)},
    )
    # The named mesh is rotated about y; names stay with cells and facets.
    along, up = np.array([np.cos(a), 0, np.sin(a)]), np.array([-np.sin(a), 0, np.cos(a)])
    box.geometry.x[:] = box.geometry.x @ np.array([along, [0, 1, 0], up])

    scene = scene_of(
        regions={"ramp": wood, "block": wood},
        interfaces={"joint": Contact(friction_coefficient=mu)},
        sides={"joint": (["ramp"], ["block"])},
        supports={"ground": Fixed(boundary="ground")},
        loads={"weight": BodyForce(regions=["block"], density=f"[0, 0, {-weight}] N/mm^3")},
        stages=[Stage(name="weight")],
        order=1,
    )
    analysis = assemble(scene, mesh)
    analysis.run()
    contact = analysis.problem.contact
    force = contact.local.weight @ contact.state.force  # sum over the contact points [N]
    return abs(force @ along) / abs(force @ up)


at_rest = friction_over_normal(12.0)
at_rest_exact = np.tan(np.radians(12.0))
try:
    friction_over_normal(20.0)
except ConvergenceError as error:
    sliding = str(error).splitlines()[0]

if __name__ == "__main__":
    print(f"at 12 degrees T / N is {at_rest:.9f}, tan a {at_rest_exact:.9f}")
    print(f"at 20 degrees: {sliding}")
