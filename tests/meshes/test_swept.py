"""The femur's layers: exact surfaces, sizes, first attempts, equal meshes on all machines."""

from __future__ import annotations

import contextlib
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.case.femurs import FemurResection
from app.case.geometries import Femur, IntactFemur
from app.case.hips import MUSCLES
from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from meshes import (
    femur,
    femur_bone,
    femur_intact,
    femur_stem,
    quality,
    reference_body,
    swept,
    write_msh,
)
from meshes.bone_layers import TableLayers
from meshes.data import (
    exterior_facets,
    facet_areas,
    interface_facets,
    nodes_of_boundary_facets,
    region_volumes,
    tangents,
)
from meshes.femur import PATCH_RADIUS
from meshes.femur_bone import FemurBone
from meshes.gmsh_session import session
from meshes.layered_surfaces import LayeredSurfaces as Surfaces
from meshes.reference_body import Segment
from meshes.shape_functions import GMSH_TETRAHEDRON
from tests import support
from tests.meshes.femurs import built, hip, sized
from tests.patient.bones import turned
from tests.support import digest

# ------------------------------------------------------------------------------ exact surfaces


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("thickness", [2.0, 4.0])
def test_swept_nodes_are_on_exact_surfaces(thickness: float, curved: bool) -> None:
    """The stem's body is exact everywhere, the mantle's outer side except at the end of a layer."""
    data = built(6.0, curved, cement_thickness=thickness)
    geometry = hip(cement_thickness=thickness)
    body = femur_stem.shaft_of(geometry.implant)
    facets, _, _ = interface_facets(data, "stem_cement")
    x, y, z = data.points[np.unique(facets)].T
    flank = z > geometry.implant.tip_z + geometry.implant.tip_rounding + 1e-6
    on_body = np.hypot(x, y) - body.radius(np.arctan2(y, x), z)
    exact = np.abs(on_body[flank]) < 2e-6
    # Curved cells that bend too far are straightened: some nodes in a thousand.
    assert exact.mean() > (0.99 if curved else 1.0 - 1e-12)
    # Of the end, an ellipsoid for 30 degrees, then a bowl with 0.3 of its depth.
    axis, end = geometry.implant.tip_rounding / 0.65, ~flank
    width = np.hypot(x, y)[end] / (np.hypot(x, y) - on_body)[end]
    depth = np.sqrt(np.maximum(1 - width**2, 0.0))
    depth = np.where(depth > 0.5, 0.5 + 0.3 * (depth - 0.5), depth)
    off = z[end] - (geometry.implant.tip_z + geometry.implant.tip_rounding - axis * depth)
    assert (
        np.quantile(np.abs(off), 0.95 if curved else 1.0) < 0.02
        and width.min() < 0.5
        and (width > 0.86).sum() > 8
    )
    facets, _, _ = interface_facets(data, "cement_bone")
    x, y, z = data.points[np.unique(facets)].T
    theta, r = np.arctan2(y, x), np.hypot(x, y)
    mantle = np.minimum(
        body.offset(thickness).radius(theta, z),
        geometry.femur.endosteum(theta, z),
    )
    side = z > geometry.implant.tip_z - geometry.plug_length + 1e-6
    off = np.abs(r - mantle)[side]
    notes = data.notes["layers"]
    # Along the lines, which are not quite radial.
    assert off.max() <= 1.2 * notes["moved_max_mm"]
    # A note reports the strip that is moved: there a layer ends whose thickness is below the floor.
    assert (off < 2e-6).mean() > 1.0 - notes["moved_nodes"] - 0.03
    assert notes["moved_nodes"] < 0.4 and notes["moved_max_mm"] < 0.25 * 6.0


