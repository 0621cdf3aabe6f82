"""A folder in which a stand-in replaces ``mantle run``."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from app.campaigns import batch
from tests.campaigns.bench import STAND_IN, Bench


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.setattr(batch, "MANTLE_RUN", (sys.executable, str(STAND_IN), str(tmp_path)))
    return Bench(tmp_path)
