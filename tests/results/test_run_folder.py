"""The folder of a run: what is left in it if the disk is full."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

import mantle
from app.results.vtkhdf import GridFile
from tests import support

BLOCK = """
geometry: {kind: blocks, blocks: [{name: block, size: [4 mm, 4 mm, 4 mm]}]}
mesh: {size: 4 mm, order: 1}
regions: {block: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}}
supports: {floor: {kind: fixed, boundary: bottom}}
loads: {push: {kind: pressure, boundary: top, pressure: 1 MPa}}
stages: [{name: push, increments: 3, adaptive: false}]
"""


@pytest.mark.parametrize("steps", [0, 2])
def test_run_folder_keeps_what_fits_on_the_disk(
    steps: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fields of some steps fit; `final.vtkhdf` has the last of them, if there is one."""
    write, written = GridFile.write, []

    def write_while_there_is_space(*arguments: object) -> None:
        if len(written) == steps:
            raise OSError(errno.ENOSPC, "No space left on device", "fields.vtkhdf")
        written.append(write(*arguments))

    monkeypatch.setattr(GridFile, "write", write_while_there_is_space)
    case, folder = tmp_path / "block.yaml", tmp_path / "out"
    case.write_text(BLOCK)
    with pytest.raises(mantle.StoppedError, match=r"fields\.vtkhdf: No space left"):
        mantle.run(mantle.load(case), folder)
    assert support.summary(folder)["status"] == "stopped"
    assert (folder / "final.vtkhdf").exists() == bool(steps)