@pytest.mark.parametrize("build", [femur.build, femur_intact.build])
def test_swept_anteversion_rotates_stem_not_bone(build: Any) -> None:
    """The stem turns by 15 degrees to anterior; the outside of the bone stays."""
    angle = np.deg2rad(15.0)
    kind = Femur if build is femur.build else IntactFemur
    geometry = kind().model_copy(update={"anteversion": angle})
    data = build(geometry, sized(8.0))
    assert quality.quality_without_length(data.points, data.cells).min() > 0.1
    end = "stem_trunnion" if kind is Femur else "head"
    x = data.points[np.unique(data.facets[np.isin(data.facet_tags, data.boundaries[end])])]
    across = x @ [-np.sin(angle), np.cos(angle), 0.0]
    assert abs(across.max() + across.min()) < 0.2 and abs(across.mean()) < 0.2
    assert geometry.head_centre == pytest.approx((41.535, 11.129, 54.0), abs=1e-3)
    x = data.points[
        np.unique(data.facets[np.isin(data.facet_tags, data.boundaries["bone_surface"])])
    ]
    x, y, z = x[x[:, 2] < 0.0].T
    off = np.hypot(x, y) - femur_bone.PERIOSTEUM.radius(np.arctan2(y, x), z)
    assert np.abs(off).max() < 2e-6
    if kind is Femur:
        facets, _, _ = interface_facets(data, "stem_cement")
        x, y, z = turned(data.points[np.unique(facets)], -angle).T
        off = np.hypot(x, y) - femur_stem.shaft_of(geometry.implant).radius(np.arctan2(y, x), z)
        flank = z > geometry.implant.tip_z + geometry.implant.tip_rounding + 1e-6
        assert np.abs(off[flank]).max() < 2e-6


@pytest.mark.parametrize("fillet", [3.0, 6.0])
def test_swept_stem_joins_the_neck_with_the_fillet(fillet: float) -> None:
    """The least radius comes from differences along lines.

    These have no corners above the shoulder.
    """
    upper = Surfaces(hip(neck_fillet=fillet), sized(4.0)).stem.upper
    s = np.linspace(upper.ends[0], upper.ends[-1], 40001)
    turning = ((s > upper.ends[1]) & (s < upper.ends[2]))[1:-1]
    curvatures = []
    for phi in np.arange(16) / 16:
        way = np.diff(upper.points(np.full(len(s), phi), s), axis=0)
        length = np.linalg.norm(way, axis=1)
        angle = np.linalg.norm(np.diff(way / length[:, None], axis=0), axis=1)
        curvatures.append((angle / length[1:])[turning].max())
        assert angle.max() < 1.01 * curvatures[-1] * length[1:][turning].max()
    assert 1 / max(curvatures) == pytest.approx(fillet, rel=0.005)
    assert curvatures.index(max(curvatures)) in (7, 8, 9)  # on the lateral side


def test_swept_void_below_the_tip_has_no_cement() -> None:
    """The void has the given height over the section of the stem. Nothing bears on the end."""
    data, full = built(6.0, True, tip_void=5.0), built(6.0, True, tip_rounding=0.0)
    left, whole = (region_volumes(d)["cement"] for d in (data, full))
    a, b, r = femur_stem.shaft_of(hip().implant).section(np.linspace(-123.0, -118.0, 1001))
    assert whole - left == pytest.approx(5 * (4 * a * b - (4 - np.pi) * r**2).mean(), rel=0.003)
    for d, bears in ((data, False), (full, True)):
        facets, _, _ = interface_facets(d, "stem_cement")
        assert (d.points[facets[:, :3], 2].max(axis=1) < -118.0 + 1e-6).any() == bears


# ------------------------------------------------------------------------------ sizes


@pytest.mark.parametrize("least_size", [5.0, pytest.param(1.5, marks=pytest.mark.slow)])
def test_swept_unknowns_grow_steadily_with_refinement(least_size: float) -> None:
    """Cells smaller by five per cent give at most two fifths more nodes, from 10 mm on."""
    sizes = 10.0 * 0.95 ** np.arange(int(np.log(least_size / 10.0) / np.log(0.95)) + 1)
    nodes = np.array([len(femur.build(hip(), sized(float(s), order=1)).points) for s in sizes])
    assert (nodes[1:] / nodes[:-1]).max() < 1.4


