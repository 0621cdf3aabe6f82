"""Patch test: two blocks of unlike stiffness, pressed on each other.

Two blocks stand on each other without friction, and a pressure p acts on top. Each block shortens
as a free column, and they widen by different amounts, so the upper one slips on the lower one. The
contact pressure is p at every point, and the top moves down by

    u = p (h_1 / E_1 + h_2 / E_2).

Elements that contain linear displacements give this exactly, on any mesh (Irons and Razzaque 1972;
for contact Taylor and Papadopoulos 1991).
"""

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import create_box

from app.laws.contact_laws import Contact
from app.laws.loads import Pressure
from app.laws.materials import Isotropic
from app.laws.supports import Roller
from app.results.interface_numbers import ContactSamples
from app.scene.scene import Stage, scene_of
from app.stepping.stages import assemble
from meshes.distribute import TaggedMesh

# A box of 4 mm. Its inner nodes are moved irregularly, but for those on the interface.
height = 2.0  # of each block [mm]
box = create_box(MPI.COMM_WORLD, [[0, 0, 0], [4, 4, 2 * height]], [4, 4, 4])
x = box.geometry.x
within = (x > 1e-9) & (x < 4 - 1e-9)
within[:, 2] &= np.abs(x[:, 2] - height) > 1e-9
x += within * 0.2 * np.sin(100 * x[:, [1, 2, 0]] + x)

# Names of its parts, by the places of their vertices.
mesh = TaggedMesh.from_markers(
    box,
    regions={"lower": lambda x: x[2] < height + 1e-9, "upper": lambda x: x[2] > height - 1e-9},
    boundaries={
        "bottom": lambda x: np.isclose(x[2], 0),
        "top": lambda x: np.isclose(x[2], 2 * height),
        "left": lambda x: np.isclose(x[0], 0),
        "front": lambda x: np.isclose(x[1], 0),
    },
)

# Laws are plain objects. Values are text with a unit, or numbers in mm, N and MPa.
E_lower, E_upper, p = 1000.0, 2000.0, 3.0  # [MPa]
scene = scene_of(
    regions={
        "lower": Isotropic(youngs_modulus=f"{E_lower} MPa", poisson_ratio=0.3),
        "upper": Isotropic(youngs_modulus=f"{E_upper} MPa", poisson_ratio=0.2),
    },
    interfaces={"joint": Contact(friction_coefficient=0.0)},
    sides={"joint": (["lower"], ["upper"])},
    supports={
        "base": Roller(boundary="bottom", axis="z"),
        "left": Roller(boundary="left", axis="x"),
        "front": Roller(boundary="front", axis="y"),
    },
    loads={"press": Pressure(boundary="top", pressure=f"{p} MPa")},
    stages=[Stage(name="press")],
    order=1,
)

analysis = assemble(scene, mesh)
analysis.run()

# The state of the last step: contact, and the displacement of each body.
problem, solver = analysis.problem, analysis.solver
samples = ContactSamples(problem, problem.trial(*solver.u_and_q()))
pressure = samples.pressure  # at each contact point [MPa]
shortening = -min(u.x.array[2::3].min() for u in problem.displacements())  # [mm]
shortening_exact = p * (height / E_lower + height / E_upper)

if __name__ == "__main__":
    print(f"pressure {pressure.min():.12g} to {pressure.max():.12g} MPa, exact {p} MPa")
    print(f"shortening {shortening:.12g} mm, exact {shortening_exact:.12g} mm")
