"""What tests of faults share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import support
from tests.robustness import faulty


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Faults, kills and fuzzing are for ``--all``: they start many runs."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def warmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache in which everything is that the small run needs."""
    folder = tmp_path_factory.mktemp("warm")
    support.python(*faulty.arguments(folder / "out"), XDG_CACHE_HOME=str(folder / "cache"))
    return folder / "cache"
