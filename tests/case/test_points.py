"""Points of sweeps and studies: how they are combined and named, and errors at their place."""

from __future__ import annotations

import math
import re
import statistics
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.case import points
from app.case import study as study_file
from app.case import sweep as sweep_file
from app.case.case import load_case
from app.case.points import Point
from app.foundation.errors import InputError
from app.schema import yaml_file
from tests import support
from tests.campaigns.bench import CASE, FRICTION, STUDY, SWEEP


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "case.yaml").write_text(CASE)
    return tmp_path / "many.yaml"


def expand(path: Path, text: str) -> list[Point]:
    path.write_text(text)
    return [run.point for run in sweep_file.read(path)[1]]


def refused(path: Path, text: str, *overrides: str) -> list[str]:
    """The messages, without the name of the file."""
    path.write_text(text)
    read = study_file.read if "study:" in text else sweep_file.read
    with pytest.raises(InputError) as error:
        read(path, overrides)
    return [m.removeprefix(f"{path}:").removeprefix(" ") for m in error.value.messages]


def test_points_axes_are_combined_last_fastest(path: Path) -> None:
    points = expand(path, SWEEP)
    assert [p.name for p in points[:5]] == [
        "soft_friction_coefficient=0.2_pressure=1MPa",
        "soft_friction_coefficient=0.2_pressure=3MPa",
        "soft_friction_coefficient=0.4_pressure=1MPa",
        "soft_friction_coefficient=0.4_pressure=3MPa",
        "hard_friction_coefficient=0.2_pressure=1MPa",
    ]
    assert len(points) == 8
    assert points[5].changes == {
        "regions.upper.poisson_ratio": 0.25,
        "regions.lower.youngs_modulus": "2 GPa",
        FRICTION: 0.2,
        "loads.press.pressure": "3 MPa",
    }
    assert "regions.upper.poisson_ratio" not in points[5].varied


def test_points_of_lists_and_parts(path: Path) -> None:
    path.with_name("other.yaml").write_text(CASE.replace("1 GPa", "5 GPa"))
    points = expand(
        path,
        """\
base: case.yaml
set: {ranks: 2}
parts:
  together:
    lists: {mesh.size: [4 mm, 2 mm], loads.press.pressure: [1 MPa, 2 MPa], ranks: 1}
  other:
    base: other.yaml
    grid: {interfaces.lower_upper: [{kind: bonded}, {kind: contact, friction_coefficient: 0.1}]}
""",
    )
    assert [(p.name, p.part, p.base, p.changes["ranks"]) for p in points] == [
        ("together/size=4mm_pressure=1MPa", "together", "case.yaml", 1),
        ("together/size=2mm_pressure=2MPa", "together", "case.yaml", 1),
        ("other/lower_upper=bonded", "other", "other.yaml", 2),
        ("other/lower_upper=contact", "other", "other.yaml", 2),
    ]


@pytest.mark.parametrize(
    ("grid", "names"),
    [
        ("{a.gap: [-0.01 mm, 0 mm]}", ["gap=-0.01mm", "gap=0mm"]),
        ("{a.gap: [0.001 * x, -0.001 * x]}", ["gap=0.001", "gap=-0.001"]),
        ("{a.gap: [0.001 * x, 0.001 * y]}", ["gap=#1", "gap=#2"]),
        ("{a.mu: [0.2], b.mu: [0.5]}", ["a.mu=0.2_b.mu=0.5"]),
        ('{a.at: ["[0, 0, -900] N", [1, 1]]}', ["at=#1", "at=#2"]),
        (f"{{a.b: [{'1' * 30}]}}", ["b=#1"]),
    ],
)
def test_points_are_named_by_values(grid: str, names: list[str], path: Path) -> None:
    path.write_text(f"base: case.yaml\ngrid: {grid}\n")
    sweep = sweep_file.Sweep.model_validate(yaml_file.read(path).data)
    assert [p.name for p in sweep.points()] == names


