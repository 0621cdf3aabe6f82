"""Rows of ``mantle stress`` at extremes: augmentation, penalty, stiffness, friction, shape."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np

from mantle.errors import Reason
from mantle.verification import closed_forms as exact
from mantle.verification import judges
from mantle.verification.extremes_case import (
    BAR,
    COOK,
    INCLINE,
    MESH,
    RINGS,
    STACK,
    STEM,
    WALL,
    ExtremeCase,
    Judge,
    Wanted,
    trial,
)
from mantle.verification.measures import CEMENT, TITANIUM

BONE = (17e3, 0.3)
PRESS = 2.0  # MPa on the bar, 10 mm wide
RADIUS = 7.0  # mm


def extremes(full: bool) -> list[ExtremeCase]:
    """The cases.

    Args:
        full: Whether those too that take long or add little.
    """
    return [
        *_augmentation(full),
        *_penalty(),
        *_modulus(),
        *_poisson(),
        *_friction(),
        *_thin(full),
    ]


def _powers(exponents: Iterable[float]) -> tuple[float, ...]:
    """Powers of ten."""
    return tuple(float(f"{10.0**k:.6g}") for k in map(float, exponents))


def _augmentation(full: bool) -> Iterator[ExtremeCase]:
    """R over eight decades: the answer of the default."""
    decades = np.arange(-4, 4.5, 0.5) if full else np.arange(-4, 5)
    ratios = (1, 50, 1000) if full else (50, 1000)
    frictions = (0.01, 0.4, 1.0) if full else (0.05, 0.4)
    for ratio in ratios:
        for friction in frictions:
            base = (
                f"regions.cement.youngs_modulus={110000 / ratio!r} MPa",
                f"interfaces.stem_cement.friction_coefficient={friction}",
            )
            for factor in _powers(decades[decades != 0]):
                chosen = f"solver.augmentation_factor={0.2 * factor!r}"
                yield trial(
                    "augmentation",
                    f"E {ratio}:1 mu {friction}",
                    f"{factor:.2g}",
                    {"modulus_ratio": ratio, "friction": friction, "augmentation": factor},
                    (Wanted(STEM, (*base, chosen)), Wanted(STEM, base)),
                    partial(judges.augmented, factor=factor),
                    1e-6,
                )


def _penalty() -> Iterator[ExtremeCase]:
    """Penalties over the same range: an error of known size, of order -1."""
    law = "{{kind: penalty, friction_coefficient: {}, penalty: {!r} MPa/mm}}"
    stiffness = 220.0
    for factor in _powers(range(-4, 5)):
        penalty = factor * stiffness
        yield trial(
            "penalty",
            "bar on a wall",
            f"{factor:g}",
            {"penalty": penalty},
            Wanted(WALL, (f"interfaces.wall_bar={law.format(0.3, penalty)}",)),
            partial(judges.penetrates, stiffness=stiffness, motion=0.01, penalty=penalty),
            1e-6,
        )
    values = _powers(range(4, 8))
    fit = partial(judges.unpenalized, penalties=values, name="stem_cement")
    yield trial(
        "penalty",
        "order -1",
        "shrink fit",
        {"penalties": values},
        (
            *(Wanted(RINGS, (f"interfaces.stem_cement={_fit(law.format(0, r))}",)) for r in values),
            Wanted(RINGS),
        ),
        fit,
        0.05,
    )
    values = values[:3]
    yield trial(
        "penalty",
        "order -1",
        "stem",
        {"penalties": values},
        (
            *(Wanted(STEM, (f"interfaces.stem_cement={law.format(0.4, r)}",)) for r in values),
            Wanted(STEM),
        ),
        partial(judges.unpenalized, penalties=values, name="stem_cement"),
        0.05,
    )


def _fit(law: str) -> str:
    """A law with the interference of the shrink fit."""
    return law[:-1] + ", gap: -0.01 mm}"


def _modulus() -> Iterator[ExtremeCase]:
    """Soft on stiff and stiff on soft, by nine decades."""
    decades = range(-3, 7)
    for order in (1, 2):
        for ratio in _powers(decades):
            moduli = (17e3, float(17e3 / ratio), 17e3)
            yield trial(
                "modulus",
                f"stack P{order}",
                f"{ratio:g}",
                {"modulus_ratio": ratio, "order": order},
                Wanted(
                    STACK,
                    (
                        f"mesh.order={order}",
                        f"regions.cement.youngs_modulus={moduli[1]!r} MPa",
                        "regions.metal.youngs_modulus=17 GPa",
                    ),
                ),
                partial(judges.stack, moduli=moduli, ratios=(0.3, 0.3, 0.3)),
                1e-8,
            )
    for ratio in _powers(decades):
        core = (float(2200 * ratio), 0.3)
        yield trial(
            "modulus",
            "rings P2",
            f"{ratio:g}",
            {"modulus_ratio": ratio, "order": 2},
            Wanted(RINGS, (*_RINGS, f"regions.stem.youngs_modulus={core[0]!r} MPa")),
            _rings((RADIUS, RADIUS + 1.5, RADIUS + 3), (core, CEMENT, CEMENT)),
            MESH / 2,
        )


_RINGS = (
    "mesh.order=2",
    "mesh.curved=true",
    "mesh.size=1 mm",
    "mesh.far_size=1 mm",
    "geometry.length=1 mm",
)


def _rings(radii: Sequence[float], materials: Sequence[exact.Elastic]) -> Judge:
    return partial(judges.shrink_fit, interference=0.01, radii=radii, materials=materials)


def _poisson() -> Iterator[ExtremeCase]:
    """Nearly incompressible bodies by second order."""
    ratios = (0.0, 0.3, 0.45, 0.49, 0.499, 0.4999)
    for ν in ratios:
        yield trial(
            "poisson",
            "stack P2",
            f"{ν:g}",
            {"poisson_ratio": ν},
            Wanted(STACK, ("mesh.order=2", f"regions.cement.poisson_ratio={ν}")),
            partial(judges.stack, moduli=(17e3, 2200, 110e3), ratios=(0.3, ν, 0.3)),
            1e-8,
        )
        yield trial(
            "poisson",
            "rings P2",
            f"{ν:g}",
            {"poisson_ratio": ν},
            Wanted(RINGS, (*_RINGS, f"regions.cement.poisson_ratio={ν}")),
            _rings((RADIUS, RADIUS + 1.5, RADIUS + 3), (TITANIUM, (2200, ν), CEMENT)),
            MESH / 2,
        )
    for ν in exact.COOK:
        yield trial(
            "poisson",
            "Cook P2",
            f"{ν:g}",
            {"poisson_ratio": ν},
            Wanted(COOK, (f"regions.membrane.poisson_ratio={ν}",)),
            partial(judges.cook, ratio=ν),
            MESH / 2,
        )


def _friction() -> Iterator[ExtremeCase]:
    """No friction to more than solutions need to be unique."""
    frictions = (0.0, 0.01, 0.3, 1.0, 2.0, 5.0)
    for μ in frictions:
        yield trial(
            "friction",
            "stem",
            f"{μ:g}",
            {"friction": μ},
            Wanted(
                STEM,
                tuple(
                    f"interfaces.{name}.friction_coefficient={μ}"
                    for name in ("stem_cement", "cement_bone")
                ),
            ),
            judges.lawful,
            1e-7,
            # Beyond the critical one, 1.4 here, there need not be one answer that steps lead to.
            Reason.NOT_UNIQUE if μ > 1.4 else Reason.LOOSE_BODY if μ == 0 else None,
        )
    for μ in frictions[1:]:
        force, friction = 1200 * μ, 10 * PRESS * μ
        yield trial(
            "friction",
            "bar on a bed",
            f"{μ:g}",
            {"friction": μ, "force_over_limit": 1200 / 2200},
            Wanted(
                BAR,
                (
                    f"interfaces.base_bar.friction_coefficient={μ}",
                    f"loads.pull.force=[{force} N, 0 N, 0 N]",
                    # Friction acts on its lower face and turns it: by so much of the closed
                    # form as friction times height over length, so it is thin, of the same EA.
                    "geometry.blocks.1.size=[110 mm, 10 mm, 0.1 mm]",
                    "regions.bar.youngs_modulus=1100 GPa",
                ),
            ),
            partial(judges.bar, force=force, friction=friction),
            MESH,
        )
    for μ in frictions:
        # More than friction can hold.
        yield trial(
            "friction",
            "bar pulled off",
            f"{μ:g}",
            {"friction": μ, "force_over_limit": 1.2 if μ else "infinite"},
            Wanted(
                BAR,
                (
                    f"interfaces.base_bar.friction_coefficient={μ}",
                    f"loads.pull.force=[{1.2 * 2200 * μ or 1} N, 0 N, 0 N]",
                ),
            ),
            None,
            0.0,
            Reason.LOOSE_BODY,
        )
    for μ in (0.01, 0.3, 1.0):
        yield trial(
            "friction",
            "incline",
            f"{μ:g}",
            {"friction": μ},
            Wanted(INCLINE, (f"interfaces.slope_block.friction_coefficient={μ}",)),
            partial(judges.incline, friction=μ),
            0.005,
        )


def _thin(full: bool) -> Iterator[ExtremeCase]:
    """A mantle of 0.2 mm in cells of ten times that, and of twenty."""
    sizes = (0.5, 1.0, 2.0, 4.0) if full else (1.0, 2.0)
    for size in sizes:
        for t in (4.0, 1.0, 0.5, 0.2):
            for kind in ("bonded", "contact"):
                yield trial(
                    "thin mantle",
                    f"cells {size:g} mm {kind}",
                    f"{t:g} mm",
                    {"cement_thickness": t, "mesh_size": size, "cement_bone": kind},
                    Wanted(
                        RINGS,
                        (
                            "mesh.order=2",
                            "mesh.curved=true",
                            f"geometry.cement_thickness={t} mm",
                            "geometry.bone_thickness=6 mm",
                            f"mesh.size={size} mm",
                            f"mesh.far_size={size} mm",
                            f"geometry.length={size} mm",
                            "regions.bone.youngs_modulus=17 GPa",
                            *(
                                ("interfaces.cement_bone={kind: contact, friction_coefficient: 0}",)
                                if kind == "contact"
                                else ()
                            ),
                        ),
                    ),
                    _rings((RADIUS, RADIUS + t, RADIUS + t + 6), (TITANIUM, CEMENT, BONE)),
                    # Cells of more than half the radius do not follow it as closely; those of
                    # twenty times its thickness leave no mantle, and the mesh says so.
                    MESH * max(1.0, (size / 2) ** 2),
                    Reason.MISSING_PART if size >= 20 * t else None,
                )
