// A ball on a block, which share no facet. Lengths in mm; `size` comes from mesh.size.
DefineConstant[ size = 0.3 ];
Mesh.Algorithm3D = 1;  // one volume after the other: HXT would join surfaces at one place
SetFactory("OpenCASCADE");
radius = 60;
side = 16;
track = 4;  // the ball rolls from x = 0 to there
Sphere(1) = {0, 0, radius, radius};
Box(2) = {-side, -side, -side, 2 * side + track, 2 * side, side};
Physical Volume("ball") = {1};
Physical Volume("block") = {2};
Physical Surface("ball_surface") = Abs(Boundary{ Volume{1}; });
e = 1e-4;
Physical Surface("block_top") =
  Surface In BoundingBox{-side - e, -side - e, -e, side + track + e, side + e, e};
Physical Surface("block_bottom") =
  Surface In BoundingBox{-side - e, -side - e, -side - e, side + track + e, side + e, e - side};
// Tetrahedra of `size` up to 1.8 mm from the track, growing beyond; coarse in the ball, whose
// surface is a formula.
d = Sprintf("Sqrt(y*y + z*z + (0.5*(Fabs(x) + Fabs(x-%g) - %g))^2)", track, track);
Field[1] = MathEval;
Field[1].F = StrCat(Sprintf("%g + 0.2*(", size), d, "-1.8+Fabs(", d, "-1.8))");
Field[2] = Restrict;
Field[2].InField = 1;
Field[2].VolumesList = {2};
Field[3] = Constant;
Field[3].VolumesList = {1};
Field[3].VIn = 30;
Field[4] = Min;
Field[4].FieldsList = {2, 3};
Background Field = 4;
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