@settings(deadline=None)  # the first draw imports scipy
@given(samples=st.integers(2, 40), seed=st.integers(0, 1000))
def test_points_of_a_latin_hypercube(samples: int, seed: int) -> None:
    design = {
        "samples": samples,
        "seed": seed,
        "inputs": {
            "even": {"low": -1, "high": 3},
            "decades": {"low": "1e2 W/(m^2 K)", "high": "1e5 W/(m^2 K)", "scale": "logarithmic"},
            "names": {"values": ["a", "b"]},
        },
    }
    drawn = points.LatinHypercube.model_validate(design).draw()
    assert drawn == points.LatinHypercube.model_validate(design).draw()
    even = sorted((d["even"] + 1) / 4 for d in drawn)
    texts = [re.fullmatch(r"(\S+) W/\(m\^2 K\)", d["decades"]) for d in drawn]
    decades = sorted(math.log10(float(t[1])) / 3 - 2 / 3 for t in texts if t)
    assert abs([d["names"] for d in drawn].count("a") - samples / 2) <= 0.5
    design["inputs"] = {"even": design["inputs"]["even"]}
    alone = points.LatinHypercube.model_validate(design).draw()
    for shares in (even, decades, sorted((d["even"] + 1) / 4 for d in alone)):
        # Values have six digits.
        assert all(i - 1e-4 <= s * samples <= i + 1 + 1e-4 for i, s in enumerate(shares))
        assert len(shares) == samples


def test_points_of_a_sobol_design() -> None:
    """Each base sample has A, B, and A with each input of B. Coordinates fill their range."""
    inputs = {"a.low": {"low": 0, "high": 1}, "b.high": {"low": "1 mm", "high": "3 mm"}}
    design = {"samples": 16, "inputs": inputs}
    drawn = points.Sobol.model_validate(design).draw()
    assert drawn == points.Sobol.model_validate(design).draw()
    assert len(drawn) == 16 * (2 + 2)
    runs = list(drawn.values())
    for first, second, with_a, with_b in zip(*(runs[k::4] for k in range(4)), strict=True):
        assert with_a == {"a.low": second["a.low"], "b.high": first["b.high"]}
        assert with_b == {"a.low": first["a.low"], "b.high": second["b.high"]}
    assert [*drawn][:4] == ["sample01_A", "sample01_B", "sample01_A_low", "sample01_A_high"]
    shares = sorted(float(str(run["a.low"])) for run in runs[0::4])
    assert all(i / 16 <= s <= (i + 1) / 16 for i, s in enumerate(shares))


def test_points_of_a_study(path: Path) -> None:
    path.write_text(STUDY)
    study, runs, common = study_file.read(path, ["mesh.curved=false", "study.target=0.05"])
    names = [r.name for r in runs]
    assert names[0] == "P1/size=4mm" and names[3] == "P2/size=4mm_far_size=5mm"
    assert [r.point.path for r in runs[-2:]] == [study_file.REFERENCE] * 2
    assert [r.case.mesh.order for r in runs] == [1] * 3 + [2] * 5
    assert [r.case.mesh.size for r in runs] == [4, 2, 1, 4, 2, 1.5, 0.8, 0.5]
    assert study.target == 0.05
    assert common == ("output.condition=true", "mesh.curved=false")


BASE = "base: case.yaml\n"
# A sweep, and the only complaint or the beginning of the first.
SWEEPS = [
    ("grid: {mesh.size: [1 mm]}", "base: missing"),
    (BASE + "grid: {mesh.size: 3 mm}", "2:8: grid.mesh.size: '3 mm' is not a list"),
    (BASE + "grid: {mesh.size: [3 mm, 3 mm]}", "2:26: grid.mesh.size[1]: 3mm is listed twice"),
    (BASE + "grid: {mesh.size: []}", "2:8: grid.mesh.size: a list: value should have at"),
    (BASE + "grid: {ranks: [0]}", "2:16: grid.ranks[0]: 0 is not a number of ranks"),
    (BASE + "set: {ranks: two}", "2:7: set.ranks: 'two' is not a number of ranks"),
    (BASE + "lists: {mesh.size: [1 mm, 2 mm], mesh.order: [1]}", "2:34: lists.mesh.order: has 1"),
    (BASE + "lists: {mesh.size: 1 mm}", "2:1: lists: varies nothing"),
    (BASE + "table: {a: 3}", "2:9: table.a: 3 is not a mapping"),
    (BASE + "table: {2nd: {}}", "2:9: table.2nd: '2nd' is not a name"),
    (BASE + "parts: {p: {}}\ngrid: {mesh.order: [1]}", "3:1: grid: cannot be combined with parts"),
    (BASE + "latin_hypercube: {samples: 3, inputs: {a: {low: 1 mm, high: 2 m}}}", "both ends"),
    (BASE + "latin_hypercube: {samples: 3, inputs: {a: {low: 2, high: 1}}}", "a: 2 is not below 1"),
    (BASE + "latin_hypercube: {samples: 3, inputs: {a: {values: [2, 2]}}}", "2:56: latin"),
    (BASE + "latin_hypercube: {samples: 3, inputs: {a: {high: 2}}}", "low"),
    (BASE + "sobol: {samples: 12, inputs: {a: {low: 1, high: 2}}}", "the next are 8 and 16"),
    (
        BASE + "sobol: {samples: 8, inputs: {a: {low: 1, high: 2}}}\ngrid: {b: [1, 2]}",
        "cannot be combined with other axes",
    ),
    (BASE + "gird: {}", "did you mean 'grid'?"),
    (BASE + "==grid: {}", "2:1: ==grid: unknown key; allowed: base, set, grid"),
    (BASE + "grid: {mesh.sise: [1 mm]}", "2:20: grid.mesh.sise[0]: unknown key"),
    ("base: nix.yaml\ngrid: {mesh.size: [1 mm]}", "1:1: base: "),
    (CASE, "this is a case: use mantle run"),
]


