"""Provenance of a result: the inputs that were read at the start of the run."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import mantle

BASE = """
geometry: {kind: blocks, blocks: [{name: lower, size: [4 mm, 4 mm, 2 mm]}]}
mesh: {size: 2 mm}
regions: {lower: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}}
supports: {floor: {kind: fixed, boundary: bottom}}
loads: {press: {kind: pressure, boundary: top, pressure: 2 MPa}}
"""


def test_session_provenance_has_the_case_as_it_was_read(tmp_path: Path) -> None:
    """Files change after they are read. Digests are those of the bytes that were parsed."""
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
    versions = {name: record["identity"][name] for name in ("dolfinx", "petsc", "gmsh")}
    assert all(v[0].isdigit() for v in versions.values()), versions
    assert record["identity"]["blas"] and "host" not in record and "command" not in record
