// Quarter of an elastic block under a rigid plate; the mesh is fine at the contact.
// Lengths in mm; `size` comes from mesh.size.
DefineConstant[ size = 0.15 ];
SetFactory("OpenCASCADE");
side = 3;
plate = 1.1;
Box(1) = {0, 0, -side, side, side, side};
Box(2) = {0, 0, 0, plate, plate, 0.3};
BooleanFragments{ Volume{1}; Delete; }{ Volume{2}; Delete; }
e = 1e-4;
Physical Volume("block") = {1};
Physical Volume("plate") = {2};
Physical Surface("middle_x") = Surface In BoundingBox {-e, -e, -side - e, e, side + e, e};
Physical Surface("middle_y") = Surface In BoundingBox {-e, -e, -side - e, side + e, e, e};
Physical Surface("far") = {
  Surface In BoundingBox {side - e, -e, -side - e, side + e, side + e, e},
  Surface In BoundingBox {-e, side - e, -side - e, side + e, side + e, e},
  Surface In BoundingBox {-e, -e, -side - e, side + e, side + e, -side + e}
};
Physical Surface("plate_x") = Surface In BoundingBox {-e, -e, -e, e, plate + e, 0.3 + e};
Physical Surface("plate_y") = Surface In BoundingBox {-e, -e, -e, plate + e, e, 0.3 + e};
Physical Surface("plate_top") = Surface In BoundingBox {-e, -e, 0.3 - e, plate + e, plate + e, 0.3 + e};
// Tetrahedra of `size` up to 0.8 mm from the contact, growing beyond.
Field[1] = MathEval;
Field[1].F = Sprintf("%g + 0.4 * 0.5 * (Sqrt(x*x+y*y+z*z) - 0.8 + Fabs(Sqrt(x*x+y*y+z*z) - 0.8))", size);
Background Field = 1;
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
