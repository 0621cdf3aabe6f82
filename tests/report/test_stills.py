"""Pictures of the interfaces: what is drawn where."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.report import stills, viewer
from app.results.reading import Run
from tests.support import STEM, extended


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A stem in its cement."""
    folder = tmp_path_factory.mktemp("still")
    done = extended(folder, "", STEM, "run", "case.yaml", "-o", "out")
    assert done.returncode == 0, done.stderr
    return Run(folder / "out")


def test_each_interface_is_drawn_on_its_inner_body(run: Run, tmp_path: Path) -> None:
    """Its facets are those of the contact area, and the picture has colours."""
    figure = stills.draw(run, tmp_path, ("png", "pdf"))
    assert figure is not None
    assert (tmp_path / "interfaces.pdf").stat().st_size > 10_000
    import matplotlib.image

    pixels = matplotlib.image.imread(tmp_path / figure.name)[:, :, :3]
    coloured = np.ptp(pixels, axis=2) > 0.2
    assert 0.02 < coloured.mean() < 0.9
    bodies = viewer.outsides(run, curved=True)
    for contact, body in (("stem_cement", "stem"), ("cement_bone", "cement")):
        side = stills._side(run, contact, bodies)
        assert side is not None and side[0] == body
        x = run.points[side[1]]
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum() / 2
        assert area == pytest.approx(run.areas(contact).sum(), rel=1e-9)
