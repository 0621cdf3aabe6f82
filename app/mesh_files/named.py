"""Files to which a mesh file refers: parts of a script, arrays of XDMF, pieces of a ``.pvtu``."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from functools import lru_cache
from html import unescape
from pathlib import Path

QUOTED = re.compile(r"""\"([^"\n]*)"|'([^'\n]*)'""")
# Text between tags that is a file's name, or has one before a colon. Arrays of numbers are longer.
ARRAYS = re.compile(r">()([^<>:]{1,1024})[:<]")
SOURCES = re.compile(r"""\bSource\s*=\s*(?:"([^"]*)"|'([^']*)')""")
PATTERN_OF_ENDING = {".geo": QUOTED, ".xdmf": ARRAYS, ".xmf": ARRAYS, ".pvtu": SOURCES}


def names(path: Path) -> list[str]:
    """Return the names of a file and of all files in its folder or below to which it refers."""
    folder, names = path.parent.resolve(), [path.name]
    for name in names:  # it grows
        if Path(name).suffix.lower() not in PATTERN_OF_ENDING:
            continue
        for included_name in _words(folder / name, (folder / name).stat().st_mtime_ns):
            included_file = os.path.normpath(Path(name).parent / included_name)
            with suppress(OSError, ValueError):  # not a file name
                inside = (folder / included_file).resolve().is_relative_to(folder)
                if inside and included_file not in names and (folder / included_file).is_file():
                    names.append(included_file)
    return names


def stamps(path: Path) -> tuple[tuple[str, int], ...]:
    """Return `names` with the times of their last changes [ns]."""
    return tuple((name, (path.parent / name).stat().st_mtime_ns) for name in names(path))


@lru_cache(maxsize=8)
def _words(path: Path, _modified: int) -> tuple[str, ...]:
    """Return the words of a file that may be names of files."""
    matches = PATTERN_OF_ENDING[path.suffix.lower()].finditer(path.read_text("utf-8", "replace"))
    return tuple(unescape((m[1] or m[2] or ".").strip()) for m in matches)