@pytest.mark.parametrize(("text", "message"), SWEEPS)
def test_points_refuse_wrong_sweeps(text: str, message: str, path: Path) -> None:
    messages = refused(path, text + "\n")
    assert any(m.startswith(message) if message[0].isdigit() else message in m for m in messages), (
        messages
    )


# An edit of the study, and a complaint with its place.
STUDIES = [
    ("case.yaml", "nix.yaml", "1:1: base: "),
    ("case.yaml", "many.yaml", "1:1: base: is a study file"),
    ("base: case.yaml", "base: [a]", "1:1: base: a list is not text"),
    ("set: {", "sett: {", "2:1: sett: unknown key; allowed: base, set, study"),
    ("set: {output.condition: true}", "set:", "2:1: set: nothing is not a mapping"),
    ("output.condition: true", "", "4:64: study.quantities[2]: needs output.condition"),
    ("slip_p99,", "slip_p9,", "4:16: study.quantities[0]: 'lower_upper.slip_p9' is not <"),
    ("[lower_upper.slip", "[lowr.slip", "4:16: study.quantities[0]: the geometry (blocks) has no"),
    ("[lower_upper.slip_p99", "[solver.newton", "4:16: study.quantities[0]: 'solver.newton' is"),
    ("1, mesh.size: [4 mm, 2 mm, 1 mm]", "1", "6:5: study.lines.P1: varies nothing"),
    ("[5 mm, 4 mm, 3 mm]", "[5 mm]", "7:58: study.lines.P2.mesh.far_size: has 1 values where"),
    ("[4 mm, 2 mm, 1 mm]", "[]", "6:25: study.lines.P1.mesh.size: is an empty list"),
    ("mesh.order: 1,", "ranks: [1, 2, 0],", "6:24: study.lines.P1.ranks[2]: 0 is not a number"),
    ("[4 mm, 2 mm, 1 mm]", "[4 mm, 2 N, 1 mm]", "6:43: study.lines.P1.mesh.size[1]: '2 N' is "),
    ("2 mm, 1 mm]", "2 mm, 7 mm]", "6:5: study.lines.P1: P1/size=7mm: "),
    ("P2: {mesh.order", "P2: {mesh.oder", "7:10: study.lines.P2.mesh.oder: unknown key"),
    ("[0.8 mm, 0.5 mm]", "[1 mm]", "9:5: study.reference.run: is a list with one value"),
    ("[0.8 mm, 0.5 mm]", "[2 mm, 0.5 mm]", "9:38: study.reference.run.mesh.size[0]: has the mesh "
     "of P1/size=2mm (size 2 mm) and cannot be its reference; expected sizes that no line has, the "
     "last below 1 mm"),
    ("[0.8 mm, 0.5 mm]", "[3 mm, 1.2 mm]", "9:44: study.reference.run.mesh.size[1]: is not finer "
     "than P1/size=1mm (size 1 mm); expected a last size below 1 mm"),
    ("    run: {", "    rum: {", "9:5: study.reference.rum: unknown key"),
    ("    run: ", "    values: {}\n    run: ", "8:3: study.reference: expected either"),
    ("run: {mesh.order: 2, mesh.size: [0.8 mm, 0.5 mm]}", "values: {lower_upper.slip_p99: 4 um}",
     "9:5: study.reference.values: no value for lower_upper.pressure_p99"),
    ("    run: ", "    values: {lower_upper.slip_p99: 4 MPa}\n    run: ",
     "9:14: study.reference.values.lower_upper.slip_p99: '4 MPa'"),
    ("    run: ", "    values: {timing.solve: 1}\n    run: ", "9:14: study.reference.values.tim"),
    ("  lines:", "  target: 0\n  lines:", "5:3: study.target: 0 must be positive"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), STUDIES)
