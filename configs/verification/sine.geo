// A cube of 2 mm in equal cells. Lengths in mm; `size` comes from mesh.size.
DefineConstant[ size = 0.5 ];
n = Round(2 / size);
Point(1) = {0, 0, 0};
edge[] = Extrude {2, 0, 0} { Point{1}; Layers{n}; };
face[] = Extrude {0, 2, 0} { Line{edge[1]}; Layers{n}; };
cube[] = Extrude {0, 0, 2} { Surface{face[1]}; Layers{n}; };
Physical Volume("cube") = {cube[1]};
Physical Surface("surface") = Boundary{ Volume{cube[1]}; };
