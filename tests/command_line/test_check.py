"""``mantle check`` needs neither solver nor mesher; its notes on cases."""

from __future__ import annotations

import re
import resource
from pathlib import Path

import pytest

import mantle
from app.case.case import load_case
from app.cli import main
from app.foundation.errors import InputError
from app.soundness import preview
from tests import support
from tests.support import CONFIGS

CHECK = """
import sys
from app.cli import main
assert main(["check", "configs/stance.yaml"]) == 0
heavy = {"dolfinx", "mpi4py", "petsc4py", "gmsh", "ufl", "h5py", "scipy", "matplotlib"}
print("loaded:", heavy & sys.modules.keys())
"""


def test_check_imports_neither_solver_nor_mesher() -> None:
    """Processor time is measured, because the machine may be busy."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert support.python("-c", CHECK).stdout.splitlines()[-1] == "loaded: set()"
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime < 2.0


STANCE = """
Single-limb stance, titanium stem, 4 mm mantle; changed: cement_thickness 0.3 cm
  cement_thickness: 3 mm  (0.3 cm)
  stem:
    length: 147 mm  [default]
    neck_angle: 130 deg  [default]
  stem: isotropic
    youngs_modulus: 110000 MPa  (110 GPa)
  cortical_bone: transversely_isotropic
  stem_cement (stem | cement): contact
    friction_coefficient: 0.4
  shaft: fixed on distal_cut
  hip: force on stem_trunnion, force [-399.5, -159.9, -1747.8] N, at [43, 0, 54] mm
  psoas: force on psoas, force [11.8, 35.3, 100] N, at [21, -1.5, -7] mm
  sum of the forces at the end: [0.1, -0.1, -503.4] N, 503.4 N
not measured
  assumed: regions stem, cement, cancellous_bone; all loads
  unverified: regions cortical_bone
  stance: 2 increments, adaptive
"""
HEAT = """
    thermal:
      initial_temperature: 22 degC
      density: 1.2e-09 tonne/mm^3  (1200 kg/m^3)
      cure:
        kinetics: autocatalytic
          activation_energy: 62866 J/mol
        heat: 155 J/cm^3  (1.55e+08 J/m^3)
        exponent: 1
    conductance: 1 mW/(mm^2*K)  (1000 W/(m^2 K))
    conductance: perfect, one temperature
  hold: fixed on stem_trunnion, stages [setting, cooling]
  tissue: convection on bone_surface, coefficient 0.02 mW/(mm^2*K), ambient 37 degC
  setting: 3600 s, 1 increment, adaptive
  stance: 2 increments, adaptive
  method: sdirk4  [default]
  first_step: 0.001 s  (1 ms)
  tip: point, at [0, 0, -130] mm
