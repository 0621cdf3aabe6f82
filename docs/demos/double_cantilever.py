"""Double cantilever: a crack that two moments drive through a bond.

Two arms of height h and width b are bonded along a face, but for a part at one end. Opposite
moments M turn these ends apart. The energy release rate does not depend on the length of the crack,

    J = 12 M^2 / (E b^2 h^3)

(Euler and Bernoulli; Rice 1968). So the crack grows at a constant moment, at which J is the
fracture energy G of the bond, for any law of softening.
"""

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import create_box

from app.laws.materials import Isotropic
from app.laws.supports import Displacement, Roller
from app.laws.traction_laws import Cohesive
from app.results.interface_numbers import ContactSamples
from app.scene.scene import Stage, scene_of
from app.stepping.stages import assemble
from meshes.distribute import TaggedMesh

E, G = 70e3, 0.25  # Young's modulus [MPa]; fracture energy [N/mm]
length, b, h = 40.0, 1.0, 3.0  # of an arm [mm]
crack = 12.0  # length of the part that is not bonded [mm]
angle = 0.03  # of each end after the run [rad]

box = create_box(MPI.COMM_WORLD, [[0, 0, -h], [length, b, h]], [40, 1, 4])
mesh = TaggedMesh.from_markers(
    box,
    regions={"lower": lambda x: x[2] <= 0, "upper": lambda x: x[2] >= 0},
    boundaries={
        "lower_end": lambda x: np.isclose(x[0], 0) & (x[2] <= 0),
        "upper_end": lambda x: np.isclose(x[0], 0) & (x[2] >= 0),
        "far_end": lambda x: np.isclose(x[0], length),
        "side": lambda x: np.isclose(x[1], 0),
    },
)
arm = Isotropic(youngs_modulus=f"{E} MPa", poisson_ratio=0)
bond = Cohesive(
    friction_coefficient=0.0,
    stiffness="1e4 MPa/mm",
    tensile_strength="20 MPa",
    shear_strength="20 MPa",
    tensile_energy=f"{G} N/mm",
    shear_energy=f"{G} N/mm",
    unbonded=f"min(1, max(0, 1000 * ({crack} - x)))",
)
scene = scene_of(
    regions={"lower": arm, "upper": arm},
    interfaces={"bond": bond},
    sides={"bond": (["lower"], ["upper"])},
    supports={
        "far_end": Roller(boundary="far_end", axis="z"),
        "side": Roller(boundary="side", axis="y"),
        "turn_lower": Displacement(boundary="lower_end", x=f"{-angle} * (z + {h / 2})"),
        "turn_upper": Displacement(boundary="upper_end", x=f"{angle} * (z - {h / 2})"),
    },
    # In a step the bond dissipates at most this energy; the load may fall.
    stages=[Stage(name="turn", increments=5, fracture_step="0.25 N mm")],
)
analysis = assemble(scene, mesh)
analysis.run()

# The forces of the bond balance the moment at the end of an arm.
problem, solver = analysis.problem, analysis.solver
samples = ContactSamples(problem, problem.trial(*solver.u_and_q()))
forces = samples.weight[:, None] * samples.force  # at each point [N]
moment = abs(samples.x[:, 0] @ forces[:, 2])  # [N mm]
J = 12 * moment**2 / (E * b**2 * h**3)  # [N/mm]

if __name__ == "__main__":
    print(f"energy release rate {J:.4g} N/mm at the moment {moment:.4g} N mm, fracture energy {G}")
