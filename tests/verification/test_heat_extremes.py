"""Stiff and extreme thermal cases: they pass, and the table tells what they took."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import pytest

from app.campaigns.batch import Options
from app.verification import engine


@pytest.mark.slow
def test_stiff_cases_pass(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Bounds of temperature and cure, and heat, in every case; steps told for each."""
    caplog.set_level(logging.INFO, "mantle")
    passed = engine.run("verify", Options(tmp_path, 2, "stiff"))
    entries = json.loads((tmp_path / "verify-stiff.json").read_text())
    assert passed, [
        (e["name"], e["error"], e["message"]) for e in entries if e["outcome"] != "passed"
    ]
    assert len(entries) > 15
    for e in entries:
        assert re.match(r"steps \d+, rejected \d+, balance \d", e["note"])
        assert e["note"] in caplog.text