@pytest.mark.parametrize(("size", "lines"), [(8.0, 28), (6.0, 36), (5.0, 44), (4.0, 56)])
def test_swept_size_sets_lines_and_steps(size: float, lines: int) -> None:
    """Distances of lines are a fraction of the size; steps are the size."""
    surfaces = Surfaces(hip(), sized(size))
    assert surfaces.around == lines
    a, b, r = surfaces.stem.shaft.section(surfaces.stem.middle)
    perimeter = 4 * (a + b - 2 * r) + 2 * np.pi * r
    assert perimeter / lines == pytest.approx(0.2 * size, rel=0.1)
    steps = np.diff(surfaces.sections.zeta[surfaces.tip : surfaces.cut])
    assert steps.max() == pytest.approx(size, rel=0.1)


@pytest.mark.parametrize(
    ("thickness", "ratio"),
    [(0.0, 1.5), (1.0, 0.5**0.5), (2.0, 0.5**0.5), (3.0, 0.75**0.5), (4.0, 1.0), (7.0, 1.0)],
)
def test_swept_lines_are_closer_in_thin_cement(thickness: float, ratio: float) -> None:
    """Their distance is that of 4 mm of cement times the root of the relative thickness.

    Without cement it is 0.3 of the size in place of 0.2.
    """
    surfaces = Surfaces(hip(cement_thickness=thickness), sized(6.0))
    assert surfaces.around == 4 * round(43.2 / (1.2 * ratio) / 4)
    # Lines of a mesh of 4 mm resolve the ridges in 2.5 mm of cement.
    assert Surfaces(hip(cement_thickness=2.5), sized(4.0)).around == 56


def test_swept_lines_and_steps_have_separate_lengths() -> None:
    """The case gives a distance of lines and a step. The size applies to the rest."""
    base, given = (
        Surfaces(hip(), sized(6.0, **more)) for more in ({}, {"around": "2.2 mm", "along": "3 mm"})
    )
    assert (base.around, given.around) == (36, 20)  # of 43.2 mm around
    assert given.through == base.through
    steps = np.diff(given.sections.zeta[given.tip : given.cut])
    assert steps.max() == pytest.approx(3.0, rel=0.1)
    assert Surfaces(hip(), sized(6.0, around=13)).around == 13


@pytest.mark.parametrize(
    ("around", "pieces"),
    [(16, [1, 2, 1]), (24, [1, 3, 2]), (28, [1, 4, 2]), (36, [2, 4, 3]), (44, [2, 5, 4])],
)
def test_swept_lines_follow_the_ends_of_arcs(around: int, pieces: list[int]) -> None:
    """Arcs are half a side, the corner and half a front, in level and in oblique sections."""
    surfaces = Surfaces(hip(), sized(6.0, around=around))
    ends = np.array([pieces[0], pieces[0] + pieces[1]]) / around
    for zeta, slope in product(np.linspace(-117.0, 20.0, 30), (0.0, 0.7)):
        x, y, z = surfaces.stem.shaft.point(ends, np.full(2, zeta), np.full(2, slope)).T
        np.testing.assert_allclose(z, zeta - slope * x, atol=1e-9)
        a, b, r = surfaces.stem.shaft.section(z)
        np.testing.assert_allclose([x[0], y[0]], [a[0], (b - r)[0]], atol=1e-9)
        np.testing.assert_allclose([x[1], y[1]], [(a - r)[1], b[1]], atol=1e-9)


def test_swept_lines_leave_arcs_of_round_sections() -> None:
    """No edge at the end of such a stem is shorter than a sixth of the mean."""
    surfaces = Surfaces(hip(tip_corner_radius=2.99), sized(6.0))
    phi = np.arange(surfaces.around) / surfaces.around
    x = surfaces.stem.shaft.point(phi, -118.0, 0.0)
    edges = np.linalg.norm(x - np.roll(x, 1, axis=0), axis=1)
    assert edges.min() > edges.mean() / 6


def test_swept_lines_and_cells_through_cement_can_be_given() -> None:
    """The case gives any number of lines, even an odd one, and several cells through each layer."""
    data = femur.build(hip(), sized(6.0, True, around=13, through_cement=3))
    notes = data.notes["layers"]
    assert (notes["lines_around"], notes["cells_through"][0]) == (13, 3)
    assert quality.sicn(data.points, data.cells).min() > 0.08
    assert femur.build(hip(), sized(6.0, order=1)).notes["layers"]["cells_through"][0] == 2


