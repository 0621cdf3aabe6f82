"""Press fit: a tube in a tube that is too narrow for it.

Before assembly the outer radius of the inner tube exceeds the inner radius of the outer one by d.
With the radii a < b < c, free ends and no friction, they press on each other by (Lame 1852;
Timoshenko, Strength of Materials, part II, 1956)

    p = (d / b) / [ ((c^2 + b^2) / (c^2 - b^2) + nu_o) / E_o
                  + ((b^2 + a^2) / (b^2 - a^2) - nu_i) / E_i ].

One quarter is modelled: a box, whose x, y and z become radius, angle and height.
"""

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import create_box

from app.laws.contact_laws import Contact
from app.laws.materials import Isotropic
from app.laws.supports import Roller
from app.results.interface_numbers import ContactSamples
from app.scene.scene import Stage, scene_of
from app.stepping.stages import assemble
from meshes.distribute import TaggedMesh

a, b, c = 3.0, 5.0, 7.0  # radii [mm]
d = 0.01  # interference [mm]
E_i, nu_i = 110e3, 0.3  # of the inner tube, titanium [MPa]
E_o, nu_o = 17e3, 0.3  # of the outer tube, bone [MPa]

# Names are given on the box, before its points are moved.
box = create_box(MPI.COMM_WORLD, [[a, 0, 0], [c, np.pi / 2, 1]], [8, 16, 1])
mesh = TaggedMesh.from_markers(
    box,
    regions={"inner": lambda x: x[0] < b + 1e-9, "outer": lambda x: x[0] > b - 1e-9},
    boundaries={
        "bottom": lambda x: np.isclose(x[2], 0),
        "along_x": lambda x: np.isclose(x[1], 0),
        "along_y": lambda x: np.isclose(x[1], np.pi / 2),
    },
)
radius, angle, _ = box.geometry.x.T.copy()
box.geometry.x[:, 0] = radius * np.cos(angle)
box.geometry.x[:, 1] = radius * np.sin(angle)

scene = scene_of(
    regions={
        "inner": Isotropic(youngs_modulus=f"{E_i} MPa", poisson_ratio=nu_i),
        "outer": Isotropic(youngs_modulus=f"{E_o} MPa", poisson_ratio=nu_o),
    },
    interfaces={"fit": Contact(friction_coefficient=0.0, gap=f"{-d} mm")},
    sides={"fit": (["inner"], ["outer"])},
    supports={
        "bottom": Roller(boundary="bottom", axis="z"),
        "along_x": Roller(boundary="along_x", axis="y"),
        "along_y": Roller(boundary="along_y", axis="x"),
    },
    stages=[Stage(name="fit")],
)
analysis = assemble(scene, mesh)
analysis.run()

problem, solver = analysis.problem, analysis.solver
samples = ContactSamples(problem, problem.trial(*solver.u_and_q()))
pressure = samples.weight @ samples.pressure / samples.weight.sum()  # mean [MPa]
outer = ((c**2 + b**2) / (c**2 - b**2) + nu_o) / E_o  # 1 / stiffness [1/MPa]
inner = ((b**2 + a**2) / (b**2 - a**2) - nu_i) / E_i
pressure_exact = (d / b) / (outer + inner)

if __name__ == "__main__":
    print(f"pressure {pressure:.5g} MPa, by Lame {pressure_exact:.5g} MPa")
