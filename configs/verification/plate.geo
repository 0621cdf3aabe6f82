// A plate of 1 mm in equal cells, one thick. Lengths in mm; `size` comes from mesh.size.
DefineConstant[ size = 0.1 ];
n = Round(1 / size);
Point(1) = {0, 0, 0};
edge[] = Extrude {1, 0, 0} { Point{1}; Layers{n}; };
face[] = Extrude {0, 0, 1} { Line{edge[1]}; Layers{n}; };
plate[] = Extrude {0, 0.1, 0} { Surface{face[1]}; Layers{1}; };
Physical Volume("plate") = {plate[1]};
Physical Surface("left") = Surface In BoundingBox {-0.1, -0.1, -0.1, 0.001, 1.1, 1.1};
Physical Surface("sides") = {face[1], plate[0]};
Physical Surface("floor") = Surface In BoundingBox {-0.1, -0.1, -0.1, 1.1, 1.1, 0.001};
Physical Surface("top") = Surface In BoundingBox {-0.1, -0.1, 0.999, 1.1, 1.1, 1.1};
