// An octant of a resurfaced head: bone, bone with cement in it, cement, cap. `outer` is the outer
// radius of the cap, `wall` its thickness, `mantle` that of the cement, `penetration` the depth of
// cement in bone. Lengths in mm; `size` comes from mesh.size.
SetFactory("OpenCASCADE");
DefineConstant[ size = 2, outer = 24.5, wall = 3, mantle = 1, penetration = 1.5 ];
hole = outer - wall;
reamed = hole - mantle;
sound = reamed - penetration;
Sphere(1) = {0, 0, 0, sound, 0, Pi/2, Pi/2};
Sphere(12) = {0, 0, 0, sound, 0, Pi/2, Pi/2};
Sphere(13) = {0, 0, 0, reamed, 0, Pi/2, Pi/2};
Sphere(14) = {0, 0, 0, reamed, 0, Pi/2, Pi/2};
Sphere(15) = {0, 0, 0, hole, 0, Pi/2, Pi/2};
Sphere(16) = {0, 0, 0, hole, 0, Pi/2, Pi/2};
Sphere(17) = {0, 0, 0, outer, 0, Pi/2, Pi/2};
BooleanDifference(2) = { Volume{13}; Delete; }{ Volume{12}; Delete; };
BooleanDifference(3) = { Volume{15}; Delete; }{ Volume{14}; Delete; };
BooleanDifference(4) = { Volume{17}; Delete; }{ Volume{16}; Delete; };
BooleanFragments{ Volume{1, 2, 3, 4}; Delete; }{}
Physical Volume("bone") = {1};
Physical Volume("mixed") = {2};
Physical Volume("cement") = {3};
Physical Volume("cap") = {4};
// The one surface of the cap that is nowhere near the planes of symmetry and farthest out.
e = 0.001;
all[] = Surface In BoundingBox {-e, -e, -e, outer + e, outer + e, outer + e};
inner[] = Surface In BoundingBox {-e, -e, -e, hole + e, hole + e, hole + e};
flat[] = Surface In BoundingBox {-e, -e, -e, outer + e, outer + e, e};
flat[] += Surface In BoundingBox {-e, -e, -e, e, outer + e, outer + e};
flat[] += Surface In BoundingBox {-e, -e, -e, outer + e, e, outer + e};
all[] -= inner[];
all[] -= flat[];
Physical Surface("outside") = {all[]};
Mesh.MeshSizeMin = size;
Mesh.MeshSizeMax = size;