def test_swept_coarser_mesh_has_larger_cells() -> None:
    fine = sized(3.0, around=24, through_cement=4)
    coarse = fine.coarser(2.0)
    assert (coarse.size, coarse.around, coarse.through_cement) == (6.0, 12, 2)
    assert fine.coarser(9.0).around == 4 and sized(3.0).coarser(2.0).around is None
    # A multiple of 4 stays one: lines stay on the ends of arcs.
    assert sized(3.0, around=28).coarser(1.5).around == 20
    assert sized(3.0, around=27).coarser(1.5).around == 18
    lengths = sized(3.0, around="1.2 mm", along="4 mm").coarser(1.5)
    assert (lengths.around, lengths.along) == pytest.approx((1.8, 6.0))


def test_swept_needs_gmsh() -> None:
    program = (
        "import sys; sys.modules['gmsh'] = None\n"
        "from tests.meshes import test_swept\n"
        "try: test_swept.built(8.0)\n"
        "except ImportError as error: print('none:', error)"
    )
    assert support.python("-c", program).stdout.startswith("none:")


def test_swept_mesh_opens_in_gmsh_with_groups(tmp_path: Path) -> None:
    data = built(8.0)
    write_msh(data, tmp_path / "hip.msh")
    with session("hip") as gmsh:
        gmsh.merge(str(tmp_path / "hip.msh"))
        groups = {
            gmsh.model.getPhysicalName(dim, tag): gmsh.model.mesh.getNodesForPhysicalGroup(dim, tag)
            for dim, tag in gmsh.model.getPhysicalGroups()
        }
    assert set(groups) == {*data.regions, *data.boundaries, *data.interfaces}
    for name in data.interfaces:
        assert len(groups[name][0]) == len(np.unique(interface_facets(data, name)[0]))


# ------------------------------------------------------------------------------ first attempts


def random_hip(rng: np.random.Generator) -> tuple[dict[str, float], float, bool]:
    """Parameters of a hip [mm], a mesh size, and whether cells are curved."""
    length = rng.uniform(120.0, 200.0)
    values = {
        "cement_thickness": rng.uniform(1.0, 8.0),
        "canal_widening": rng.uniform(0.0, 3.0),
        "length": length,
        "tip_z": 29.0 - length,
        "half_width": rng.uniform(7.0, 10.0),
        "half_depth": rng.uniform(4.2, 6.0),
    }
    values["distal_cut_z"] = min(-200.0, 29.0 - length - 10.0 - rng.uniform(20.0, 60.0))
    return values, float(rng.uniform(2.0, 8.0)), bool(rng.integers(2))


@pytest.mark.parametrize(
    ("seed", "number", "least_size"),
    [(20, 20, 5.01), pytest.param(200, 200, 2.0, marks=pytest.mark.slow)],
)
def test_swept_random_hips_mesh_at_first_attempt(seed: int, number: int, least_size: float) -> None:
    """Anatomically impossible hips are refused with a reason. All others have good meshes."""
    rng = np.random.default_rng(seed)
    made = refused = 0
    while made < number:
        values, size, curved = random_hip(rng)
        size = max(size, least_size)
        where = f"hip {made + refused} of seed {seed}: {values}, {size} mm, curved {curved}"
        options = sized(size, curved)
        try:
            data = femur.build(hip(**values), options)
        except GeometryError as error:
            assert "geometry: the stem " in str(error), where
            refused += 1
            continue
        made += 1
        worst = quality.quality_without_length(data.points, data.cells).min()
        # Wedges where thin layers begin are short, for the sake of accuracy.
        assert worst > 0.03, where
        assert Femur.estimate_cells(hip(**values), options) == pytest.approx(
            len(data.cells), rel=0.14
        ), where
    assert refused < number


