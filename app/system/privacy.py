"""Outputs that tell nothing of user and machine: no host, no command line, no folders."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

# Set by `mantle run --private`, for the ranks too: folders that may have blanks in their names.
ASKED = "MANTLE_PRIVATE"
# A path from the root: what follows no letter, digit or closing bracket (as a unit would).
PATH = re.compile(r"(?<![\w.)\]/])(?:/[^\s/'\"`,:;()<>|]+)+")


def ask(*folders: Path) -> None:
    """Have outputs be private, with these folders left out of whatever names them."""
    os.environ[ASKED] = os.pathsep.join(str(folder.absolute()) for folder in folders)


def asked() -> bool:
    """Whether outputs are to be private."""
    return bool(os.environ.get(ASKED))


def told(content: Any) -> Any:
    """What is told of a text, or of all texts of a nesting: private if that is asked for."""
    return without_folders(content) if asked() else content


def without_folders(content: Any) -> Any:
    """A text, or all texts of a nesting, with names of files in the place of their paths."""
    if isinstance(content, dict):
        return {key: without_folders(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [without_folders(value) for value in content]
    if not isinstance(content, str):
        return content
    if content.startswith("/") and "\n" not in content and Path(content).exists():
        return Path(content).name
    known = [*os.environ.get(ASKED, "").split(os.pathsep), os.getcwd(), os.path.expanduser("~")]
    for folder in known:
        if len(folder) > 1:
            content = content.replace(f"{folder}/", "")
    return PATH.sub(lambda found: found[0].rpartition("/")[2], content)
