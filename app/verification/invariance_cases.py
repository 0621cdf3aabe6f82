"""Rows of ``mantle stress`` on invariances, loads and supports."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from app.foundation.verdict import Reason
from app.verification import judges
from app.verification.changed_meshes import ROTATION
from app.verification.check import Check, Judge, row, run, within
from app.verification.extreme_cases import BAR, MESH, STACK, STEM

TAPER = "stress/taper.yaml"
SIDES = ("stem_cement", "cement_bone")


def invariants() -> list[Check]:
    """All checks of invariances, loads and supports."""
    kinds = (_loads, _units, _floating, _taper, _cycles, _increments, _symmetry)
    return [check for kind in kinds for check in kind()]


def condensed(rows: Iterable[Check]) -> Iterator[Check]:
    """The first run of other rows, condensed onto the jumps and by a Krylov method with factors."""
    for c in rows:
        if c.judge and within(c.tier, "default"):
            own, ways = c.runs[0].overrides, ("condensed", "direct")
            runs = [replace(c.runs[0], overrides=(*own, f"solver.linear={way}")) for way in ways]
            yield row(f"condensed/{c.name}", tuple(runs), judges.same, 1e-7, c.refusal, "long")


def _pushed(force: float) -> tuple[str, ...]:
    """Loads of the stem; 900 N are usual."""
    c = force / 900
    return (
        f"loads.push.force=[0 N, 0 N, {-force!r} N]",
        f"loads.lateral.force=[{300 * c!r} N, {200 * c!r} N, 0 N]",
    )


def _gaps(c: float) -> tuple[str, ...]:
    """Interfaces tight above and open below, by c times 4 um."""
    return (
        f"interfaces.stem_cement.gap={0.004 * c!r} * (1 - z / 10)",
        f"interfaces.cement_bone.gap={-0.002 * c!r} * (1 + x / 20)",
    )


def _loads() -> Iterator[Check]:
    """Loads of any size and sign, and none."""
    nothing = run(STEM, *_pushed(0.0))
    yield row("loads/stem/0 N", nothing, judges.nothing_moves, 1e-14)
    for force in (1e-6, 1e-3, 1.0, 1e2, 1e4, 1e6):
        same = partial(judges.same, lengths=force / 900, stresses=force / 900)
        yield row(f"loads/stem/{force:g} N", (run(STEM, *_pushed(force)), run(STEM)), same, 1e-10)
    for c in (1e-6, 1e-3, 1e-1, 10.0, 1e2):
        runs = run(STEM, *_gaps(c), *_pushed(900 * c)), run(STEM, *_gaps(1.0))
        same = partial(judges.same, lengths=c, stresses=c)
        yield row(f"loads/stem and gaps/x {c:g}", runs, same, 1e-10)
    bars = run(BAR, "loads.pull.force=[-500 N, 0 N, 0 N]"), run(BAR)
    yield row("loads/reversed/bar", bars, judges.mirrored, 1e-2)
    up = run(STEM, "loads.push.force=[0 N, 0 N, 900 N]")
    yield row("loads/reversed/stem", up, None, refusal=Reason.LOOSE_BODY)


def _units() -> Iterator[Check]:
    """Other units, and the same model a thousand times as small or large."""
    words = (
        *("geometry.stem_radius=0.007 m", "geometry.cement_thickness=0.4 cm"),
        *("geometry.bone_thickness=5000 um", "geometry.length=0.024 m"),
        *("geometry.taper=0.02617993877991494 rad", "mesh.size=0.0035 m", "mesh.far_size=0.5 cm"),
        *("regions.stem.youngs_modulus=1.1e11 Pa", "regions.cement.youngs_modulus=2.2 GPa"),
        "regions.bone.youngs_modulus=1.7e10 N/m^2",
        *("loads.push.force=[0 N, 0 N, -0.9 kN]", "loads.lateral.force=[3e5 mN, 0.2 kN, 0 N]"),
    )
    yield row("units/m, Pa, kN", (run(STEM, *words), run(STEM)), judges.same, 1e-8)
    kinds = (("m, Pa", "metres", 1e-3, 1e6), ("um", "micrometres", 1e3, 1e-6))
    for name, mesh, lengths, stresses in kinds:
        moduli = {"stem": 110e3, "cement": 2200.0, "bone": 17e3}
        own = (f"regions.{n}.youngs_modulus={E * stresses!r} MPa" for n, E in moduli.items())
        judge = partial(judges.same, lengths=lengths, stresses=stresses, points=lengths)
        runs = run(STEM, *own, mesh=mesh), run(STEM)
        yield row(f"units/numbers of {name}", runs, judge, 1e-8)


def _floating() -> Iterator[Check]:
    """Unsupported bodies: refused by name."""
    both = tuple(f"interfaces.{side}.gap=0.1 mm" for side in SIDES)
    smooth = tuple(f"interfaces.{side}.friction_coefficient=0" for side in SIDES)
    pull = "loads.push.force=[0 N, 0 N, 900 N]"
    twist = (
        "loads.lateral={kind: force, boundary: stem_top, force: [0 N, 10 N, 0 N], "
        "at: [100 mm, 0 mm, 24 mm]}"
    )
    roller = "supports={outer: {kind: roller, boundary: bone_surface, axis: x}}"
    cases: dict[str, tuple[tuple[str, ...], Judge | None]] = {
        "both open": ((*both, pull), None),
        "both open, pushed aside": ((*both, *smooth, "loads.push.history=[0, 0]"), judges.lawful),
        "both open, no load": ((*both, *_pushed(0.0)), judges.nothing_moves),
        "smooth, straight": ((*smooth, "geometry.taper=0 deg"), None),
        "smooth, twisted": ((*smooth, twist), None),
        "no support": (("supports={}",), None),
        "held along x": ((roller,), None),
        "rigid on rigid": (("regions.stem={rigid: true}", "regions.cement={rigid: true}"), None),
    }
    for at, (overrides, judge) in cases.items():
        refusal = Reason.RIGID_CONTACT if at.startswith("rigid") else Reason.LOOSE_BODY
        yield row(f"floating/{at}", run(STEM, *overrides), judge, 1e-7, refusal, "quick")


def _taper() -> Iterator[Check]:
    """A taper of 5 degrees, held by friction from 0.0875 on."""
    angle = float(np.radians(5))

    def pushed(μ: float, left: float) -> tuple[str, str]:
        law = f"interfaces.stem_cement.friction_coefficient={μ}"
        return law, f"loads.push.history=[1, {left}]"

    for μ in (0.02, 0.05, 0.12, 0.2, 0.5):
        locks = μ > np.tan(angle)
        left = 0.0 if locks else 0.05
        judge = partial(judges.wedge, half_angle=angle, friction=μ, left=left)
        tolerance = 1e-7 if locks else MESH
        yield row(f"taper/let go/mu {μ:g}", run(TAPER, *pushed(μ, left)), judge, tolerance)
    for μ, back in ((0.05, -0.05), (0.2, -0.2), (0.2, -0.8)):
        # Of the force that pushed it in, (m - tan a) / (m + tan a) pulls it out.
        holds = -back < (μ - np.tan(angle)) / (μ + np.tan(angle))
        held = partial(judges.wedge, half_angle=angle, friction=μ, left=back)
        answer = (held, 1e-7) if holds else (None, 1e-7, Reason.LOOSE_BODY)
        yield row(f"taper/pulled/mu {μ:g} by {-back:g}", run(TAPER, *pushed(μ, back)), *answer)


def _turns(count: int, low: str) -> tuple[str, str]:
    """Stages and history of a first load and a number of cycles."""
    names = ["first", "back"] + [f"{way}{k}" for k in range(count) for way in ("up", "down")]
    stages = "[" + ", ".join(f"{{name: {n}, increments: 4}}" for n in names) + "]"
    return stages, ", ".join(f"1, {low}" for _ in range(count + 1))


def _cycles() -> Iterator[Check]:
    """Load and unload: work lost in each cycle, and coming to rest."""
    for count, tier in ((10, "default"), (100, "long")):
        stages, turns = _turns(count, "0")
        bar = run(
            BAR,
            f"stages={stages.replace('[', '[{name: press}, ', 1)}",
            f"loads.press.history=[1, {', '.join(['1'] * 2 * (count + 1))}]",
            f"loads.pull.history=[0, {turns}]",
        )
        lost = partial(judges.cycles, count=count, force=500.0, friction=6.0)
        yield row(f"cycles/bar on a bed/{count}", bar, lost, MESH, tier=tier)
        stages, turns = _turns(count, "0.1")
        taper = run(TAPER, f"stages={stages}", f"loads.push.history=[{turns}]")
        rests = partial(judges.shakedown, count=count)
        yield row(f"cycles/taper/{count}", taper, rests, 1e-4, tier=tier)


def _round(first: str, count: int) -> tuple[str, str]:
    """The stem pushed down, then its side load carried round by a quarter turn.

    ``first`` is the history of the load along x, ``count`` the increments of each stage.
    """
    loads = (
        "loads={push: {kind: force, boundary: stem_top, force: [0 N, 0 N, -900 N], "
        "history: [1, 1]}, "
        f"one: {{kind: force, boundary: stem_top, force: [300 N, 0 N, 0 N], history: {first}}}, "
        "two: {kind: force, boundary: stem_top, force: [0 N, 300 N, 0 N], history: [0, 1]}}"
    )
    stages = (f"{{name: {n}, increments: {count}, adaptive: false}}" for n in ("push", "turn"))
    return loads, f"stages=[{', '.join(stages)}]"


def _increments() -> Iterator[Check]:
    counts = (1, 2, 4, 8, 16, 32, 64, 128)
    runs = tuple(run(STEM, *_round("[1, 0]", n)) for n in counts)
    yield row("increments/1 to 64", runs, partial(judges.first_order, counts=counts), 0.2)
    paths = (("[1, 0]", 64), ("[1, 0]", 32), ("[0, 0]", 64))
    runs = tuple(run(STEM, *_round(first, n)) for first, n in paths)
    yield row("increments/two paths", runs, judges.path_matters, 0.2)


def _symmetry() -> Iterator[Check]:
    """A quarter and the whole, a model turned, cells of bad shape."""
    mesh = ("mesh.size=4 mm", "mesh.far_size=6 mm", "mesh.order=1")
    planes = "".join(
        f"symmetry_{a}: {{kind: roller, boundary: symmetry_{a}, axis: {a}}}, " for a in "xy"
    )
    held = (
        "table: {kind: roller, boundary: bone_bottom, axis: z}, "
        "mantle: {kind: roller, boundary: cement_bottom, axis: z}, "
        "bed: {kind: foundation, boundary: bone_surface, stiffness: "
        "[100 MPa/mm, 100 MPa/mm, 0 MPa/mm]}, "
        "push: {kind: displacement, boundary: stem_top, z: -0.1 mm, history: [0, 1]}"
    )
    quarter = run("cylinders.yaml", *mesh, f"supports={{{planes}{held}}}")
    whole = run("cylinders.yaml", *mesh, f"supports={{{held}}}", mesh="mirrored")
    four = partial(judges.close, factor=4.0)
    yield row("symmetry/whole and quarter", (whole, quarter), four, MESH / 2)
    loads = {"push": (0, 0, -900), "lateral": (300, 200, 0)}
    own = (f"loads.{name}.force={_turned(*force)}" for name, force in loads.items())
    turned = run(STEM, *own, mesh="turned")
    same = partial(judges.same, turn=ROTATION)
    yield row("symmetry/turned", (turned, run(STEM)), same, 1e-8)
    stack = partial(judges.stack, moduli=(17e3, 2200, 110e3), ratios=(0.3, 0.3, 0.3))
    for (name, quality), order in product((("bad", 0.1), ("worst", 0.012)), (1, 2)):
        bad = run(STACK, f"mesh.order={order}", "mesh.size=3 mm", mesh=name)
        yield row(f"bad cells/P{order}/quality {quality:g}", bad, stack, 1e-8)


def _turned(*force: float) -> str:
    return "[" + ", ".join(f"{f!r} N" for f in (ROTATION @ force).tolist()) + "]"
