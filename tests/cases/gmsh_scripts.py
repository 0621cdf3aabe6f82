"""A gmsh script of two layers, and a case with it."""

from __future__ import annotations

from pathlib import Path

# Two layers of a box 2 x 3 x (1 + 2), by gmsh's built-in kernel; the surface between them is named.
LAYERS = """\
// Physical Volume("comment") = {1};
/* size; Physical Surface("also // comment") = {1}; */
DefineConstant[ size = 1, far_size = 1 ];
Point(1) = {0, 0, 0, size}; Point(2) = {2, 0, 0, size};
Point(3) = {2, 3, 0, size}; Point(4) = {0, 3, 0, size};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
low[] = Extrude {0, 0, 1} { Surface{1}; };
high[] = Extrude {0, 0, 2} { Surface{low[0]}; };
MeshSize { PointsOf { Surface{high[0]}; } } = far_size;
Physical Volume("low") = {low[1]};
Physical  Volume ( "high" , 7 ) = {high[1]};
Physical Surface("base") = {1};
Physical Surface("top") = {high[0]}; Physical Surface("between") = {low[0]};
"""

CASE = """\
geometry: {kind: file, path: a.geo, interfaces: {joint: [low, high]}}
mesh: {order: 1, size: 1 mm, far_size: 1 mm}
regions:
  low: {youngs_modulus: 100 MPa, poisson_ratio: 0, tissue: other}
  high: {youngs_modulus: 100 MPa, poisson_ratio: 0, tissue: other}
interfaces: {joint: {kind: contact, friction_coefficient: 0.3}}
supports: {base: {kind: fixed, boundary: base}}
loads: {press: {kind: pressure, boundary: top, pressure: 1 MPa}}
"""


def script(tmp_path: Path, text: str) -> Path:
    """A script, and a case with it."""
    (tmp_path / "case.yaml").write_text(CASE)
    path = tmp_path / "a.geo"
    path.write_text(text)
    return path
