"""Files that are whole or absent."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.foundation import files


def test_files_unfinished_have_random_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    victim, path = tmp_path / "victim", tmp_path / "summary.json"
    victim.write_text("mine")
    monkeypatch.setattr("secrets.token_hex", lambda n: "known")
    (tmp_path / f"{path.name}.known.partial").symlink_to(victim)
    with pytest.raises(FileExistsError):
        files.write_bytes(path, b"newer")
    assert victim.read_text() == "mine" and not path.exists()
