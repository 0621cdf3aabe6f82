// A slab of 10 mm of stem (14 mm by 8), cement and bone. Lengths in mm; `size` comes from mesh.size.
SetFactory("OpenCASCADE");
DefineConstant[ size = 2 ];
Rectangle(1) = {-7, -4, 0, 14, 8, 2};
Disk(2) = {0, 0, 0, 11};
Disk(3) = {0, 0, 0, 16};
BooleanDifference(5) = { Surface{3}; Delete; }{ Surface{2}; };
BooleanDifference(4) = { Surface{2}; Delete; }{ Surface{1}; };
BooleanFragments{ Surface{1, 4, 5}; Delete; }{}
Extrude {0, 0, 10} { Surface{1, 4, 5}; }
Physical Volume("stem") = {1};
Physical Volume("cement") = {2};
Physical Volume("bone") = {3};
top[] = Surface In BoundingBox {-8, -5, 9.9, 8, 5, 10.1};
Physical Surface("stem_top") = {top[]};
Physical Surface("stem_bottom") = {1};
Physical Surface("bone_bottom") = {5};
Mesh.MeshSizeMin = size;
Mesh.MeshSizeMax = size;
