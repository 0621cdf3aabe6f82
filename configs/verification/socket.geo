// A cube in a socket with three walls. Lengths in mm; `size` comes from mesh.size.
SetFactory("OpenCASCADE");
DefineConstant[ size = 2 ];
Box(1) = {-2, -2, -2, 6, 6, 6};
Box(2) = {0, 0, 0, 4, 4, 4};
BooleanFragments{ Volume{1}; Delete; }{ Volume{2}; Delete; }
Physical Volume("socket") = {3};
Physical Volume("cube") = {2};
Physical Surface("foot") = Surface In BoundingBox{-2.1, -2.1, -2.1, 4.1, 4.1, -1.9};
MeshSize{ : } = size;
