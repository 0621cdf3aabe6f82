// Cook's membrane as a slice, one element thick. Lengths in mm; `size` comes from mesh.size.
DefineConstant[ size = 2 ];
Point(1) = {0, 0, 0, size};
Point(2) = {48, 44, 0, size};
Point(3) = {48, 60, 0, size};
Point(4) = {0, 44, 0, size};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
slice[] = Extrude {0, 0, 1} { Surface{1}; Layers{1}; };
Physical Volume("membrane") = {slice[1]};
Physical Surface("faces") = {1, slice[0]};
Physical Surface("right") = {slice[3]};
Physical Surface("left") = {slice[5]};
Mesh.MeshSizeFromPoints = 1;
