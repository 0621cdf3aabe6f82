"""Setting cement: bone cement that keeps all its heat.

The degree of cure a of a block of bone cement grows by the autocatalytic rate

    da/dt = k_0 exp(-E_a / (R T)) a^m (1 - a)^n

(Baliga, Rose and Ahmed 1992 for bone cement). Q is the heat of the reaction, C the heat capacity,
both per volume. Without losses the block warms in proportion, T = T_0 + (Q / C) (a - a_0). The time
up to a degree a is then an integral:

    t = int_(a_0)^a  da / (da/dt).
"""

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import create_box
from scipy.integrate import quad

from app.laws.cure import Autocatalytic, Cure
from app.laws.materials import Conductor
from app.laws.thermal import Thermal
from app.scene.scene import Stage, TimeOptions, scene_of
from app.stepping.stages import assemble
from meshes.distribute import TaggedMesh

k_0, E_a = 2.6397e8, 62866.0  # rate constant [1/s]; activation energy [J/mol]
m, n = 0.98, 1.064  # exponents
a_0, T_0 = 0.01, 296.0  # degree of cure and temperature at the start [K]
Q, C = 155.0, 1.752  # heat of the reaction [mJ/mm^3]; heat capacity [mJ/(mm^3 K)]
R = 8.314462618  # gas constant [J/(mol K)]


def rate(a: float) -> float:
    """Rate of cure at a degree, without losses of heat [1/s]."""
    T = T_0 + Q / C * (a - a_0)
    return k_0 * np.exp(-E_a / (R * T)) * a**m * (1 - a) ** n


# The block is solved up to the time at which 90 % have reacted.
time, _ = quad(lambda a: 1 / rate(a), a_0, 0.9)  # [s]

box = create_box(MPI.COMM_WORLD, [[0, 0, 0], [2, 2, 2]], [1, 1, 1])
mesh = TaggedMesh.from_markers(box, {"cement": lambda x: x[2] >= 0}, {})
cure = Cure(
    kinetics=Autocatalytic(
        kind="autocatalytic",
        rate_constant=f"{k_0} 1/s",
        activation_energy=f"{E_a} J/mol",
        m=m,
        n=n,
    ),
    heat=f"{Q} MJ/m^3",
    initial=a_0,
)
thermal = Thermal(
    conductivity="0.2 W/(m K)",
    density="1200 kg/m^3",
    specific_heat=f"{C / 1200 * 1e6} J/(kg K)",
    initial_temperature=f"{T_0} K",
    cure=cure,
)
scene = scene_of(
    regions={"cement": Conductor(thermal=thermal)},
    stages=[Stage(name="set", duration=f"{time!r} s")],
    time=TimeOptions(tolerance="1e-5 K"),
)
analysis = assemble(scene, mesh)
analysis.run()

degree = analysis.heating.degrees()["cement"].mean()  # the same at all nodes
temperature = analysis.heating.temperatures().mean()  # [K]
temperature_exact = T_0 + Q / C * (0.9 - a_0)

if __name__ == "__main__":
    print(f"after {time:.1f} s: degree of cure {degree:.6f}, exact 0.9")
    print(f"temperature {temperature:.3f} K, exact {temperature_exact:.3f} K")
