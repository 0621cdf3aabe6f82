"""Hertz: the pressure under a long cylinder on a flat body.

A cylinder of radius R is pressed on a flat body of the same material by a force F per length. With
the contact modulus E* = E / (2 (1 - nu^2)), the contact has the half-width a and the peak pressure
p_0 (Hertz 1882; Johnson, Contact Mechanics, 1985, eq. 4.43 and 4.45):

    a = sqrt(4 F R / (pi E*)),      p_0 = sqrt(F E* / (pi R)).

Near the contact the cylinder is a parabola. So both bodies are meshed as flat blocks, and the
initial gap of the interface, x^2 / (2 R), is the cylinder. One half is modelled, in plane strain.
"""

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import create_box

from app.laws.contact_laws import Contact
from app.laws.materials import Isotropic
from app.laws.supports import Displacement, Roller
from app.results.interface_numbers import ContactSamples
from app.scene.scene import Stage, scene_of
from app.stepping.stages import assemble
from meshes.distribute import TaggedMesh

E, nu = 1000.0, 0.3  # of both bodies [MPa]
R = 50.0  # radius [mm]
side, thickness = 10.0, 0.2  # of a block [mm]

# A slice of two blocks, whose cells are smaller towards the line of contact.
box = create_box(MPI.COMM_WORLD, [[0, 0, -1], [1, thickness, 1]], [30, 1, 16])
x = box.geometry.x
x[:, 0] = side * x[:, 0] ** 2
x[:, 2] = side * np.sign(x[:, 2]) * np.abs(x[:, 2]) ** 2.5
mesh = TaggedMesh.from_markers(
    box,
    regions={"flat": lambda x: x[2] < 1e-9, "cylinder": lambda x: x[2] > -1e-9},
    boundaries={
        "bottom": lambda x: np.isclose(x[2], -side),
        "top": lambda x: np.isclose(x[2], side),
        "middle": lambda x: np.isclose(x[0], 0),
        "front": lambda x: np.isclose(x[1], 0),
        "back": lambda x: np.isclose(x[1], thickness),
    },
)
material = Isotropic(youngs_modulus=f"{E} MPa", poisson_ratio=nu)
scene = scene_of(
    regions={"flat": material, "cylinder": material},
    interfaces={"contact": Contact(friction_coefficient=0.0, gap=f"x**2 / (2 * {R})")},
    sides={"contact": (["flat"], ["cylinder"])},
    supports={
        "bottom": Roller(boundary="bottom", axis="z"),
        "middle": Roller(boundary="middle", axis="x"),
        "front": Roller(boundary="front", axis="y"),
        "back": Roller(boundary="back", axis="y"),
        "press": Displacement(boundary="top", z="-0.06 mm"),
    },
    stages=[Stage(name="press")],
)
analysis = assemble(scene, mesh)
analysis.run()

problem, solver = analysis.problem, analysis.solver
samples = ContactSamples(problem, problem.trial(*solver.u_and_q()))
F = 2 * samples.weight @ samples.pressure / thickness  # of both halves [N/mm]
peak = samples.pressure.max()  # [MPa]
half_width = samples.x[samples.pressure > 0, 0].max()  # [mm], to the next node
modulus = E / (2 * (1 - nu**2))
peak_exact = np.sqrt(F * modulus / (np.pi * R))
half_width_exact = np.sqrt(4 * F * R / (np.pi * modulus))

if __name__ == "__main__":
    print(f"peak pressure {peak:.4g} MPa, by Hertz {peak_exact:.4g} MPa")
    print(f"half-width {half_width:.3g} mm, by Hertz {half_width_exact:.3g} mm")
