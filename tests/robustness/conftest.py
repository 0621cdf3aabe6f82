"""What tests of faults share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.robustness import faulty


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Faults, kills and fuzzing are for ``--all``: they start many runs."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def warmed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache in which everything is that the small run needs."""
    folder = tmp_path_factory.mktemp("warm")
    done = faulty.run(folder / "out", faulty.HERE, folder / "cache")
    assert done.returncode == 0, done.stderr
    yield folder / "cache"
