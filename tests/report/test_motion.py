"""A film of the recorded steps of a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from PIL import Image

from app.foundation.errors import InputError
from app.report import motion
from app.results.reading import Run


def test_motion_gif_has_a_picture_of_each_step(moving: Run, tmp_path: Path) -> None:
    """Eight pictures of equal size take two seconds. Slip grows from picture to picture."""
    path = motion.write(moving.folder, tmp_path / "films" / "slip.gif")
    with Image.open(path) as film:
        assert (film.n_frames, film.info["duration"], film.info["loop"]) == (8, 250, 0)
        pictures = []
        for k in range(film.n_frames):
            film.seek(k)
            pictures.append(np.asarray(film.convert("RGB"), dtype=float))
    assert len({picture.shape for picture in pictures}) == 1
    # The green of viridis grows with the value.
    height, width, _ = pictures[0].shape
    green = [p[height // 3 : 2 * height // 3, width // 5, 1].mean() for p in pictures]
    assert green[0] < green[4] < green[-1]


def test_motion_of_a_field_of_bodies_is_drawn_on_a_cut(moving: Run, tmp_path: Path) -> None:
    path = motion.write(moving.folder, tmp_path / "stress.gif", "von_mises")
    with Image.open(path) as film:
        assert film.n_frames == 8
        assert len(np.unique(np.asarray(film.convert("RGB")).reshape(-1, 3), axis=0)) > 50


@pytest.mark.skipif(not FFMpegWriter.isAvailable(), reason="ffmpeg is not installed")
def test_motion_mp4_is_written_with_ffmpeg(moving: Run, tmp_path: Path) -> None:
    path = motion.write(moving.folder, tmp_path / "slip.mp4")
    assert path.read_bytes()[4:8] == b"ftyp"


def test_motion_errors_say_what_to_do(
    moving: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match=r"ends in \.gif or \.mp4"):
        motion.write(moving.folder, tmp_path / "slip.avi")
    with pytest.raises(InputError, match=r"no field 'von_misses'; .* did you mean 'von_mises'\?"):
        motion.write(moving.folder, tmp_path / "slip.gif", "von_misses")
    with pytest.raises(InputError, match=r"has no fields\.vtkhdf"):
        motion.write(tmp_path, tmp_path / "slip.gif")
    monkeypatch.setattr(FFMpegWriter, "isAvailable", lambda: False)
    with pytest.raises(InputError, match=r"ffmpeg is not installed; expected .*slip\.gif"):
        motion.write(moving.folder, tmp_path / "slip.mp4")
    assert not [*tmp_path.glob("slip.*")]
