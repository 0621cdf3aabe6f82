"""A law of the user: an elastic layer between two blocks.

A thin layer transmits a traction in proportion to the jump between its sides, t = k [u]. A law is
one class with its keys and its formula, in UFL; mantle finds the derivative. Two blocks with the
layer between them are springs in series: a tension s lengthens them by

    u = s (h_1 / E_1 + 1 / k + h_2 / E_2).
"""

from typing import Literal

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import create_box

from app.laws.loads import Pressure
from app.laws.materials import Isotropic
from app.laws.supports import Fixed
from app.laws.traction_laws import Traction
from app.laws.values import StiffnessField
from app.scene.scene import Stage, scene_of
from app.stepping.stages import assemble
from meshes.distribute import TaggedMesh


class SoftLayer(Traction):
    """A thin elastic layer."""

    kind: Literal["soft_layer"] = "soft_layer"
    stiffness: StiffnessField
    """Traction per jump."""

    def traction(self, point):
        """Return the traction at a jump (3,); all arguments are UFL expressions."""
        return self.stiffness * point.gap_vector


h = 2.0  # height of a block [mm]
E_lower, E_upper = 2000.0, 1000.0  # [MPa]; Poisson's ratio is 0, so that the base can be clamped
k = 50.0  # stiffness of the layer [MPa/mm]
s = 3.0  # tension [MPa]

box = create_box(MPI.COMM_WORLD, [[0, 0, 0], [4, 4, 2 * h]], [2, 2, 4])
mesh = TaggedMesh.from_markers(
    box,
    regions={"lower": lambda x: x[2] <= h, "upper": lambda x: x[2] >= h},
    boundaries={
        "bottom": lambda x: np.isclose(x[2], 0),
        "top": lambda x: np.isclose(x[2], 2 * h),
    },
)
scene = scene_of(
    regions={
        "lower": Isotropic(youngs_modulus=f"{E_lower} MPa", poisson_ratio=0),
        "upper": Isotropic(youngs_modulus=f"{E_upper} MPa", poisson_ratio=0),
    },
    interfaces={"layer": SoftLayer(stiffness=f"{k} MPa/mm")},
    sides={"layer": (["lower"], ["upper"])},
    supports={"base": Fixed(boundary="bottom")},
    loads={"pull": Pressure(boundary="top", pressure=f"{-s} MPa")},
    stages=[Stage(name="pull")],
    order=1,
)
analysis = assemble(scene, mesh)
analysis.run()
lengthening = max(u.x.array.max() for u in analysis.problem.displacements())  # [mm]
lengthening_exact = s * (h / E_lower + 1 / k + h / E_upper)

if __name__ == "__main__":
    print(f"lengthening {lengthening:.10g} mm, exact {lengthening_exact:.10g} mm")