"""


@pytest.mark.parametrize(
    ("name", "changes", "lines", "size", "absent"),
    [
        (
            "stance",
            ["geometry.cement_thickness=0.3 cm"],
            STANCE,
            "size (estimated; --mesh counts the cells)",
            ("\nheat\n", "\ntime\n", "temperature", "conductance"),
        ),
        (
            "residual",
            [
                "time.first_step=1 ms",
                "interfaces.cement_bone.conductance=perfect",
                "output.probes={tip: [0 mm, 0 mm, -130 mm]}",
            ],
            HEAT,
            "temperature jumps",
            (),
        ),
        # Conductors have no notes on mechanics.
        ("cure", [], "\nheat\n", "", ("\nsupports\n", "\nloads\n", "displacement")),
    ],
    ids=["stance", "residual", "cure"],
)
def test_check_prints_the_case_as_read(
    name: str,
    changes: list[str],
    lines: str,
    size: str,
    absent: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(CONFIGS)  # the width of lines is not that of the folder's path
    assert main(["check", f"{name}.yaml", *support.sets(*changes)]) == 0
    out, err = capsys.readouterr()
    notes = ("conductance does not change", "is about") if name == "residual" else ()
    assert all(any(note in line for note in notes) for line in err.splitlines()) and size in out
    assert set(lines.splitlines()) <= set(out.splitlines())
    assert not any(word in out for word in absent)
    assert name != "stance" or all(len(line) <= 120 for line in out.splitlines())


def test_check_estimates_temperature_unknowns(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("gmsh")
    conductor = (
        "{kind: conductor, thermal: {conductivity: 1 W/(m K), density: 1000 kg/m^3, "
        "specific_heat: 1000 J/(kg K), initial_temperature: 37 degC}}"
    )
    glued = "{kind: bonded, conductance: 300 W/(m^2 K)}"
    changes = [f"regions.{name}={conductor}" for name in ("stem", "cement", "bone")]
    changes += [f"interfaces={{stem_cement: {glued}, cement_bone: {glued}}}", "supports={}"]
    changes += ["stages=[{name: wait, duration: 1 s}]", "mesh.size=3 mm"]
    case = [str(CONFIGS / "cylinders.yaml"), *support.sets(*changes)]
    counts = []
    for mesh in ([], ["--mesh"]):
        assert main(["check", *case, *mesh]) == 0
        (line,) = [x for x in capsys.readouterr().out.splitlines() if "temperature jumps" in x]
        counts.append([int(part.replace(",", "")) for part in re.findall(r"\d[\d,]*(?= \w)", line)])
    for estimated, exact in zip(*counts, strict=True):
        assert 0.5 < estimated / exact < 2.0


@pytest.mark.parametrize(
    "change",
    [
        "regions.stem.thermal.conductivity=14.8 kW/(m mK)",
        "regions.cement.thermal.conductivity=0.2 mW/(m K)",
        "regions.stem.thermal.density=8.3 kg/m^3",
        "regions.cement.thermal.specific_heat=1450 J/(g K)",
        "regions.stem.thermal.initial_temperature=37 K",
        "regions.cement.thermal.cure.heat=155 J/m^3",
        "heat.tissue.ambient=37 K",
        "heat.blood_cortical.temperature=37 K",
    ],
)
def test_check_notes_implausible_materials(change: str) -> None:
    cure = CONFIGS / "cure.yaml"
    assert preview.input_notes(load_case(cure).config) == []
    (note,) = preview.input_notes(load_case(cure, [change]).config)
    assert note.text.startswith(f"{change.partition('=')[0]} is ")
    assert note.text.endswith("; is the unit wrong?")


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda p: p.stem)
def test_check_accepts_every_shipped_case(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(path)]) == 0
    # Laws that rest on memory, conductances that stay, and nothing else.
    notes = capsys.readouterr().err.splitlines()
    memory = [line for line in notes if "from memory: check" in line]
    composite = {"composite_intact", "composite_stem"}
    assert not memory or path.stem in {"creep_taper", "day", "fatigue", "life"} | composite
    open_ = [line for line in notes if "conductance does not change" in line]
    assert not open_ or path.stem in {"history", "life", "residual", "thermal_100C"}
    # One with probes is meshed.
    stiff = [line for line in notes if line.endswith("too stiff; use mesh.order: 2")]
    assert not stiff or path.stem == "thermal_100C"
    assert notes == [*memory, *open_, *stiff]


def test_check_notes_missing_loads(capsys: pytest.CaptureFixture[str]) -> None:
    path = str(CONFIGS / "blocks.yaml")
    assert main(["check", path, "--set", "loads="]) == 2
    assert main(["check", path, "--set", "loads={}"]) == 0
    assert "note: nothing acts on the model" in capsys.readouterr().err


BONE = (
    "{{kind: transversely_isotropic, axial_youngs_modulus: {} GPa, transverse_youngs_modulus: 1 GPa"
    ", axial_poisson_ratio: {}, transverse_poisson_ratio: {}, axial_shear_modulus: 1 GPa}}"
)


@pytest.mark.parametrize(
    ("region", "locks"),
    [
        ("{youngs_modulus: 1 GPa, poisson_ratio: 0.45}", False),
        ("{youngs_modulus: 1 GPa, poisson_ratio: 0.451}", True),
        ("{youngs_modulus: 1 GPa, poisson_ratio: -0.99}", False),
        (BONE.format(1, 0.44, 0.44), False),  # isotropic but for the shear modulus
        (BONE.format(1, 0.46, 0.46), True),
        (BONE.format(4, 0.46, 0.46), False),
        (BONE.format(4, 0.9, 0.46), True),  # 1 - 0.46 - 2 0.81 / 4 = 0.135
        ("{rigid: true}", False),
    ],
)
def test_check_notes_locking(region: str, locks: bool) -> None:
    changes = [f"regions.cement={region}", "interfaces={}"]
    notes = [
        v.text for v in preview.input_notes(load_case(CONFIGS / "blocks.yaml", changes).config)
    ]
    assert [m.split(" is ")[0] for m in notes] == (["regions.cement"] if locks else [])
    assert all("lock" in m and "mesh.order: 2" in m for m in notes)
    second = load_case(CONFIGS / "blocks.yaml", [*changes, "mesh.order=2"]).config
    assert preview.input_notes(second) == []


def test_check_accepts_a_press_fit_by_penalty() -> None:
    gap = "interfaces.stem_cement={kind: penalty, friction_coefficient: 0, penalty: 1 GPa/mm, gap: "
    still = [
        "interfaces.cement_bone={kind: bonded}",
        "supports.push={kind: roller, boundary: stem_top, axis: z}",
    ]
    for value, noted in (("0 mm", True), ("-0.01 mm", False), ("-0.01 * z", False)):
        case = load_case(CONFIGS / "cylinders.yaml", [*still, f"{gap}{value}}}"]).config
        assert any("nothing acts" in note.text for note in preview.input_notes(case)) == noted


@pytest.mark.parametrize(
    "press_fit", ["interference: 0.01 mm", "zones: {low: {below: 5 mm, interference: 0.01 mm}}"]
)
def test_check_finds_that_a_press_fit_alone_acts_on_the_model(press_fit: str) -> None:
    law = f"{{kind: contact, friction_coefficient: 0.3, {press_fit}}}"
    changes = [
        "interfaces.cement_bone={kind: bonded}",
        "supports.push={kind: roller, boundary: stem_top, axis: z}",
        f"interfaces.stem_cement={law}",
    ]
    case = load_case(CONFIGS / "cylinders.yaml", changes).config
    assert not any("nothing acts" in note.text for note in preview.input_notes(case))


@pytest.mark.parametrize(
    ("probe", "where"),
    [
        ({"at": "[4 mm, 4 mm, 41 mm]"}, "[4.0, 4.0, 41.0] mm is not in the model"),
        ({"at": "[2 mm, 2 mm, 9 mm]", "region": "cement"}, "is not in region 'cement'"),
        ({"at": "[-2 mm, 2 mm, 9 mm]"}, "is not in the model"),
        ({"at": "[2 mm, 2 mm, 9 mm]", "region": "stem"}, ""),
        ({"at": "[5 mm, 5 mm, 20 mm]", "region": "cement"}, ""),
    ],
)
@pytest.mark.parametrize("order", [1, 2])
def test_check_finds_a_probe_outside_its_region(
    probe: dict[str, str], where: str, order: int
) -> None:
    """The check finds the probe without `--mesh`. The radius of the stem is 7 mm."""
    changes = {"mesh.size": "4 mm", "mesh.order": order, "output.probes": {"tip": probe}}
    case = mantle.load(CONFIGS / "cylinders.yaml", **changes)
    if not where:
        assert "unknowns" in mantle.check(case).size
        return
    with pytest.raises(InputError) as caught:
        mantle.check(case)
    assert "output.probes.tip: " in str(caught.value) and where in str(caught.value)


def test_check_finds_a_shipped_case_beside_a_folder_of_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder of results often has the name of its case."""
    (tmp_path / "blocks").mkdir()
    monkeypatch.chdir(tmp_path)
    assert main(["check", "blocks"]) == 0
    assert "Patch test of three blocks" in capsys.readouterr().out