def test_points_refuse_wrong_studies(old: str, new: str, message: str, path: Path) -> None:
    assert old in STUDY
    messages = refused(path, STUDY.replace(old, new, 1))
    assert any(m.startswith(message) for m in messages), messages


def test_points_errors_are_reported_together(path: Path) -> None:
    messages = refused(
        path,
        """\
base: case.yaml
set: {mesh.order: 5}
parts:
  one:
    grid:
      interfaces.lower_upper.friction_coefficient: [0.2, -1]
  two:
    base: missing.yaml
    table: {glued: {interfaces.glue: {kind: bonded}}}
""",
    )
    assert {m.partition(": ")[0] for m in messages} == {"2:7", "6:58", "8:5"}
    path.with_name("case.yaml").write_text(CASE.replace("1 GPa", "-1 GPa", 1))
    text = STUDY.replace("output.condition", "mesh.oder: 1, output.condition")
    messages = refused(path, text, "mesh.curved=3")
    assert messages[0].startswith("2:7: set.mesh.oder: unknown key")
    assert any(m.startswith("--set mesh.curved: 3 is not true or false") for m in messages)
    assert [
        m for m in messages if m.startswith(f"{path.with_name('case.yaml')}:6:") and "lower" in m
    ]
    assert len(messages) == 3


def test_points_refuse_misplaced_sections(path: Path) -> None:
    """The message names the right section."""
    section, grid = STUDY[STUDY.index("study:") :], f"variations: {{grid: {{{FRICTION}: [1]}}}}\n"
    path.write_text(CASE + section + grid)
    with pytest.raises(InputError) as error:
        load_case(path)
    messages = error.value.messages
    assert messages[0].startswith(f"{path}:14:1: study: a case has no section study")
    assert messages[1].startswith(f"{path}:21:14: variations.grid: a grid stands in a sweep file")
    assert len(messages) == 2
    assert refused(path, path.read_text())[0].startswith("14:1: study: expected a study file")


VARIES = """\
base: case.yaml
set: {stages: [{name: load}]}
parts:
  a:
    grid:
      interfaces.lower_upper: [{kind: bonded}, {kind: contact, friction_coefficient: 1}]
      stages[0].increments: [1, 2]
  b: {lists: {mesh.size: [2 mm, 4 mm], ranks: [1, 2]}}
  c: {table: {one: {mesh.order: 1}, two: {mesh.order: 2}}}
  d: {latin_hypercube: {samples: 3, inputs: {regions.lower.poisson_ratio: {low: 0.2, high: 0.3}}}}
"""


@pytest.mark.parametrize(
    ("text", "option", "place"),
    [
        (VARIES, "interfaces.lower_upper={kind: bonded}", "6:7: parts.a.grid.interfaces.lower"),
        (VARIES, f"{FRICTION}=0.3", "6:7: parts.a.grid.interfaces.lower_upper"),
        (VARIES, "interfaces={}", "6:7: parts.a.grid.interfaces.lower_upper"),
        (VARIES, "stages.0.increments=2", "7:7: parts.a.grid.stages[0].increments"),
        (VARIES, "stages=[{name: one}]", "7:7: parts.a.grid.stages[0].increments"),
        (VARIES, "mesh.size=3 mm", "8:15: parts.b.lists.mesh.size"),
        (VARIES, "ranks=2", "8:40: parts.b.lists.ranks"),
        (VARIES, "mesh.order=2", "9:21: parts.c.table.one.mesh.order"),
        (VARIES, "regions.lower.poisson_ratio=0.3", "10:46: parts.d.latin_hypercube.inputs"),
        (STUDY, "mesh.size=3 mm", "6:25: study.lines.P1.mesh.size"),
        (STUDY, "mesh={order: 1, size: 3 mm}", "6:10: study.lines.P1.mesh.order"),
    ],
)
def test_points_refuse_set_of_varying_keys(text: str, option: str, place: str, path: Path) -> None:
    """Otherwise the table would show values that were never used."""
    why = f"varies, but --set {option.split('=')[0]}"
    messages = [m for m in refused(path, text, option) if why in m]
    assert messages[0].startswith(place), messages