def test_swept_random_hips_mesh_as_companions() -> None:
    """A mesh with four lines around has no inverted cell, curved or not."""
    rng = np.random.default_rng(7)
    for _ in range(12):
        values, _, curved = random_hip(rng)
        size = float(rng.uniform(10.01, 20.0))
        options = sized(size, curved)
        with contextlib.suppress(GeometryError):  # what anatomy forbids
            data = femur.build(hip(**values), options)
            worst = quality.sicn(data.points, data.cells).min()
            assert worst > 0.02, (values, size, curved)


def test_swept_stem_of_any_length_meshes() -> None:
    """One stem of 172 mm had no mesh before. Another one stands out of a low cut."""
    assert built(6.0, length=172.0, tip_z=-143.0).cells.size
    levels = {"section_depth": 32.0, "head_height": 7.0}
    resection = FemurResection(height="-10 mm", angle="0.3 rad")
    out = built(6.0, length=165.0, tip_z=-118.0, resection=resection, **levels)
    assert quality.quality_without_length(out.points, out.cells).min() > 0.08


@pytest.mark.parametrize(("size", "curved"), [(6.0, False), (4.0, True)])
def test_swept_low_head_neck_is_clear_of_bone(size: float, curved: bool) -> None:
    """A head at 45 mm moves the neck 2 mm above the bone, in good cells."""
    data = built(size, curved, head_height=16.0)
    cut = data.points[np.unique(nodes_of_boundary_facets(data, "resection"))]
    middle = cut.mean(axis=0)
    normal = np.linalg.svd(cut - middle, full_matrices=False)[2][2]
    facets, owner = exterior_facets(data.cells)
    stem = data.points[np.unique(facets[data.cell_tags[owner] == data.regions["stem"]])]
    rim = data.points[np.unique(interface_facets(data, "stem_cement")[0])]
    beside = stem[stem[:, 0] > rim[:, 0].max() + 3.0]
    assert len(beside) > 50
    assert ((beside - middle) @ (normal * np.sign(normal[2]))).min() > 2.0
    assert quality.quality_without_length(data.points, data.cells).min() > 0.08


def test_swept_curved_cells_have_positive_jacobian() -> None:
    data = built(6.0, curved=True)
    grid = np.random.default_rng(0).dirichlet(np.ones(4), 40)
    edges = tangents(data.points[data.cells], grid, GMSH_TETRAHEDRON)
    volumes = np.linalg.det(edges.transpose(2, 3, 0, 1))
    assert volumes.min() > 0


# ------------------------------------------------------------------------------ words and numbers


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"half_width": 14.0}, "the stem cuts .* laterally at .*canal_widening"),
        ({"tip_z": -138.0}, "into the cortex medially at .*, 0 mm below the cut"),
        ({"head_height": -29.0}, "the neck.*does not clear the neck cut"),
        ({"neck_fillet": 8.0, "head_height": 7.0}, "geometry.stem.neck_fillet: 8 mm .*at most 6"),
    ],
)
def test_swept_impossible_geometry_is_refused(values: dict[str, float], words: str) -> None:
    with pytest.raises(GeometryError, match=words):
        Surfaces(hip(**values), sized(6.0))


def test_swept_section_that_is_not_star_shaped_is_refused() -> None:
    """A line to the turned neck cut meets a ledge in the canal three times."""
    surfaces = _plain()

    class Ledged(FemurBone):
        def endosteum(self, theta: Floats, z: Floats) -> Floats:
            return super().endosteum(theta, z) - 6.0 * (np.abs(z - 12.0) < 1.5)

    surfaces.bone = TableLayers(Ledged(), surfaces.sections)
    with pytest.raises(GeometryError, match=r"from \(.*\) mm, .* endosteum more than once"):
        surfaces._refuse()


def test_swept_intersecting_layers_are_reported() -> None:
    made = swept.meshed_layers(_plain(), False)
    inner = np.flatnonzero((made.nodes.rho == 0) & (made.nodes.s == 40))
    made.nodes.x[inner[0]] += [40.0, 0.0, 0.0]
    place = r"layers cut through each other; the worst:\n  \w+ at \(.*\) mm: -0\."
    with pytest.raises(quality.PoorCellsError, match=place):
        swept._check(made)


