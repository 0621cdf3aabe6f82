"""Rows of ``mantle stress`` on what must not matter, on loads, and on what holds bodies."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from mantle.errors import Reason
from mantle.verification import judges
from mantle.verification.changed_meshes import ROTATION
from mantle.verification.extremes_case import (
    BAR,
    MESH,
    STACK,
    STEM,
    TAPER,
    ExtremeCase,
    Judge,
    Wanted,
    trial,
)


def invariants(full: bool) -> list[ExtremeCase]:
    """The cases.

    Args:
        full: Whether those too that take long.
    """
    return [
        *_loads(),
        *_units(),
        *_floating(),
        *_taper(),
        *_cycles(full),
        *_increments(),
        *_symmetry(),
    ]


def _pushed(force: float) -> tuple[str, ...]:
    """Loads of the stem, of which 900 N are usual."""
    c = force / 900
    return (
        f"loads.push.force=[0 N, 0 N, {-force!r} N]",
        f"loads.lateral.force=[{300 * c!r} N, {200 * c!r} N, 0 N]",
    )


def _gaps(c: float) -> tuple[str, ...]:
    """Interfaces that are tight above and open below, by c times 4 um."""
    return tuple(
        f"interfaces.{name}.gap={text}"
        for name, text in (
            ("stem_cement", f"{0.004 * c!r} * (1 - z / 10)"),
            ("cement_bone", f"{-0.002 * c!r} * (1 + x / 20)"),
        )
    )


def _loads() -> Iterator[ExtremeCase]:
    """Loads of any size, either way, and none."""
    for force in (0.0, 1e-6, 1e-3, 1.0, 1e2, 1e4, 1e6):
        c = force / 900
        judge = partial(judges.same, lengths=c, stresses=c) if c else judges.nothing_moves
        yield trial(
            "loads",
            "stem",
            f"{force:g} N",
            {"force": force},
            (Wanted(STEM, _pushed(force)), *((Wanted(STEM),) if c else ())),
            judge,
            1e-10 if c else 1e-14,
        )
    for c in (1e-6, 1e-3, 1e-1, 10.0, 1e2):
        yield trial(
            "loads",
            "stem and gaps",
            f"x {c:g}",
            {"factor": c},
            (
                Wanted(STEM, (*_gaps(c), *_pushed(900 * c))),
                Wanted(STEM, _gaps(1.0)),
            ),
            partial(judges.same, lengths=c, stresses=c),
            1e-10,
        )
    yield trial(
        "loads",
        "reversed",
        "bar",
        {"force": -500},
        (Wanted(BAR, ("loads.pull.force=[-500 N, 0 N, 0 N]",)), Wanted(BAR)),
        judges.mirrored,
        1e-2,
    )
    yield trial(
        "loads",
        "reversed",
        "stem",
        {"force": -900},
        Wanted(STEM, ("loads.push.force=[0 N, 0 N, 900 N]",)),
        None,
        0.0,
        Reason.LOOSE_BODY,
    )


def _units() -> Iterator[ExtremeCase]:
    """Other units, and the same model a thousand times as small or large."""
    words = (
        "geometry.stem_radius=0.007 m",
        "geometry.cement_thickness=0.4 cm",
        "geometry.bone_thickness=5000 um",
        "geometry.length=0.024 m",
        "geometry.taper=0.02617993877991494 rad",
        "mesh.size=0.0035 m",
        "mesh.far_size=0.5 cm",
        "regions.stem.youngs_modulus=1.1e11 Pa",
        "regions.cement.youngs_modulus=2.2 GPa",
        "regions.bone.youngs_modulus=1.7e10 N/m^2",
        "loads.push.force=[0 N, 0 N, -0.9 kN]",
        "loads.lateral.force=[3e5 mN, 0.2 kN, 0 N]",
    )
    yield trial(
        "units",
        "",
        "m, Pa, kN",
        {"units": "m, Pa, kN"},
        (Wanted(STEM, words), Wanted(STEM)),
        judges.same,
        1e-8,
    )
    stiff = tuple(
        f"regions.{n}.youngs_modulus={E * 1e6!r} MPa"
        for n, E in (("stem", 110e3), ("cement", 2200.0), ("bone", 17e3))
    )
    yield trial(
        "units",
        "",
        "numbers of m, Pa",
        {"lengths": 1e-3, "stresses": 1e6},
        (Wanted(STEM, stiff, "metres"), Wanted(STEM)),
        partial(judges.same, lengths=1e-3, stresses=1e6, points=1e-3),
        1e-8,
    )
    soft = tuple(
        f"regions.{n}.youngs_modulus={E * 1e-6!r} MPa"
        for n, E in (("stem", 110e3), ("cement", 2200.0), ("bone", 17e3))
    )
    yield trial(
        "units",
        "",
        "numbers of um",
        {"lengths": 1e3, "stresses": 1e-6},
        (Wanted(STEM, soft, "micrometres"), Wanted(STEM)),
        partial(judges.same, lengths=1e3, stresses=1e-6, points=1e3),
        1e-8,
    )


def _floating() -> Iterator[ExtremeCase]:
    """Bodies that nothing holds: refused by name."""
    both = ("interfaces.stem_cement.gap=0.1 mm", "interfaces.cement_bone.gap=0.1 mm")
    smooth = tuple(f"interfaces.{n}.friction_coefficient=0" for n in ("stem_cement", "cement_bone"))
    pull = ("loads.push.force=[0 N, 0 N, 900 N]",)
    free = Reason.LOOSE_BODY
    cases: dict[str, tuple[tuple[str, ...], Judge | None, Reason]] = {
        "both open": ((*both, *pull), None, free),
        "both open, pushed aside": (
            (*both, *smooth, "loads.push.history=[0, 0]"),
            judges.lawful,
            free,
        ),
        "both open, no load": ((*both, *_pushed(0.0)), judges.nothing_moves, free),
        "smooth, straight": ((*smooth, "geometry.taper=0 deg"), None, free),
        "smooth, twisted": (
            (
                *smooth,
                "loads.lateral={kind: force, boundary: stem_top, force: [0 N, 10 N, 0 N], "
                "at: [100 mm, 0 mm, 24 mm]}",
            ),
            None,
            free,
        ),
        "no support": (("supports={}",), None, free),
        "held along x": (
            ("supports={outer: {kind: roller, boundary: bone_surface, axis: x}}",),
            None,
            free,
        ),
        "rigid on rigid": (
            ("regions.stem={rigid: true}", "regions.cement={rigid: true}"),
            None,
            Reason.RIGID_CONTACT,
        ),
    }
    for at, (overrides, judge, refused) in cases.items():
        yield trial("floating", "", at, {"case": at}, Wanted(STEM, overrides), judge, 1e-7, refused)


def _taper() -> Iterator[ExtremeCase]:
    """A taper of 5 degrees, which friction holds from 0.0875 on."""
    angle = float(np.radians(5))
    for μ in (0.02, 0.05, 0.12, 0.2, 0.5):
        locks = μ > np.tan(angle)
        left = 0.0 if locks else 0.05
        yield trial(
            "taper",
            "let go",
            f"mu {μ:g}",
            {"friction": μ, "locking": float(np.tan(angle))},
            Wanted(
                TAPER,
                (
                    f"interfaces.stem_cement.friction_coefficient={μ}",
                    f"loads.push.history=[1, {left}]",
                ),
            ),
            partial(judges.wedge, half_angle=angle, friction=μ, left=left),
            1e-7 if locks else MESH,
        )
    for μ, back in ((0.05, -0.05), (0.2, -0.2), (0.2, -0.8)):
        # Of the force that pushed it in, (m - tan a) / (m + tan a) pulls it out.
        limit = (μ - np.tan(angle)) / (μ + np.tan(angle))
        holds = -back < limit
        yield trial(
            "taper",
            "pulled",
            f"mu {μ:g} by {-back:g}",
            {"friction": μ, "pull": -back, "limit": float(limit)},
            Wanted(
                TAPER,
                (
                    f"interfaces.stem_cement.friction_coefficient={μ}",
                    f"loads.push.history=[1, {back}]",
                ),
            ),
            partial(judges.wedge, half_angle=angle, friction=μ, left=back) if holds else None,
            1e-7,
            None if holds else Reason.LOOSE_BODY,
        )


def _turns(count: int, low: str, rest: int = 1) -> tuple[str, str]:
    """Stages and history of a first load, then so many cycles."""
    names = ["first", "back"] + [f"{way}{k}" for k in range(count) for way in ("up", "down")]
    stages = "[" + ", ".join(f"{{name: {n}, increments: 4}}" for n in names) + "]"
    return stages, ", ".join(f"1, {low}" for _ in range(count + 1))


def _cycles(full: bool) -> Iterator[ExtremeCase]:
    """Load and unload: work lost in each cycle, and coming to rest."""
    for count in (10, 100) if full else (10,):
        stages, turns = _turns(count, "0")
        press = stages.replace("[", "[{name: press}, ", 1)
        yield trial(
            "cycles",
            "bar on a bed",
            f"{count}",
            {"cycles": count},
            Wanted(
                BAR,
                (
                    f"stages={press}",
                    f"loads.press.history=[1, {', '.join(['1'] * 2 * (count + 1))}]",
                    f"loads.pull.history=[0, {turns}]",
                ),
            ),
            partial(judges.cycles, count=count, force=500.0, friction=6.0),
            MESH,
        )
        stages, turns = _turns(count, "0.1")
        yield trial(
            "cycles",
            "taper",
            f"{count}",
            {"cycles": count},
            Wanted(TAPER, (f"stages={stages}", f"loads.push.history=[{turns}]")),
            partial(judges.shakedown, count=count),
            1e-4,
        )


# The stem pushed down, then its side load carried round by a quarter turn.
_ROUND = (
    "loads={{push: {{kind: force, boundary: stem_top, force: [0 N, 0 N, -900 N], "
    "history: [1, 1]}}, "
    "one: {{kind: force, boundary: stem_top, force: [300 N, 0 N, 0 N], history: {}}}, "
    "two: {{kind: force, boundary: stem_top, force: [0 N, 300 N, 0 N], history: {}}}}}"
)


def _steps(count: int) -> str:
    return (
        f"stages=[{{name: push, increments: {count}, adaptive: false}}, "
        f"{{name: turn, increments: {count}, adaptive: false}}]"
    )


def _increments() -> Iterator[ExtremeCase]:
    """One to 64 increments along a path that turns."""
    counts = (1, 2, 4, 8, 16, 32, 64)
    path = _ROUND.format("[1, 0]", "[0, 1]")
    yield trial(
        "increments",
        "",
        "1 to 64",
        {"increments": counts},
        tuple(Wanted(STEM, (path, _steps(n))) for n in (*counts, 128)),
        partial(judges.first_order, counts=(*counts, 128)),
        0.2,
    )
    other = _ROUND.format("[0, 0]", "[0, 1]")
    yield trial(
        "increments",
        "",
        "two paths",
        {"increments": 64},
        (
            Wanted(STEM, (path, _steps(64))),
            Wanted(STEM, (path, _steps(32))),
            Wanted(STEM, (other, _steps(64))),
        ),
        judges.path_matters,
        0.2,
    )


def _symmetry() -> Iterator[ExtremeCase]:
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
    quarter = Wanted("cylinders.yaml", (*mesh, f"supports={{{planes}{held}}}"))
    whole = Wanted("cylinders.yaml", (*mesh, f"supports={{{held}}}"), "mirrored")
    yield trial(
        "symmetry",
        "",
        "whole and quarter",
        {"sector": "full"},
        (whole, quarter),
        partial(judges.close, factor=4.0),
        MESH / 2,
    )
    yield trial(
        "symmetry",
        "",
        "turned",
        {"angle": 40},
        (
            Wanted(
                STEM,
                (
                    f"loads.push.force={_turned(0, 0, -900)}",
                    f"loads.lateral.force={_turned(300, 200, 0)}",
                ),
                "turned",
            ),
            Wanted(STEM),
        ),
        partial(judges.same, turn=ROTATION),
        1e-8,
    )
    for name, quality in (("bad", 0.1), ("worst", 0.012)):
        for order in (1, 2):
            yield trial(
                "bad cells",
                f"P{order}",
                f"quality {quality:g}",
                {"quality": quality, "order": order},
                Wanted(STACK, (f"mesh.order={order}", "mesh.size=3 mm"), name),
                partial(judges.stack, moduli=(17e3, 2200, 110e3), ratios=(0.3, 0.3, 0.3)),
                1e-8,
            )


def _turned(*force: float) -> str:
    return "[" + ", ".join(f"{f!r} N" for f in (ROTATION @ force).tolist()) + "]"
