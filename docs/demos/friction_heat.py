"""Heat of friction: a pad slides on a bar that is cooled at its other end.

A pad is pressed on a bar by p and slides with the speed v. Friction releases the power mu p v per
area. The pad is insulated, so all heat leaves through the bar of length L and conductivity k. In
the steady state the sliding surface is warmer than the cooled end by (Fourier 1822)

    dT = mu p v L / k.
"""

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import create_box

from app.laws.contact_laws import Contact
from app.laws.heat_conditions import FixedTemperature
from app.laws.loads import Pressure
from app.laws.materials import Isotropic
from app.laws.supports import Displacement, Fixed
from app.laws.thermal import Thermal
from app.scene.scene import Stage, TimeOptions, scene_of
from app.stepping.stages import assemble
from meshes.distribute import TaggedMesh

mu, p = 0.3, 2.0  # friction coefficient; pressure [MPa]
v, duration = 0.02, 30.0  # speed [mm/s]; time of sliding [s]
L, k = 2.0, 0.2  # length of the bar [mm]; conductivity [W/(m K)] = [mW/(mm K)]
cold = 20.0  # temperature of the cooled end [degC]

box = create_box(MPI.COMM_WORLD, [[0, 0, 0], [6, 3, 3]], [6, 3, 6])
mesh = TaggedMesh.from_markers(
    box,
    regions={"bar": lambda x: x[2] <= L, "pad": lambda x: x[2] >= L},
    boundaries={"bottom": lambda x: np.isclose(x[2], 0), "top": lambda x: np.isclose(x[2], 3)},
)
# A small heat capacity: the steady state is reached after a few seconds.
thermal = Thermal(
    conductivity=f"{k} W/(m K)",
    density="1000 kg/m^3",
    specific_heat="100 J/(kg K)",
    initial_temperature=f"{cold} degC",
)
material = Isotropic(youngs_modulus="2 GPa", poisson_ratio=0, thermal=thermal)
scene = scene_of(
    regions={"bar": material, "pad": material},
    # Half of the heat enters each side; there is no jump of temperature between them.
    interfaces={"joint": Contact(friction_coefficient=mu, friction_heating=0.5)},
    sides={"joint": (["bar"], ["pad"])},
    supports={
        "ground": Fixed(boundary="bottom"),
        "slide": Displacement(boundary="top", x=f"{v * duration} mm", y="0 mm", history=[0, 1]),
    },
    loads={"press": Pressure(boundary="top", pressure=f"{p} MPa")},
    heat={"cooled": FixedTemperature(boundary="bottom", temperature=f"{cold} degC")},
    stages=[Stage(name="press"), Stage(name="slide", duration=f"{duration} s", increments=10)],
    time=TimeOptions(tolerance="0.01 K"),
    order=1,
)
analysis = assemble(scene, mesh)
analysis.run()

# Temperatures of the nodes on the sliding surface; their mean, as the pressure is not quite even.
operators = analysis.heating.operators
height = operators.forms.space.tabulate_dof_coordinates()[:, 2]
surface = np.isclose(height[: operators.forms.owned], L)
rise = analysis.heating.temperatures()[0, surface].mean() - 273.15 - cold  # [K]
rise_exact = mu * p * v * L / k

if __name__ == "__main__":
    print(f"temperature rise {rise:.4g} K, exact {rise_exact:.4g} K")
