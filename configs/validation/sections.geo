// A slab of a straight stem in cement in a square tube, for torsion. `shape` is the section of the
// stem: 1 circle, 2 oval, 3 triangle with round corners, 4 rectangle with round corners, 5 rectangle
// with sharp corners. All have the `area`; oval and rectangle are `slender` times as wide as deep.
// `bore` is the inner width of the tube, `wall` its thickness. Lengths in mm; `size` comes from
// mesh.size.
SetFactory("OpenCASCADE");
DefineConstant[ size = 1.5, shape = 5, area = 100, slender = 1.4, bore = 22.5, wall = 2.5 ];
width = Sqrt(area * slender);
depth = Sqrt(area / slender);
corner = 0.2 * depth;
If (shape == 1)
  radius = Sqrt(area / Pi);
  Disk(1) = {0, 0, 0, radius, radius};
EndIf
If (shape == 2)
  minor = Sqrt(area / Pi / slender);
  Disk(1) = {0, 0, 0, slender * minor, minor};
EndIf
If (shape == 3)
  // An equilateral triangle of sides `side` whose corners are moved out by arcs of radius `corner`.
  side = (-3 * corner + Sqrt(9 * corner^2 + Sqrt(3) * (area - Pi * corner^2))) / (Sqrt(3) / 2);
  reach = side / Sqrt(3);
  For k In {0:2}
    angle = 2 * Pi * k / 3;
    normal = angle + Pi / 3;
    x = reach * Cos(angle);
    y = reach * Sin(angle);
    Point(10 + k) = {x, y, 0};
    Point(20 + k) = {x + corner * Cos(normal - 2 * Pi / 3), y + corner * Sin(normal - 2 * Pi / 3), 0};
    Point(30 + k) = {x + corner * Cos(normal), y + corner * Sin(normal), 0};
    Circle(40 + k) = {20 + k, 10 + k, 30 + k};
  EndFor
  Line(50) = {30, 21};
  Line(51) = {31, 22};
  Line(52) = {32, 20};
  Curve Loop(60) = {40, 50, 41, 51, 42, 52};
  Plane Surface(1) = {60};
EndIf
If (shape == 4)
  Rectangle(1) = {-width / 2, -depth / 2, 0, width, depth, corner};
EndIf
If (shape == 5)
  Rectangle(1) = {-width / 2, -depth / 2, 0, width, depth, 0};
EndIf
half = bore / 2 + wall;
Rectangle(2) = {-bore / 2, -bore / 2, 0, bore, bore, 0};
Rectangle(3) = {-half, -half, 0, 2 * half, 2 * half, 0};
BooleanDifference(5) = { Surface{3}; Delete; }{ Surface{2}; };
BooleanDifference(4) = { Surface{2}; Delete; }{ Surface{1}; };
BooleanFragments{ Surface{1, 4, 5}; Delete; }{}
Extrude {0, 0, 4} { Surface{1, 4, 5}; }
Physical Volume("stem") = {1};
Physical Volume("cement") = {2};
Physical Volume("tube") = {3};
e = 0.001;
within = bore / 2 - e;
stem[] = Surface In BoundingBox {-within, -within, 4 - e, within, within, 4 + e};
Physical Surface("stem_bottom") = {1};
Physical Surface("stem_top") = {stem[]};
east[] = Surface In BoundingBox {half - e, -half - e, -e, half + e, half + e, 4 + e};
west[] = Surface In BoundingBox {-half - e, -half - e, -e, -half + e, half + e, 4 + e};
Physical Surface("sides") = {east[], west[]};
Mesh.MeshSizeMin = size;
Mesh.MeshSizeMax = size;
