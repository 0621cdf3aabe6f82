"""Stem in a cylinder: the force that pushes a press-fitted stem out.

A stem with the radii a < b is pressed into a cylinder of outer radius c, with an interference d.
Without lateral contraction (Poisson's ratio 0) they press on each other by (Lame 1852)

    p = (d / b) / [ (c^2 + b^2) / (c^2 - b^2) / E_c + (b^2 + a^2) / (b^2 - a^2) / E_s ].

Pushed along its axis, the stem sticks first. It slides when friction is used up on its surface of
length L, at the force (Coulomb)  F = mu p 2 pi b L.
"""

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import create_box

from app.laws.contact_laws import Contact
from app.laws.materials import Isotropic
from app.laws.supports import Displacement, Roller
from app.scene.scene import Stage, scene_of
from app.stepping.stages import assemble
from meshes.distribute import TaggedMesh

a, b, c, L = 1.0, 5.0, 10.0, 10.0  # radii and length [mm]
d, mu = 0.01, 0.3  # interference [mm]; friction coefficient
E_s, E_c = 110e3, 17e3  # stem of titanium, cylinder of bone [MPa]

# A quarter; names are given on a box of radius, angle and height.
box = create_box(MPI.COMM_WORLD, [[a, 0, 0], [c, np.pi / 2, L]], [9, 8, 4])
mesh = TaggedMesh.from_markers(
    box,
    regions={"stem": lambda x: x[0] < b + 1e-9, "cylinder": lambda x: x[0] > b - 1e-9},
    boundaries={
        "stem_top": lambda x: np.isclose(x[2], L) & (x[0] < b + 1e-9),
        "cylinder_bottom": lambda x: np.isclose(x[2], 0) & (x[0] > b - 1e-9),
        "along_x": lambda x: np.isclose(x[1], 0),
        "along_y": lambda x: np.isclose(x[1], np.pi / 2),
    },
)
radius, angle, _ = box.geometry.x.T.copy()
box.geometry.x[:, 0] = radius * np.cos(angle)
box.geometry.x[:, 1] = radius * np.sin(angle)

scene = scene_of(
    regions={
        "stem": Isotropic(youngs_modulus=f"{E_s} MPa", poisson_ratio=0),
        "cylinder": Isotropic(youngs_modulus=f"{E_c} MPa", poisson_ratio=0),
    },
    # By default an interference grows through the first stage.
    interfaces={"fit": Contact(friction_coefficient=mu, gap=f"{-d} mm")},
    sides={"fit": (["stem"], ["cylinder"])},
    supports={
        "along_x": Roller(boundary="along_x", axis="y"),
        "along_y": Roller(boundary="along_y", axis="x"),
        "bottom": Roller(boundary="cylinder_bottom", axis="z"),
        "push": Displacement(boundary="stem_top", z="-0.006 mm", history=[0, 1]),
    },
    stages=[Stage(name="fit"), Stage(name="push", increments=6)],
)

forces = []  # on the stem after each step, four times those of the quarter [N]


def keep(step, trial):
    """Record the force of the interface."""
    contact = trial.contact
    forces.append(4 * abs(contact.local.weight @ contact.state.force[:, 2]))


analysis = assemble(scene, mesh)
analysis.run(on_step=keep)
cylinder = (c**2 + b**2) / (c**2 - b**2) / E_c  # 1 / stiffness [1/MPa]
stem = (b**2 + a**2) / (b**2 - a**2) / E_s
force_exact = mu * (d / b) / (cylinder + stem) * 2 * np.pi * b * L

if __name__ == "__main__":
    print("pushed by 0 to 6 um:", ", ".join(f"{force:.5g} N" for force in forces))
    print(f"by Lame and Coulomb {force_exact:.5g} N")
