"""A block with friction."""

from __future__ import annotations

# A block pressed on a wall and aside: points stick and slip.
BLOCK = """
geometry: {kind: blocks, blocks: [{name: wall, size: [4 mm, 4 mm, 2 mm]},
                                  {name: bar, size: [4 mm, 4 mm, 4 mm]}]}
mesh: {order: 1, size: 1 mm, far_size: 1 mm}
regions:
  wall: {youngs_modulus: 2000 MPa, poisson_ratio: 0.3}
  bar: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
interfaces:
  wall_bar: {kind: contact, friction_coefficient: 0.3}
supports:
  wall: {kind: fixed, boundary: bottom}
  end: {kind: displacement, boundary: top, x: 0.005 mm, y: 0 mm, z: -0.01 mm}
stages: [{name: press, adaptive: false}]
"""
