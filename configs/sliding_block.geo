// A plate on a block, which share no facet: configs/sliding_block.yaml. Lengths in mm.
// The plate covers the block wherever it is drawn by up to 30 mm along x.
DefineConstant[ size = 4 ];
DefineConstant[ far_size = 10 ];

Mesh.Algorithm3D = 1;  // one volume after the other: HXT would join surfaces at one place

SetFactory("OpenCASCADE");
Box(1) = {-10, -10, -10, 20, 20, 10};
Box(2) = {-44, -14, 0, 88, 28, 6};

MeshSize{ PointsOf{ Volume{1}; } } = size;
MeshSize{ PointsOf{ Volume{2}; } } = far_size;

Physical Volume("block") = {1};
Physical Volume("plate") = {2};
top() = Surface In BoundingBox{-10.1, -10.1, -0.1, 10.1, 10.1, 0.1};
under() = Surface In BoundingBox{-44.1, -14.1, -0.1, 44.1, 14.1, 0.1};
under() -= top();
Physical Surface("block_top") = top();
Physical Surface("block_bottom") = Surface In BoundingBox{-11, -11, -10.1, 11, 11, -9.9};
Physical Surface("plate_bottom") = under();
Physical Surface("plate_top") = Surface In BoundingBox{-44.1, -14.1, 5.9, 44.1, 14.1, 6.1};
