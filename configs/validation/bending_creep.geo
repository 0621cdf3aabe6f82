// A quarter of a strip of 75 x 10 x 3.3 mm for bending in four points: x is half of the width, y the
// height, z along the strip from its middle. The rollers of spans 20 and 60 mm are strips of 1.5 mm.
// Lengths in mm; `size` comes from mesh.size.
SetFactory("OpenCASCADE");
DefineConstant[ size = 1.65 ];
Box(1) = {0, 0, 0, 5, 3.3, 9.25};
Box(2) = {0, 0, 9.25, 5, 3.3, 1.5};
Box(3) = {0, 0, 10.75, 5, 3.3, 18.5};
Box(4) = {0, 0, 29.25, 5, 3.3, 1.5};
Box(5) = {0, 0, 30.75, 5, 3.3, 6.75};
BooleanFragments{ Volume{1, 2, 3, 4, 5}; Delete; }{}
Physical Volume("strip") = {1, 2, 3, 4, 5};
e = 0.001;
across[] = Surface In BoundingBox {-e, -e, -e, 5 + e, 3.3 + e, e};
along[] = Surface In BoundingBox {-e, -e, -e, e, 3.3 + e, 37.5 + e};
inner[] = Surface In BoundingBox {-e, 3.3 - e, 9.25 - e, 5 + e, 3.3 + e, 10.75 + e};
outer[] = Surface In BoundingBox {-e, -e, 29.25 - e, 5 + e, e, 30.75 + e};
Physical Surface("across") = {across[]};
Physical Surface("along") = {along[]};
Physical Surface("inner") = {inner[]};
Physical Surface("outer") = {outer[]};
Mesh.MeshSizeMin = size;
Mesh.MeshSizeMax = size;
