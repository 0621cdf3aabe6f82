"""Ball in a cup: the friction torque of a ball that spins under load.

A rigid ball of radius R is pressed into an elastic cup and spins about the direction of the load. A
part dA of the surface has the arm s about this axis. All points slide, so by Coulomb's law the
torque of friction is

    M = mu int p s dA.

Ball and cup are meshed apart and slide any distance on each other: `sliding: finite`.
"""

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import create_box, create_submesh, locate_entities

from app.laws.contact_laws import Contact
from app.laws.loads import Force
from app.laws.materials import Isotropic, Rigid
from app.laws.motions import Motion, Rotation
from app.laws.supports import Fixed
from app.results.interface_numbers import ContactSamples
from app.scene.scene import Stage, scene_of
from app.stepping.stages import assemble
from meshes.distribute import TaggedMesh

R, clearance, thickness = 14.0, 0.1, 8.0  # of the ball; between the radii; of the cup [mm]
mu, load = 0.06, 1000.0  # friction coefficient; load along -z [N]

# A box with layers for ball, clearance and cup; the cells of the clearance are left out.
box = create_box(MPI.COMM_WORLD, [[-1, -1, 0], [1, 1, 4]], [12, 12, 4])
box.topology.create_connectivity(3, 3)
kept = np.union1d(
    locate_entities(box, 3, lambda x: x[2] < 1.1), locate_entities(box, 3, lambda x: x[2] > 1.9)
)
bodies = create_submesh(box, 3, kept)[0]
mesh = TaggedMesh.from_markers(
    bodies,
    regions={"ball": lambda x: x[2] < 1.1, "cup": lambda x: x[2] > 1.9},
    boundaries={
        "bore": lambda x: np.isclose(x[2], 0),
        "ball_surface": lambda x: np.isclose(x[2], 1),
        "cup_surface": lambda x: np.isclose(x[2], 2),
        "cup_outside": lambda x: np.isclose(x[2], 4),
    },
)
# Each layer becomes a part of a sphere around the axis -z.
x = bodies.geometry.x
radius = np.interp(x[:, 2], [0, 1, 2, 4], [0.7 * R, R, R + clearance, R + clearance + thickness])
direction = np.column_stack([x[:, :2], -np.ones(len(x))])
x[:] = radius[:, None] * direction / np.linalg.norm(direction, axis=1)[:, None]

polyethylene = Isotropic(youngs_modulus="1 GPa", poisson_ratio=0.4)
faces = ("ball_surface", "cup_surface")
bearing = Contact(friction_coefficient=mu, sliding="finite", between=faces)
rotation = Rotation(axes="xyz", cycle_table=["time [s], rotation z [deg]", "0, 0", "1, 20"])
spin = Motion(region="ball", about="[0, 0, 0] mm", rotation=rotation)
scene = scene_of(
    regions={"ball": Rigid(rigid=True), "cup": polyethylene},
    interfaces={"bearing": bearing},
    sides={"bearing": (["ball"], ["cup"])},
    supports={"outside": Fixed(boundary="cup_outside")},
    motions={"spin": spin},
    loads={"load": Force(boundary="bore", force=f"[0, 0, {-load}] N")},
    stages=[Stage(name="press"), Stage(name="spin", increments=4)],
    order=1,
)
analysis = assemble(scene, mesh)
analysis.run()

problem, solver = analysis.problem, analysis.solver
samples = ContactSamples(problem, problem.trial(*solver.u_and_q()))
moments = np.cross(samples.x, samples.force)[:, 2]  # about the axis, per area [N/mm]
torque = abs(samples.weight @ moments)  # [N mm]
arms = np.hypot(samples.x[:, 0], samples.x[:, 1])  # [mm]
torque_exact = mu * samples.weight @ (samples.pressure * arms)

if __name__ == "__main__":
    print(f"torque {torque:.5g} N mm, by Coulomb {torque_exact:.5g} N mm")
