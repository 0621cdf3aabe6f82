// A quarter of a ring about z, radii 5 and 10 mm, a slice one element thick. Lengths in mm; `size`
// comes from mesh.size.
DefineConstant[ size = 1 ];
Point(1) = {0, 0, 0};
Point(2) = {5, 0, 0};
Point(3) = {10, 0, 0};
Point(4) = {0, 10, 0};
Point(5) = {0, 5, 0};
Line(1) = {2, 3};
Circle(2) = {3, 1, 4};
Line(3) = {4, 5};
Circle(4) = {5, 1, 2};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
ring[] = Extrude {0, 0, size} { Surface{1}; Layers{1}; };
Physical Volume("ring") = {ring[1]};
Physical Surface("ends") = {1, ring[0]};
Physical Surface("symmetry_y") = {ring[2]};
Physical Surface("outside") = {ring[3]};
Physical Surface("symmetry_x") = {ring[4]};
Physical Surface("inside") = {ring[5]};
Mesh.MeshSizeMin = size;
Mesh.MeshSizeMax = size;
