// An L, one element thick, that turns in at (10, 10). Lengths in mm; `size` comes from mesh.size.
DefineConstant[ size = 1 ];
Point(1) = {0, 0, 0, size};
Point(2) = {20, 0, 0, size};
Point(3) = {20, 10, 0, size};
Point(4) = {10, 10, 0, size};
Point(5) = {10, 20, 0, size};
Point(6) = {0, 20, 0, size};
For i In {1:6}
  Line(i) = {i, i % 6 + 1};
EndFor
Curve Loop(1) = {1, 2, 3, 4, 5, 6};
Plane Surface(1) = {1};
slice[] = Extrude {0, 0, 1} { Surface{1}; Layers{1}; };
Physical Volume("corner") = {slice[1]};
Physical Surface("faces") = {1, slice[0]};
Physical Surface("right") = {slice[3]};
Physical Surface("top") = {slice[6]};
Mesh.MeshSizeFromPoints = 1;
