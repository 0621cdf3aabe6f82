"""Blocks with friction."""

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

# Two blocks, pressed on each other and pushed aside.
PUSHED = """
geometry: {kind: blocks, blocks: [{name: lower, size: [10 mm, 10 mm, 10 mm]},
                                  {name: upper, size: [10 mm, 10 mm, 10 mm]}]}
mesh: {size: 3 mm, order: 1}
regions:
  lower: {youngs_modulus: 200 MPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 100 MPa, poisson_ratio: 0.3}
interfaces: {lower_upper: {kind: contact, friction_coefficient: 0.2}}
supports: {floor: {kind: fixed, boundary: bottom}}
loads:
  push: {kind: pressure, boundary: top, pressure: 1 MPa}
  shear: {kind: force, boundary: top, force: [15 N, 0 N, 0 N]}
stages: [{name: push, increments: 2}]
"""
