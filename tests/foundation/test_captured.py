"""Output of a library reaches the log, not the user."""

from __future__ import annotations

import ctypes
import logging
import os

import pytest

from app.foundation.captured import captured
from app.foundation.errors import GeometryError
from meshes.gmsh_session import CROSSING_TEXT, session


def test_captured_output_of_a_library_is_logged(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG, "mantle")
    with captured("noisy") as written:
        ctypes.CDLL(None).puts(b"from C")
        os.write(2, b"from below\n")
        assert written() == ["from C", "from below"]
    os.write(1, b"at last\n")
    assert capfd.readouterr() == ("at last\n", "")
    debug = [r.getMessage() for r in caplog.records if r.levelno == logging.DEBUG]
    assert debug == ["noisy: from C", "noisy: from below"]


def test_captured_streams_are_restored_after_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="wrong"), captured("noisy"):
        os.write(1, b"lost\n")
        raise ValueError("wrong")
    os.write(1, b"kept\n")
    assert capfd.readouterr().out == "kept\n"


def test_captured_error_on_crossing_surfaces_is_explained(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """gmsh prints a "PLC Error" around its log."""
    with pytest.raises(GeometryError, match=CROSSING_TEXT), session("crossing") as gmsh:
        loops = []
        for x, y, z, *size in ((0, 0, 0, 4, 4, 4), (1, 1, 1, 5.3, 2, 2)):
            box = gmsh.model.occ.addBox(x, y, z, *size)
            loops.append(gmsh.model.occ.getSurfaceLoops(box)[0][0])
        gmsh.model.occ.synchronize()
        faces = [
            [tag for _, tag in gmsh.model.getBoundary([(3, box)], oriented=False)]
            for _, box in gmsh.model.getEntities(3)
        ]
        gmsh.model.removeEntities(gmsh.model.getEntities(3))
        gmsh.model.addDiscreteEntity(3, 10, [*faces[0], *faces[1]])
        gmsh.model.mesh.generate(3)
    assert capfd.readouterr() == ("", "")
