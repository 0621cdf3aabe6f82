"""Reading, resolving and writing a case; the shipped configurations."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from app.case import keys
from app.case.case import Case, dump, load
from app.case.femurs import Femur
from app.case.geometries import Cylinders
from app.case.run_options import Stage
from app.errors import InputError
from app.laws.interface_laws import Bonded
from app.laws.loads import Force
from app.laws.materials import Isotropic
from app.schema.expressions import evaluate

CONFIGS = Path(__file__).parents[2] / "configs"
SHIPPED = sorted(CONFIGS.glob("*.yaml"))
EVERY = [
    p
    for f in (".", "start", "verification", "stress")
    for p in sorted((CONFIGS / f).glob("*.yaml"))
]

MINIMAL = """\
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: "[10, 20, 5] mm"}
    - {name: upper, size: [1 cm, 0.02 m, 5000 um]}
mesh: {order: 1, size: 2 mm}
regions:
  lower: {youngs_modulus: 2.2 GPa, poisson_ratio: 0.3}
  upper: {rigid: true}
supports:
  base: {kind: fixed, boundary: bottom}
"""


def loaded(tmp_path: Path, text: str, *overrides: str) -> Case:
    path = tmp_path / "case.yaml"
    path.write_text(text)
    return load(path, overrides).config


@pytest.mark.parametrize("path", EVERY, ids=lambda p: p.stem)
def test_shipped_case_survives_dump_and_load(path: Path, tmp_path: Path) -> None:
    case = load(path).config
    text = dump(case)
    assert loaded(tmp_path, text) == case.model_copy(update={"variations": {}})
    assert dump(loaded(tmp_path, text)) == text


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_shipped_case_names_an_existing_schema(path: Path) -> None:
    first = path.read_text().splitlines()[0]
    assert first == "# yaml-language-server: $schema=schema.json"


def test_schema_for_editors_is_current() -> None:
    """``mantle explain --schema > configs/schema.json`` renews it."""
    assert json.loads((CONFIGS / "schema.json").read_text()) == keys.json_schema()


def test_stance_is_the_case_of_the_paper() -> None:
    case = load(CONFIGS / "stance.yaml").config
    assert isinstance(case.geometry, Femur)
    assert case.geometry.cement_thickness == 4.0
    hip = case.loads["hip"]
    assert isinstance(hip, Force)
    assert math.hypot(*hip.force) == pytest.approx(1800.0, abs=0.1)
    assert hip.at == case.geometry.head_centre
    assert [law.friction_coefficient for law in case.interfaces.values()] == [0.4, 1.0]  # type: ignore[union-attr]
    forces = np.array([load.force for load in case.loads.values()])  # type: ignore[union-attr]
    medius = [n.startswith("gluteus_medius") for n in case.loads]
    assert forces[medius].sum(axis=0) == pytest.approx([320.6, 124.0, 989.1])


def test_the_two_stance_cases_differ_in_the_stem_alone() -> None:
    titanium, cobalt = (load(CONFIGS / f"{n}.yaml").config for n in ("stance", "stance_cocr"))
    stems = titanium.regions["stem"], cobalt.regions["stem"]
    assert [stem.youngs_modulus for stem in stems] == [110e3, 200e3]  # type: ignore[union-attr]
    regions = {**cobalt.regions, "stem": stems[0]}
    changes = {"title": titanium.title, "regions": regions}
    assert cobalt.model_copy(update=changes) == titanium


def test_defaults_are_filled_in(tmp_path: Path) -> None:
    case = loaded(tmp_path, MINIMAL)
    assert case.interfaces == {"lower_upper": Bonded()}
    assert [stage.name for stage in case.stages] == ["load"]
    assert case.mesh.far == 8.0
    assert case.loads == {}
    assert case.geometry.blocks[0].size == case.geometry.blocks[1].size == (10.0, 20.0, 5.0)  # type: ignore[union-attr]


def test_overrides_reach_everything(tmp_path: Path) -> None:
    case = loaded(
        tmp_path,
        MINIMAL,
        "mesh.size=0.1 cm",
        "geometry.blocks[1].name=top_one",
        "regions.upper=",
        "regions={lower: {rigid: true}, top_one: {youngs_modulus: 1 GPa, poisson_ratio: 0}}",
        "loads.push.kind=force",
        "loads.push.boundary=top",
        "loads.push.force=[0, 0, -1] kN",
        "solver.petsc.ksp_monitor=true",
        "mesh.size=3 mm",
        "stages.0.name=only",
        "stages.0.increments=3",
    )
    assert case.mesh.size == 3.0
    assert case.stages == (Stage(name="only", increments=3),)
    assert case.geometry.region_names == ("lower", "top_one")
    assert case.loads["push"].force == (0.0, 0.0, -1000.0)  # type: ignore[union-attr]
    assert case.solver.petsc == {"ksp_monitor": True}


def test_a_case_is_immutable(tmp_path: Path) -> None:
    case = loaded(tmp_path, MINIMAL)
    with pytest.raises(ValidationError):
        case.title = "other"
    assert isinstance(case.stages, tuple)


def test_single_values_stand_for_all_directions(tmp_path: Path) -> None:
    case = loaded(
        tmp_path,
        MINIMAL,
        "supports.base={kind: foundation, boundary: bottom, stiffness: 0.1 GPa/mm}",
        "regions.lower.eigenstrains=[{strain: -1e-3}, {strain: [0, 0, 1e-3, 0, 0, 0]}]",
    )
    assert case.supports["base"].stiffness == (100.0, 100.0, 100.0)  # type: ignore[union-attr]
    strains = [e.strain for e in case.regions["lower"].eigenstrains]  # type: ignore[union-attr]
    assert strains == [(-1e-3, -1e-3, -1e-3, 0, 0, 0), (0, 0, 1e-3, 0, 0, 0)]


def test_merged_keys_and_anchors(tmp_path: Path) -> None:
    text = MINIMAL.replace("{rigid: true}", "{<<: *lower, poisson_ratio: 0.1}").replace(
        "lower: {youngs", "lower: &lower {youngs"
    )
    upper = loaded(tmp_path, text).regions["upper"]
    assert isinstance(upper, Isotropic)
    assert (upper.youngs_modulus, upper.poisson_ratio) == (2200.0, 0.1)


def test_yaml_is_of_version_1_2(tmp_path: Path) -> None:
    """``no`` is a word, ``1e-3`` a number, and a date text."""
    case = loaded(tmp_path, MINIMAL + "title: no\nsolver: {tolerance: 1e-3}\n")
    assert case.title == "no"
    assert case.solver.tolerance == 1e-3
    assert loaded(tmp_path, MINIMAL + "title: 2024-01-01\n").title == "2024-01-01"


def test_a_mesh_file_is_relative_to_the_case(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "a.msh").write_text(
        '$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n2 1 "floor"\n3 2 "rock"\n'
        "$EndPhysicalNames\n"
    )
    case = loaded(
        tmp_path,
        "geometry: {kind: file, path: meshes/a.msh}\nmesh: {order: 1, size: 1 mm}\n"
        "regions: {rock: {youngs_modulus: 1 GPa, poisson_ratio: 0.2, tissue: other}}\n"
        "supports: {base: {kind: fixed, boundary: floor}}\n",
    )
    other = tmp_path / "elsewhere"
    other.mkdir()
    assert loaded(other, dump(case)) == case


@pytest.mark.parametrize(("sector", "planes"), [("full", ""), ("half", "y"), ("quarter", "xy")])
def test_planes_of_symmetry(sector: str, planes: str) -> None:
    sizes = dict.fromkeys(("stem_radius", "cement_thickness", "bone_thickness", "length"), "7 mm")
    cylinders = Cylinders.model_validate(sizes | {"sector": sector})
    found = {n for n in cylinders.boundary_names if n.startswith("symmetry")}
    assert found == {f"symmetry_{axis}" for axis in planes}


# ------------------------------------------------------------------------------ expressions

POINTS = np.random.default_rng(1).uniform(0.5, 2.0, (7, 3))


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("-0.02 * (1 - z / 50)", lambda x, y, z: -0.02 * (1 - z / 50)),
        ("2", lambda x, y, z: 2 + 0 * x),
        ("min(x, y, z)", lambda x, y, z: np.minimum(np.minimum(x, y), z)),
        ("max(x, y)", lambda x, y, z: np.maximum(x, y)),
        ("hypot(x, y) - 7", lambda x, y, z: np.hypot(x, y) - 7),
        ("atan2(y, x)", lambda x, y, z: np.arctan2(y, x)),
        ("-x**2 + +y", lambda x, y, z: -(x**2) + y),
        ("0.01 * cos(2 * pi * z)", lambda x, y, z: 0.01 * np.cos(2 * np.pi * z)),
        ("abs(log(x)) * exp(-y) / sqrt(z) + sin(x) * tan(y/9)",
         lambda x, y, z: np.abs(np.log(x)) * np.exp(-y) / np.sqrt(z) + np.sin(x) * np.tan(y / 9)),
    ],
)  # fmt: skip
def test_expression(expression: str, expected: object) -> None:
    values = evaluate(expression, POINTS)
    assert values.shape == (7,)
    np.testing.assert_allclose(values, expected(*POINTS.T), rtol=1e-14)  # type: ignore[operator]


@pytest.mark.parametrize(
    ("expression", "reason"),
    [
        ("sqrt(x - 100)", "is not finite at"),
        ("1 / (x - x)", "is not finite at"),
        ("__import__('os')", "'__import__' is not one of"),
        ("x if y else z", "is not allowed"),
        ("(lambda: 1)()", "is not allowed"),
        ("[x for x in y]", "is not allowed"),
        ("x < y", "is not allowed"),
        ("x @ y", "is not allowed"),
        ("min(x)", "min takes 2 to 9 arguments, got 1"),
        (f"min({', '.join(['x'] * 10)})", "min takes 2 to 9 arguments, got 10"),
        ("sqrt(x, y)", r"sqrt takes 1 argument\(s\), got 2"),
        ("sin(x, out=y)", "is not allowed"),
        ("1e999", "too large"),
        ("True", "not numbers"),
        ("'a'", "is not allowed"),
        ("(" * 300 + "x" + ")" * 300, "is not an expression"),
        ("x" + "+x" * 600, "characters"),
        ("", "is not an expression"),
    ],
)
def test_refused_expression(expression: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        evaluate(expression, POINTS)


def test_a_large_power_is_no_large_integer() -> None:
    with pytest.raises(InputError, match="not finite"):
        evaluate("9**9**9**9", POINTS)


@pytest.mark.parametrize(
    "title", ["Lamé, 5 µm", "a\x85b", "a\u2028b", "\ttab", "two\nlines\n", "'", "~", "1e3"]
)
def test_any_title_survives(title: str, tmp_path: Path) -> None:
    case = loaded(tmp_path, MINIMAL).model_copy(update={"title": title})
    path = tmp_path / "dumped.yaml"
    path.write_text(dump(case), encoding="utf-8", newline="")
    assert load(path).config == case


def test_a_byte_order_mark_and_windows_lines_are_no_trouble(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + MINIMAL.replace("\n", "\r\n").encode())
    assert load(path).config == loaded(tmp_path, MINIMAL)
