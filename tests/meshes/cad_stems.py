"""Stems drawn and written by OpenCASCADE, in the form of an implant maker's files.

Axes: z proximal from the tip, x medial [mm].
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from meshes.gmsh_session import session

# Half-width, half-depth, corner radius, medial shift and level of sections from the tip up; level
# and angle of the neck's axis on the stem's, radii of its root and end, its length [mm, deg].
EXETER: dict[str, Any] = {
    "sections": [(3.0, 3.0, 2.1, 0.0, 0.0), (9.1, 5.3, 3.1, 0.0, 147.0)],
    "neck": (132.0, 130.0, 4.9, 6.0, 56.0),
    "fillet": 1.5,
}
SHORT = [(4.2, 3.6, 2.2, 0.0, 0.0), (9.3, 5.4, 3.0, 0.0, 100.0)]
CHARNLEY = [(3.2, 3.0, 1.5, 0.0, 0.0), (6.0, 4.4, 2.0, 0.6, 80.0), (10.5, 5.5, 2.5, 2.6, 142.0)]
ANATOMIC = [(3.2, 3.2, 2.2, 2.4, 0.0), (4.4, 3.9, 2.4, 0.6, 35.0), (5.8, 4.5, 2.6, 0.0, 75.0)]
ANATOMIC += [(7.6, 5.0, 2.9, 0.7, 115.0), (9.4, 5.4, 3.1, 2.4, 147.0)]
STEMS: dict[str, dict[str, Any]] = {
    "exeter": EXETER,
    # As the stem of the parametric femur, with a neck about the same axis.
    "parametric": {
        "sections": [(3.0, 3.0, 2.1, 0.0, 0.0), (9.0789, 5.2105, 3.0947, 0.0, 147.0)],
        # It leaves the body above the neck cut. Below, it would rest on the cement like a collar.
        "neck": (135.919, 130.0, 4.6, 6.0, 56.133),
    },
    "charnley": {"sections": CHARNLEY, "neck": (128.0, 130.0, 5.4, 5.8, 52.0), "fillet": 1.0},
    "anatomic": {"sections": ANATOMIC, "neck": (131.0, 133.0, 5.0, 6.0, 56.0), "smooth": True},
    # With sharp edges from the tip to the shoulder.
    "sharp": EXETER | {"sections": [(2.4, 2.4, 0.0, 0.0, 0.0), (8.0, 4.4, 0.0, 0.0, 147.0)]},
    "short": {"sections": SHORT, "neck": (85.0, 130.0, 5.2, 6.0, 56.0), "fillet": 1.2},
    "inch": EXETER | {"unit": "inch"},
    "metre": EXETER | {"unit": "m"},
    "turned": EXETER | {"turned": True},
    "iges": EXETER | {"suffix": ".igs"},
    "brep": EXETER | {"suffix": ".brep"},
    "deep": EXETER,  # to be put below the cut
}
MILLIMETRE = "SI_UNIT(.MILLI.,.METRE.)"


def write(name: str, folder: Path, **changes: Any) -> Path:
    """Draw a stem of `STEMS` with changes and write it to a folder."""
    stem = STEMS[name] | changes
    path = folder / f"{name}{stem.get('suffix', '.step')}"
    with session(name) as gmsh:
        occ = gmsh.model.occ
        wires = [_rectangle(occ, *section) for section in stem["sections"]]
        loft = occ.addThruSections(wires, makeSolid=True, makeRuled=not stem.get("smooth"))
        body = [part for part in loft if part[0] == 3]
        if "fillet" in stem:
            occ.synchronize()
            tip = gmsh.model.getEntitiesInBoundingBox(-20, -20, -0.01, 20, 20, 0.01, 1)
            body = occ.fillet([body[0][1]], [edge for _, edge in tip], [stem["fillet"]])
        level, angle, root, end, length = stem["neck"]
        way = length * math.sin(math.radians(angle)), -length * math.cos(math.radians(angle))
        parts = [(3, occ.addCone(stem["sections"][-1][3], 0, level, way[0], 0, way[1], root, end))]
        if stem.get("collar"):
            parts.append((3, occ.addBox(0, -8, 137, 23, 16, 3)))
        if stem.get("hole"):
            body, _ = occ.cut(body, [(3, occ.addCylinder(0, 0, -1, 0, 0, 100, 1.2))])
        whole, _ = occ.fuse(body, parts)
        if stem.get("turned"):
            occ.rotate(whole, 0, 0, 0, 1, 2, -0.5, 2.1)
            occ.translate(whole, 120.0, -45.0, 300.0)
        scale = {"inch": 1 / 25.4, "m": 1e-3}.get(stem.get("unit", ""), 1.0)
        occ.dilate(whole, 0, 0, 0, scale, scale, scale)
        occ.remove([(0, tag) for _, tag in occ.getEntities(0)])
        occ.synchronize()
        gmsh.write(str(path))
    if "unit" in stem:
        _rename(path, stem["unit"])
    return path


def _rename(path: Path, unit: str) -> None:
    """Change the unit of length in a STEP file."""
    text = path.read_text()
    start = text.rindex("#", 0, text.index(MILLIMETRE))
    line = text[start : text.index(";", start) + 1]
    metre = line.replace(MILLIMETRE, "SI_UNIT($,.METRE.)")
    inch = (
        f"{line.partition('=')[0]}=( CONVERSION_BASED_UNIT('INCH',#900001) LENGTH_UNIT()"
        f" NAMED_UNIT(#900002) );\n#900000=( LENGTH_UNIT() NAMED_UNIT(*) {MILLIMETRE} );\n"
        "#900001=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#900000);\n"
        "#900002=DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);"
    )
    path.write_text(text.replace(line, inch if unit == "inch" else metre))


def _rectangle(occ: Any, a: float, b: float, r: float, x: float, z: float) -> int:
    """A wire around a rectangle with rounded or sharp corners."""
    if r == 0:
        points = [
            occ.addPoint(x + u * a, v * b, z) for u, v in ((1, -1), (1, 1), (-1, 1), (-1, -1))
        ]
        edges = [occ.addLine(p, points[k - 3]) for k, p in enumerate(points)]
        return int(occ.addWire(edges))
    arcs = []
    for k, (u, v) in enumerate(((1, -1), (1, 1), (-1, 1), (-1, -1))):
        ends = [(u, 0), (u * math.sqrt(0.5), v * math.sqrt(0.5)), (0, v)][:: 1 if k % 2 else -1]
        centre = x + u * (a - r), v * (b - r)
        arcs.append([occ.addPoint(centre[0] + r * p, centre[1] + r * q, z) for p, q in ends])
    edges = []
    for arc, after in zip(arcs, arcs[1:] + arcs[:1], strict=True):
        edges += [occ.addCircleArc(*arc, center=False), occ.addLine(arc[2], after[0])]
    return int(occ.addWire(edges))
