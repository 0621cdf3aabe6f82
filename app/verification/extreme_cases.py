"""Rows of ``mantle stress`` at extremes: augmentation, penalty, stiffness, friction, shape."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product

from app.foundation.verdict import Reason
from app.verification import closed_forms as exact
from app.verification import judges, measures
from app.verification.check import Check, Judge, each, row, run
from app.verification.measures import CEMENT, TITANIUM

STEM, STACK, BAR = "stress/stem.yaml", "blocks.yaml", "verification/foundation_bar.yaml"
RINGS, INCLINE = "verification/lame_plane_strain.yaml", "verification/incline.yaml"
# Tolerance where a closed form is compared with a mesh.
MESH = 0.02
BONE = (17e3, 0.3)
PRESS = 2.0  # MPa on the bar, 10 mm wide
RADIUS = 7.0  # mm


def extremes() -> list[Check]:
    """All checks at extremes."""
    return [*_augmentation(), *_penalty(), *_modulus(), *_poisson(), *_friction(), *_thin()]


def _power(exponent: float) -> float:
    return float(f"{10.0**exponent:.6g}")


def _augmentation() -> Iterator[Check]:
    """Augmentation over eight decades: the answer of the default."""
    for ratio, μ in product((1, 50, 1000), (0.01, 0.05, 0.4, 1.0)):
        base = (
            f"regions.cement.youngs_modulus={110000 / ratio!r} MPa",
            f"interfaces.stem_cement.friction_coefficient={μ}",
        )
        for half in range(-8, 9):
            factor = _power(half / 2)
            usual = ratio > 1 and μ in (0.05, 0.4) and half % 2 == 0
            if half and (usual or μ != 0.05):
                chosen = f"solver.augmentation_factor={0.2 * factor!r}"
                yield row(
                    f"augmentation/E {ratio}:1 mu {μ}/{factor:.2g}",
                    (run(STEM, *base, chosen), run(STEM, *base)),
                    partial(judges.augmented, factor=factor),
                    1e-6,
                    tier="default" if usual else "long",
                )


def _penalty() -> Iterator[Check]:
    """An error of order -1 in the penalty, or in the stiffness of a layer."""
    # The shrink fit keeps its interference.
    law = "{{kind: penalty, friction_coefficient: 0, gap: -0.01 mm, penalty: {!r} MPa/mm}}"
    values = tuple(map(_power, range(4, 8)))
    penalized = (run(RINGS, f"interfaces.stem_cement={law.format(r)}") for r in values)
    judge = partial(judges.unpenalized, penalties=values, name="stem_cement")
    yield row("penalty/order -1/shrink fit", (*penalized, run(RINGS)), judge, 0.05)
    layer = "interfaces.stem_cement.compliance={{normal: {0!r} MPa/mm, tangential: {0!r} MPa/mm}}"
    soft = {k: run(STEM, layer.format(k)) for k in map(_power, range(9))}
    for k, one in soft.items():
        # A wedge held by soft springs comes out by millimetres: not small.
        refusal = Reason.LOOSE_BODY if k < 100 else None
        yield row(f"layer/stem/{k:g}", one, judges.lawful, 1e-8, refusal)
    values = tuple(soft)[4:]
    judge = partial(judges.unpenalized, penalties=values, name="stem_cement")
    yield row("layer/order -1/stem", (*(soft[k] for k in values), run(STEM)), judge, 0.05)


_RINGS = (
    *("mesh.order=2", "mesh.curved=true", "mesh.size=1 mm", "mesh.far_size=1 mm"),
    "geometry.length=1 mm",
)


def _rings(cement: float, bone: float, materials: Sequence[exact.Elastic]) -> Judge:
    """A shrink fit by the thickness of its rings."""
    radii = (RADIUS, RADIUS + cement, RADIUS + cement + bone)
    return partial(judges.shrink_fit, interference=0.01, radii=radii, materials=materials)


def _modulus() -> Iterator[Check]:
    """Soft on stiff and stiff on soft, by nine decades."""
    ratios = tuple(map(_power, range(-3, 7)))
    for order, ratio in product((1, 2), ratios):
        moduli = (17e3, 17e3 / ratio, 17e3)
        overrides = (
            f"mesh.order={order}",
            f"regions.cement.youngs_modulus={moduli[1]!r} MPa",
            "regions.metal.youngs_modulus=17 GPa",
        )
        judge = partial(judges.stack, moduli=moduli, ratios=(0.3, 0.3, 0.3))
        yield row(f"modulus/stack P{order}/{ratio:g}", run(STACK, *overrides), judge, 1e-8)
    for ratio in ratios:
        core = (2200 * ratio, 0.3)
        yield row(
            f"modulus/rings P2/{ratio:g}",
            run(RINGS, *_RINGS, f"regions.stem.youngs_modulus={core[0]!r} MPa"),
            _rings(1.5, 1.5, (core, CEMENT, CEMENT)),
            MESH / 2,
        )


def _poisson() -> Iterator[Check]:
    """Nearly incompressible bodies by second order."""
    for ν in (0.0, 0.3, 0.45, 0.49, 0.499, 0.4999):
        cement = f"regions.cement.poisson_ratio={ν}"
        yield row(
            f"poisson/stack P2/{ν:g}",
            run(STACK, "mesh.order=2", cement),
            partial(judges.stack, moduli=(17e3, 2200, 110e3), ratios=(0.3, ν, 0.3)),
            1e-8,
        )
        yield row(
            f"poisson/rings P2/{ν:g}",
            run(RINGS, *_RINGS, cement),
            _rings(1.5, 1.5, (TITANIUM, (2200, ν), CEMENT)),
            MESH / 2,
        )


def _friction() -> Iterator[Check]:
    """Friction from zero to beyond the limit of uniqueness."""
    frictions = (0.0, 0.01, 0.3, 1.0, 2.0, 5.0)
    for μ in frictions:
        sides = ("stem_cement", "cement_bone")
        # Beyond the critical one, 1.4 here, there need not be one answer that steps lead to.
        refusal = Reason.NOT_UNIQUE if μ > 1.4 else Reason.LOOSE_BODY if μ == 0 else None
        yield row(
            f"friction/stem/{μ:g}",
            run(STEM, *(f"interfaces.{side}.friction_coefficient={μ}" for side in sides)),
            judges.lawful,
            1e-7,
            refusal,
        )
    for μ in frictions[1:]:
        law = exact.FoundationBar(1200 * μ, 10 * PRESS * μ, 1.1e6)
        bar = run(
            BAR,
            f"interfaces.base_bar.friction_coefficient={μ}",
            f"loads.pull.force=[{1200 * μ} N, 0 N, 0 N]",
            # Friction acts on its lower face and turns it: by so much of the closed form as
            # friction times height over length, so it is thin, of the same EA.
            "geometry.blocks.1.size=[110 mm, 10 mm, 0.1 mm]",
            "regions.bar.youngs_modulus=1100 GPa",
        )
        end = partial(measures.bar_end, time=2.0, reference=law.end)
        residual = partial(measures.bar_end, time=3.0, reference=law.residual)
        yield row(f"friction/bar on a bed/{μ:g}", (bar, bar), each(end, residual), MESH)
    for μ in frictions:
        # More than friction can hold.
        yield row(
            f"friction/bar pulled off/{μ:g}",
            run(
                BAR,
                f"interfaces.base_bar.friction_coefficient={μ}",
                f"loads.pull.force=[{1.2 * 2200 * μ or 1} N, 0 N, 0 N]",
            ),
            None,
            refusal=Reason.LOOSE_BODY,
            tier="quick",
        )
    for μ in (0.01, 0.3, 1.0):
        block = run(INCLINE, f"interfaces.slope_block.friction_coefficient={μ}")
        judge = each(partial(measures.push, friction=μ))
        yield row(f"friction/incline/{μ:g}", block, judge, 0.005, tier="quick")


def _thin() -> Iterator[Check]:
    """A mantle of 0.2 mm in cells of ten times that, and of twenty."""
    kinds = {
        "bonded": (),
        "contact": ("interfaces.cement_bone={kind: contact, friction_coefficient: 0}",),
    }
    for size, t, kind in product((0.5, 1.0, 2.0, 4.0), (4.0, 1.0, 0.5, 0.2), kinds):
        cells = (f"mesh.size={size} mm", f"mesh.far_size={size} mm", f"geometry.length={size} mm")
        mantle = (f"geometry.cement_thickness={t} mm", "geometry.bone_thickness=6 mm")
        options = (*_RINGS[:2], *mantle, *cells, "regions.bone.youngs_modulus=17 GPa", *kinds[kind])
        yield row(
            f"thin mantle/cells {size:g} mm {kind}/{t:g} mm",
            run(RINGS, *options),
            _rings(t, 6, (TITANIUM, CEMENT, BONE)),
            # Cells of more than half the radius do not follow it as closely; those of twenty times
            # its thickness leave no mantle, and the mesh says so.
            MESH * max(1.0, (size / 2) ** 2),
            Reason.MISSING_PART if size >= 20 * t else None,
            "default" if size in (1.0, 2.0) else "long",
        )
