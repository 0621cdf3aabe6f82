"""Fixtures of tests of faults."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import support
from tests.robustness import faulty


@pytest.fixture(scope="session")
def warmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache with everything that the small run needs."""
    folder = tmp_path_factory.mktemp("warm")
    support.python(*faulty.arguments(folder / "out"), XDG_CACHE_HOME=str(folder / "cache"))
    return folder / "cache"
