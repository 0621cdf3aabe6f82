"""The folder for temporary files of a run, which is removed whichever process is killed."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from app.system import scratch
from tests.support import started


def test_scratch_folders_of_killed_runs_are_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scratch, "SHARED", tmp_path)
    child = started(
        "-c",
        "import time; from pathlib import Path; from app.system import scratch;"
        f"scratch.SHARED = Path('{tmp_path}'); held = scratch.variables();"
        "print(held.__enter__()['TMPDIR'], flush=True); time.sleep(60)",
    )
    assert child.stdout is not None
    other = Path(child.stdout.readline().strip())
    (other / "segment").write_text("x")
    with scratch.variables() as first, scratch.variables() as more:
        folders = {str(other), first["TMPDIR"], more["OMPI_MCA_btl_sm_backing_directory"]}
        assert {str(path) for path in tmp_path.iterdir()} == folders and len(folders) == 3
    assert [*tmp_path.iterdir()] == [other]
    child.send_signal(signal.SIGKILL)
    child.communicate()
    with scratch.variables() as first:
        assert [*map(str, tmp_path.iterdir())] == [first["TMPDIR"]]
