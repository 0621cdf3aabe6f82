// Two columns side by side under one cap. Lengths in mm; `size` comes from mesh.size.
DefineConstant[ size = 0.5 ];
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 1, 1, 1};
Box(2) = {1.2, 0, 0, 1, 1, 1};
Box(3) = {0, 0, 1, 2.2, 1, 0.5};
Coherence;
MeshSize{ PointsOf{ Volume{:}; } } = size;
Physical Volume("one") = {1};
Physical Volume("other") = {2};
Physical Volume("cap") = {3};
Physical Surface("floor") = Surface In BoundingBox {-0.1, -0.1, -0.1, 2.3, 1.1, 0.1};
Physical Surface("top") = Surface In BoundingBox {-0.1, -0.1, 1.4, 2.3, 1.1, 1.6};
Physical Surface("guide") = Surface In BoundingBox {-0.1, -0.1, 0.9, 0.1, 1.1, 1.6};
