// A cube of 2 mm in cells of any shape. Lengths in mm; `size` comes from mesh.size.
DefineConstant[ size = 0.7 ];
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 2, 2, 2};
Physical Volume("cube") = {1};
Physical Surface("surface") = {1 : 6};
MeshSize{ PointsOf{ Volume{1}; } } = size;
Mesh.MeshSizeFromPoints = 1;
