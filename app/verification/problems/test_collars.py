"""A collar on the neck cut bears an axial load, or a part of it by springs in parallel."""

from __future__ import annotations

from app.verification.problem import KnownProblem, quick, relative, verify

COLLARED = "verification/collar.yaml"
LOAD = 1000.0  # N, along the stem
SHIFT = 0.05  # mm, of the stem along its axis
# Stiffness of the layers under the collar, and on the flanks against shear [MPa/mm].
UNDER = 40.0
BESIDE = 20.0
BONE_REGIONS = ("cortical_bone", "cancellous_bone")


@verify
@quick
def test_collar_takes_all(problem: KnownProblem) -> None:
    """The frictionless flanks of a prism bear no axial force, for any cut and bone."""
    problem.expects(
        "force of a collar along a prismatic stem without friction over the load, relative",
        tolerance=1e-8,
        source="balance of forces",
    )
    solved = problem.solve(COLLARED)
    problem.compare(relative(solved.summary["stem"]["collar_force"], LOAD))


@verify
def test_collar_in_parallel(problem: KnownProblem) -> None:
    """A rigid stem is shifted along its axis in layers of known stiffness, with a level cut."""
    problem.expects(
        "share of the collar in the force along the stem, relative",
        tolerance=2e-3,  # the bone is not quite rigid
        source="springs in parallel",
    )
    layer = f"elastic_layer: {{normal: 10 MPa/mm, tangential: {BESIDE} MPa/mm}}"
    compliance_under = f"elastic_layer: {{normal: {UNDER} MPa/mm, tangential: {BESIDE} MPa/mm}}"
    solved = problem.solve(
        COLLARED,
        "geometry.resection.angle=0 deg",
        *(f"regions.{name}={{rigid: true}}" for name in ("stem", "collar")),
        *(
            f"regions.{name}.youngs_modulus=1e5 GPa"
            for name in ("cortical_bone", "cancellous_bone")
        ),
        "interfaces.stem_bone="
        f"{{kind: contact, friction_coefficient: 5, interference: 0.1 mm, {layer}}}",
        f"interfaces.collar_bone={{kind: contact, friction_coefficient: 0, {compliance_under}}}",
        "loads=null",
        "stages=[{name: insertion}, {name: shift}]",
        "supports.stem={kind: displacement, boundary: stem_trunnion, x: 0 mm, y: 0 mm,"
        f" z: {-SHIFT} mm, history: [0, 1]}}",
    )
    q = solved.summary["interfaces"]
    flanks = sum(part["area"] for part in (q["stem_bone"], q["stem_bone"]["rim"]))
    springs = UNDER * q["collar_bone"]["area"], BESIDE * flanks
    collar_share = solved.summary["stem"]["collar_share"]
    problem.compare(relative(collar_share, springs[0] / sum(springs)))