def _plain() -> Surfaces:
    return Surfaces(hip(), sized(6.0))


@pytest.mark.parametrize("size", [8.0, 6.0, 3.0])
@pytest.mark.parametrize("kind", [Femur, IntactFemur])
def test_swept_size_estimate_is_within_an_eighth(kind: Any, size: float) -> None:
    options = sized(size, False)
    maker = femur_intact if kind is IntactFemur else femur
    for values in ({}, {"cement_thickness": 2.0}, {"cement_thickness": 7.0, "canal_widening": 2.0}):
        geometry = kind().model_copy(update=values)
        cells = len(maker.build(geometry, options).cells)
        assert geometry.estimate_cells(options) == pytest.approx(cells, rel=0.12), values


def test_swept_patches_have_the_area_of_discs() -> None:
    """The area agrees to half a facet, at any size."""
    for size in (8.0, 6.0, 3.0):
        data = built(size)
        for name in MUSCLES:
            facets = data.facets[np.isin(data.facet_tags, data.boundaries[name])]
            areas = facet_areas(data.points, facets)
            disc = np.pi * PATCH_RADIUS**2
            assert abs(areas.sum() - disc) <= 0.75 * areas.max(), (name, size)


# ------------------------------------------------------------------------------ the same bytes

DIGEST = "from tests.meshes import test_swept; print(test_swept.own_digest())"
PROCESSORS = {
    "no vector units": {
        "OPENBLAS_CORETYPE": "Nehalem",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX2,-FMA",
        "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3",
    }
}


@cache
def own_digest() -> str:
    options = sized(3.0, True)
    data = (built(3.0), built(3.0, True), femur_intact.build(IntactFemur(), options))
    return " ".join(map(digest, data))


@pytest.mark.parametrize(
    "name",
    [
        "no vector units",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("Nehalem", "Haswell", "Zen")),
    ],
)
def test_swept_mesh_is_equal_on_every_processor(name: str) -> None:
    environ = PROCESSORS.get(name, {"OPENBLAS_CORETYPE": name})
    assert support.python("-c", DIGEST, **environ).stdout.strip() == own_digest()


@pytest.mark.parametrize("lines", [16, 32])
def test_swept_other_diagonals_at_the_edge_of_the_core_fill_it_too(lines: int) -> None:
    """The rectangle of 16 by 10 mm has triangles between three neighbouring lines at its corners.

    Their other diagonals end on the middle line, and all triangles still fill the rectangle.
    """
    place = 8 * np.arange(lines) / lines - 1  # half sides of the rectangle, from a corner on
    side = np.floor((place + 1) / 2).astype(int)
    along, end = place - 2 * side, np.ones(lines)
    outline = np.stack(
        [
            8 * np.choose(side, [end, -along, -end, along]),
            5 * np.choose(side, [along, end, -along, -end]),
        ],
        axis=1,
    )
    body = reference_body.make(outline, (1,), [Segment(2, ("stem", "bone"))])
    no_quadrangle = lines * (len(body.rho) + 1)
    quad, turned_columns = np.full(len(body.columns), no_quadrangle), body.columns.copy()
    swept._turn_edge_diagonals(body, lines, len(body.rho), quad, turned_columns)
    is_turned, core = quad < no_quadrangle, body.region == 0
    assert is_turned.sum() >= 8  # a pair of prisms at two corners or more, in both layers
    assert np.array_equal(is_turned, (turned_columns != body.columns).any(axis=1))
    corners = body.section[turned_columns[core]]
    areas = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 2
    assert areas.sum() == pytest.approx(2 * 16 * 10, rel=1e-12)
    turned_lines = turned_columns[is_turned] // len(body.rho)
    on_edge = turned_columns[is_turned] < lines * len(body.rho)
    assert (on_edge.sum(axis=1) == 2).all()  # the apex is inside the core
    neighbours = np.abs(np.diff(turned_lines[on_edge].reshape(-1, 2), axis=1))
    assert np.isin(neighbours, (1, lines - 1)).all()
