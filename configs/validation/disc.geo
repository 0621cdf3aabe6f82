// A wedge of a disc of cement in its mould, radius 30 mm, the upper half: `half` is half of its
// height, `wall` the thickness of the mould at its side and of the plates. Lengths in mm; `size`
// comes from mesh.size.
SetFactory("OpenCASCADE");
DefineConstant[ size = 3, half = 20, wall = 10 ];
angle = Pi / 6;
Cylinder(1) = {0, 0, 0, 0, 0, half, 30, angle};
Cylinder(2) = {0, 0, 0, 0, 0, half + wall, 30 + wall, angle};
BooleanFragments{ Volume{2}; Delete; }{ Volume{1}; Delete; }
Physical Volume("cement") = {1};
Physical Volume("mould") = {2};
e = 0.01;
R = 30 + wall;
top[] = Surface In BoundingBox {-1, -1, half + wall - e, R + 1, R + 1, half + wall + e};
side[] = Surface In BoundingBox {R * Cos(angle) - e, -1, -1, R + 1, R + 1, half + wall + 1};
Physical Surface("outside") = {top[], side[]};
Mesh.MeshSizeMin = size;
Mesh.MeshSizeMax = size;
