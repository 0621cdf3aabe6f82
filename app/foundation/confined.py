"""Readers of foreign files, each in a separate process, which a damaged file may crash."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from app.foundation.errors import GeometryError

# Longest time that a reader may take [s].
SECONDS = 3600
_SERVE = "from {0} import {1}; from meshes.gmsh_reader_process import serve; serve({1}, {2})"


def ask(reader: str, request: Mapping[str, object], folder: str) -> dict[str, Any]:
    """Run a reader, ``module:function``, in a folder with its files. Return arrays by name.

    Raises:
        GeometryError: It refuses ``request["path"]``, crashes or is stopped.
    """
    try:
        answer = subprocess.run(
            [sys.executable, "-P", "-c", _SERVE.format(*reader.split(":"), SECONDS)],
            input=json.dumps(request).encode(),
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=SECONDS,
            check=True,
        ).stdout
    except subprocess.SubprocessError as error:
        raise GeometryError(
            f"{request['path']}: gmsh crashed or was stopped: the file is damaged or too large"
            f" (limits are {SECONDS} s and the memory of the machine)"
        ) from error
    # No pickle: a file may have forged the answer.
    with np.load(io.BytesIO(answer), allow_pickle=False) as arrays:
        data = dict(arrays)
    if "error" in data:
        raise GeometryError(str(data["error"]))
    return data
