"""Where a result comes from: what was read when the run began."""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
from pathlib import Path

import pytest

import mantle
from app.cli import main
from app.system import privacy
from tests import support

BASE = """
geometry: {kind: blocks, blocks: [{name: lower, size: [4 mm, 4 mm, 2 mm]}]}
mesh: {size: 2 mm}
regions: {lower: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}}
supports: {floor: {kind: fixed, boundary: bottom}}
loads: {press: {kind: pressure, boundary: top, pressure: 2 MPa}}
"""


def test_a_case_that_goes_while_it_runs_is_known_as_it_was_read(tmp_path: Path) -> None:
    """The run ends as any other; digests are those of the bytes that were parsed."""
    base, case = tmp_path / "base.yaml", tmp_path / "case.yaml"
    base.write_text(BASE, encoding="utf-8")
    case.write_text("base: base.yaml\ntitle: Gone\n", encoding="utf-8")
    digests = [hashlib.sha256(p.read_bytes()).hexdigest() for p in (case, base)]
    loaded = mantle.load(case)
    base.write_text("changed", encoding="utf-8")
    case.unlink()
    mantle.run(loaded, tmp_path / "out")
    record = json.loads((tmp_path / "out" / "provenance.json").read_text(encoding="utf-8"))
    assert (tmp_path / "out" / "DONE").exists()
    assert [record["case_sha256"], *record["based_on_sha256"].values()] == digests
    assert record["case"] == str(case) and record["packages"]["h5py"] and record["processor"]


def test_versions_of_what_numbers_depend_on_are_told(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(BASE)
    assert main(["run", str(tmp_path / "case.yaml"), "-o", str(tmp_path / "out")]) == 0
    record = json.loads((tmp_path / "out" / "provenance.json").read_text(encoding="utf-8"))
    versions = {name: record["identity"][name] for name in ("dolfinx", "petsc", "gmsh")}
    assert all(v[0].isdigit() for v in versions.values()), versions
    assert record["identity"]["blas"] and record["host"] == platform.node() and record["command"]


GEO = "my patch.geo"


def test_a_private_run_tells_nothing_of_user_and_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Neither in its files, nor in what it says; and it is known again by them."""
    folder = tmp_path / "Jane Doe" / "patients"
    folder.mkdir(parents=True)
    monkeypatch.setenv(privacy.ASKED, "")  # and back again
    monkeypatch.setattr("platform.node", lambda: "ward-seven")
    shutil.copy(support.CONFIGS / "verification" / "patch.geo", folder / "my patch.geo")
    text = (support.CONFIGS / "verification" / "patch.yaml").read_text().replace("patch.geo", GEO)
    (folder / "base.yaml").write_text(text)
    (folder / "case.yaml").write_text("base: base.yaml\n")
    command = ["run", str(folder / "case.yaml"), "-o", str(folder / "out"), "--private"]
    command.append("--allow-scripts")
    assert main(command) == 0
    said = "".join(capfd.readouterr())
    files = [p for p in (folder / "out").rglob("*") if p.is_file()]
    texts = [p.read_bytes().decode("latin-1") for p in files]
    assert {"summary.json", "provenance.json", "report.html"} <= {p.name for p in files}
    for word in ("Jane Doe", "patients", str(tmp_path), "ward-seven", "--private"):
        assert not [p.name for p, t in zip(files, texts, strict=True) if word in t], word
        assert word not in said, said
    assert main([*command, "--keep"]) == 0
    assert "is finished already" in "".join(capfd.readouterr())


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("results in /home/jane/out/stance", "results in stance"),
        ("'/data/x/a.msh': no region", "'a.msh': no region"),
        ("1.5 N/mm^2, W/(m K)/s and 23% / 4", "1.5 N/mm^2, W/(m K)/s and 23% / 4"),
        ("gap max/p99", "gap max/p99"),
    ],
)
def test_paths_become_names(text: str, expected: str) -> None:
    assert privacy.without_folders([text, {"a": text}, 1]) == [expected, {"a": expected}, 1]