def test_points_overrides_apply_to_every_case(path: Path) -> None:
    """Overrides replace values of ``set``."""
    path.write_text(SWEEP)
    for r in sweep_file.read(path, ["regions.upper.poisson_ratio=0.4", "ranks=2"])[1]:
        assert r.case.regions["upper"].poisson_ratio == 0.4 and r.ranks == 2
        assert r.point.changes["regions.upper.poisson_ratio"] == 0.4
    with pytest.raises(InputError, match="--set ranks: 'none' is not a number of ranks"):
        sweep_file.read(path, ["ranks=none"])


@pytest.mark.parametrize(
    ("run", "message"),
    [
        ("mesh.size: [2.95 mm, 1 mm]", "stem/size=3mm (72 lines around)"),
        (
            "mesh.size: 5 mm, mesh.around: [72, 80]",
            "around[0]: has the mesh of stem/size=3mm (72",
        ),
        ("mesh.size: [2.5 mm, 1 mm]", ""),
        ("mesh.size: 4 mm", ""),
        ("mesh.size: 4 mm, stages.0.increments: [2, 4]", ""),  # of the method, on this mesh
    ],
)
def test_points_reference_has_separate_lines_around(run: str, message: str, path: Path) -> None:
    text = f"""\
base: {support.CONFIGS / "stance.yaml"}
study:
  quantities: [stem.subsidence]
  lines: {{stem: {{mesh.size: [4 mm, 3 mm]}}}}
  reference: {{run: {{{run}}}}}
"""
    path.write_text(text)
    if message:
        assert message in refused(path, text)[0]
    else:
        assert study_file.read(path)[1]


MANY = [p for name in ("studies", "sweeps") for p in (support.CONFIGS / name).glob("*.yaml")]


@pytest.mark.parametrize("path", sorted(MANY), ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_points_of_shipped_files_are_valid(path: Path) -> None:
    if "study" in yaml_file.read(path).data:
        assert study_file.read(path)[1]
    else:
        assert sweep_file.read(path)[1]


def test_points_of_the_paper_are_complete() -> None:
    """Figures 3 to 8 need this number of cases.

    Cases that differ in friction alone share a process.
    """
    _, planned = sweep_file.read(support.CONFIGS / "sweeps" / "paper.yaml")
    stances = {
        (
            p.case.geometry.cement_thickness,
            p.case.regions["stem"].youngs_modulus,
            p.case.interfaces["cement_bone"].friction_coefficient,
        )
        for p in planned
        if p.point.part in ("thickness", "friction")
    }
    assert stances == {(t, e, 1.0) for t in (2, 3, 4, 5, 7) for e in (110e3, 200e3)} | {
        (4.0, e, friction) for e in (110e3, 200e3) for friction in (0.4, 0.6, 0.8, 1.0)
    }
    hot = [p.case for p in planned if p.point.part == "hot"]
    assert {c.geometry.cement_thickness for c in hot} == {2, 3, 4, 5}
    assert {"held" in c.heat for c in hot} == {True, False}
    assert {p.point.part for p in planned} >= {"limits", "residual", "intact"}


def test_points_of_the_cohort_have_the_library_mean() -> None:
    """Hip forces for 600 N, scaled to body weights, have the mean of the library's set."""
    path = support.CONFIGS / "sweeps" / "cohort.yaml"
    parts = yaml_file.read(path).data["parts"]
    cases = {p.name: p.case for p in sweep_file.read(path)[1]}
    assert len(cases) == 29
    for name, part in parts.items():
        forces = []
        for patient, row in part["table"].items():
            forces.append([float(c) for c in re.findall(r"-?[\d.]+", row["loads.hip.force"])])
            scale = float(row["loads.body_weight"].removesuffix(" N")) / 600
            hip = cases[f"{name}/{patient}"].loads["hip"].resultant
            assert hip == pytest.approx([scale * c for c in forces[-1]])
        name = name.replace("walking", "walking_hip")  # the muscles are of other patients
        library = support.case(f"base: stance\nloads: {{library: {name}}}\n").loads
        mean = [statistics.mean(c) for c in zip(*forces, strict=True)]
        assert mean == pytest.approx(library["hip"].resultant, abs=0.4)
