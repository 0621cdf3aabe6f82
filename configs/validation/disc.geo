// A wedge of a disc of cement in its mould, radii 30 and 40 mm, the upper half: `core` is the disc
// of 6 mm, with `rest` it is the one of 40 mm. Lengths in mm; `size` comes from mesh.size.
SetFactory("OpenCASCADE");
DefineConstant[ size = 3 ];
angle = Pi / 12;
Cylinder(1) = {0, 0, 0, 0, 0, 3, 30, angle};
Cylinder(2) = {0, 0, 3, 0, 0, 17, 30, angle};
Cylinder(3) = {0, 0, 0, 0, 0, 30, 40, angle};
BooleanFragments{ Volume{3}; Delete; }{ Volume{1, 2}; Delete; }
Physical Volume("core") = {1};
Physical Volume("rest") = {2};
Physical Volume("mould") = {3};
top[] = Surface In BoundingBox {-1, -1, 29.9, 41, 41, 30.1};
side[] = Surface In BoundingBox {38.5, -1, -1, 41, 41, 31};
Physical Surface("outside") = {top[], side[]};
Mesh.MeshSizeMin = size;
Mesh.MeshSizeMax = size;
