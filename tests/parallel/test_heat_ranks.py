"""Heat on 1, 2 and 3 ranks: the same temperatures, flows and corrections."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests import support

# Run on every rank: cement of 100 degC that sets between stem and bone, finite conductance, all
# kinds of conditions, conduction corrected.
SCRIPT = """
import json, sys
from dataclasses import replace
import numpy as np
from mpi4py import MPI
from app.heat.flows import flows, stored
from app.heat.implicit_step import ImplicitStep
from app.heat.operators import HeatOperators
from app.numerics.newton import Solver
from app.numerics.remedies import solve
from app.laws.fibres import Circumferential
from app.scene.scene import Scene
from app.system.timing import Timing
from tests import laws, support

case = support.case((support.CONFIGS / "cylinders.yaml").read_text(),
                    "mesh.size=4 mm", "mesh.far_size=6 mm")
tagged = support.mesh(case)
Z = 273.15
around = Circumferential()
terms = Scene(
    1, (), (), (), (), (), (), (),
    conductors=(laws.conductor("stem", (14.8,), None, 3.735, Z + 37),
                laws.conductor("cement", (.2,), None, 1.752, Z + 100),
                laws.conductor("bone", (.6, .4), around, 2.52, Z + 37)),
    heat=(laws.temperature("outer", Z + 37, boundary="bone_surface"),
          laws.temperature("low", lambda x: Z + 60 + x[:, 0], boundary="cement_bottom"),
          laws.temperature("under", Z + 40, boundary="bone_bottom"),
          laws.flux("lamp", "stem_top", "0.1 + 0.01 * x"),
          laws.convection("air", "bone_top", 0.02, Z + 20),
          laws.perfusion("blood", ("bone",), .01, Z + 37),
          laws.source("ohmic", ("stem",), "0.01 * z")),
    thermal_contacts=(laws.interface("stem_cement", ("stem",), ("cement",), (.3, .1, np.inf)),
                      laws.interface("cement_bone", ("bone",), ("cement",), (.3, 0., np.inf))),
    cures=(laws.cure("cement", laws.BALIGA, .05),),
)
o = HeatOperators(terms, tagged, Timing())
c = ImplicitStep(o)
s = Solver(c, 1e-11, 30, "direct", {}, Timing())
j = o.jumps
j.pressure[:] = 1 + j.points.x[j.mine, 2] / 10
x = c.initial()
for v, w in zip(s.blocks(), x): w.copy(v)
found, degrees = {"stored": [stored(o, x)]}, c.degrees(x)
for k, dt in enumerate((.01, .1, 1., 10.)):
    if k == 2:
        # As if everything had left its bounds, at 0 K: all edges out.
        assert o.principle.correct(o.nodal(c.vectors()))
    assert c.begin([v.array.copy() for v in s.blocks()], degrees, dt, dt)
    assert solve(s).converged
    degrees = c.degrees(s.blocks())
    found["stored"].append(stored(o, s.blocks()))
    for name, flow in flows(c, s.blocks()).items():
        found.setdefault(name, []).append(flow)
    q = float(np.sum(j.weight * j.flux(s.blocks()[1].array)[0] ** 2))
    a = float(sum(np.sum(n.heat * d) for n, d in zip(o.cure.nodes, degrees)))
    for name, value in (("flux", q), ("cured", a)):
        found.setdefault(name, []).append(tagged.mesh.comm.allreduce(value))
found["held"] = [tagged.mesh.comm.allreduce(int(j.held.sum()))]
if tagged.mesh.comm.rank == 0:
    print(json.dumps(found))
"""


@pytest.mark.parallel
def test_heat_does_not_depend_on_the_number_of_ranks(tmp_path: Path) -> None:
    script = tmp_path / "heat.py"
    script.write_text(SCRIPT, encoding="utf-8")
    found = {}
    for ranks in (1, 2, 3):
        done = support.on_ranks(ranks, script)
        found[ranks] = json.loads(done.stdout.splitlines()[-1])
    one = found[1]
    assert one["held"][0] > 2
    for name, values in one.items():
        size = max(map(abs, values))
        assert size > 0, name
        for ranks in (2, 3):
            assert found[ranks][name] == pytest.approx(values, abs=1e-8 * size), (name, ranks)
