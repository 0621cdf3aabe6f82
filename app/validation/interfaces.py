"""Experiments on the hold of a stem in cement: push-out, plugs, torsion."""

from __future__ import annotations

from app.results.reading import Results
from app.validation.experiment import Experiment, PredictedQuantity


def shear_strength(run: Results) -> float:
    """Force along the stem over the area of its interface [MPa]."""
    numbers = run.summary["interfaces"]["stem_cement"]
    return float(abs(numbers["force"][2]) / numbers["area"])


PUSH_OUT = Experiment(
    name="push_out",
    title="Push-out of titanium dowels from cement",
    blind=True,
    quantities={
        "clean": PredictedQuantity.of_run(
            "apparent shear strength of the smooth clean dowel by shrinkage and friction alone",
            "MPa",
            shear_strength,
            "clean",
            "Above the band adhesion or interlock adds to friction; below it the cement swells or "
            "lies against the tube, and does not grip.",
        ),
        "lubricated": PredictedQuantity.ratio(
            "strength of a lubricated smooth dowel over that of a clean one",
            shear_strength,
            "lubricated",
            "clean",
            "Below the band a lubricant also prevents that cement wets the metal; above it no film "
            "is left between them.",
        ),
        "rough": PredictedQuantity.of_run(
            "strength of the rough dowel by friction alone, without interlock",
            "MPa",
            shear_strength,
            "rough",
            "A measured strength inside the band means that interlock adds nothing.",
        ),
        "smooth_over_rough": PredictedQuantity.ratio(
            "strength of the smooth clean dowel over that of the rough one, both by friction",
            shear_strength,
            "clean",
            "rough",
            "Below the band the rough dowel holds by interlock, which is not modelled.",
        ),
    },
)

# Polished rods of cobalt-chromium

GRIP = (
    "Below the band gaps between rod and cement leave less grip; above it adhesion adds to "
    "friction."
)
RODS = Experiment(
    name="rods",
    title="Polished rods of cobalt-chromium pushed out of cement",
    blind=False,
    quantities={
        "strength": PredictedQuantity.of_run(
            "mean shear strength of a polished rod",
            "MPa",
            shear_strength,
            "tight",
            GRIP,
        ),
        "strength_gap": PredictedQuantity.of_run(
            "mean shear strength of a polished rod with an even gap before the cement cools",
            "MPa",
            shear_strength,
            "gap",
            GRIP,
        ),
    },
)

# Slabs under torsion


def motion(run: Results) -> float:
    """Largest motion of the stem [um]."""
    return float(1e3 * run.summary["interfaces"]["stem_cement"]["motion_max"])


SLAB_FAILURE = "Outside of the band torque or places of contact differ from those assumed."
SLAB = Experiment(
    name="slab",
    title="Motion of stems in slabs of femora under torsion",
    blind=False,
    quantities={
        "fixed": PredictedQuantity.of_run(
            "largest motion of a well fixed stem",
            "um",
            motion,
            "fixed",
            SLAB_FAILURE,
        ),
        "retrieved": PredictedQuantity.of_run(
            "largest motion of a retrieved stem with contact at 11.5 % of the angles",
            "um",
            motion,
            "retrieved",
            SLAB_FAILURE,
        ),
    },
)

# Stems of five sections under torsion


def torque_at_failure(run: Results) -> float:
    """Torque over that of the case at which a hundredth of the bond has failed [-]."""
    return 1 / float(run.summary["bonds"]["stem_cement"]["failure_index_p99"])


SECTION_WORDS = {
    "circle": "a circle",
    "rounded": "a rectangle with round corners",
}
SECTIONS = Experiment(
    name="sections",
    title="Torsion of three stem sections in a square tube",
    blind=True,
    quantities={
        f"sharp_over_{section}": PredictedQuantity.ratio(
            f"torque at first failure of a rectangle with sharp corners over that of {words}",
            torque_at_failure,
            "sharp",
            section,
            "Above the band a bond that fails at the corners is not yet seen as first failure; "
            "cracks in the mantle may also come first.",
        )
        for section, words in SECTION_WORDS.items()
    },
)

# Tapered plugs pressed into cement

# Force on a quarter of a plug in the case [N], and the parts of a plug.
PLUG_FORCE = 2500.0
QUARTERS = 4
# Mean shear at which the bond of cement to the shell fails, that of the experiment [MPa].
SHELL_BOND = 8.0
# Mean shear at which the bond of a rough plug fails, that of blasted rods [MPa].
PLUG_BOND = 8.6
# Von Mises stress at which cement yields, the middle of 70 to 110 MPa [MPa].
YIELD = 90.0


def failure_shares(run: Results) -> dict[str, float]:
    """Stress over strength in the case, by what fails: shell, cement, or the plug's bond."""
    summary = run.summary
    bonds = summary["bonds"]
    stress_over_strength = {
        "shell": bonds["cement_shell"]["shear_mean"] / SHELL_BOND,
        "cement": summary["regions"]["cement"]["von_mises_p99"] / YIELD,
    }
    if "plug_cement" in bonds:
        stress_over_strength["plug"] = bonds["plug_cement"]["shear_mean"] / PLUG_BOND
    return {name: float(ratio) for name, ratio in stress_over_strength.items()}


def plug_load(run: Results) -> float:
    """Load at which the first part fails [kN]."""
    return QUARTERS * PLUG_FORCE / 1e3 / max(failure_shares(run).values())


PLUGS = Experiment(
    name="plugs",
    title="Tapered plugs pressed into cement in aluminium shells",
    blind=True,
    quantities={
        "smooth_over_bonded": PredictedQuantity.ratio(
            "load at failure of a smooth plug over that of a bonded one, taper 7.5, straight shell",
            plug_load,
            "smooth7",
            "bonded",
            "Outside of the band parts fail one after another, or the hoop stress of a wedge "
            "breaks the cement.",
        ),
        "taper_effect": PredictedQuantity.ratio(
            "load at failure of a smooth plug of taper 10 over that of taper 7.5, straight shell",
            plug_load,
            "smooth10",
            "smooth7",
            "Outside of the band the pressure of the wedge, which these criteria do not count, "
            "holds or breaks the cement.",
        ),
        "smooth_tapered_over_straight": PredictedQuantity.ratio(
            "load at failure in a tapered shell over that in a straight one, smooth plug",
            plug_load,
            "tapered_smooth",
            "smooth7",
            "Below the band a tapered shell gives no support after its bond has failed.",
        ),
        "shell_before_cement": PredictedQuantity(
            "load at which cement yields over that at which the shell's bond fails, smooth plug, "
            "straight shell",
            "-",
            lambda runs: (
                failure_shares(runs["smooth7"])["shell"] / failure_shares(runs["smooth7"])["cement"]
            ),
            "A shell's bond that outlasts the cement, where the band is above 1, is a failure.",
        ),
    },
)
