"""Bill of materials: all packages of the solver stack with their versions, as CycloneDX JSON."""

from __future__ import annotations

import json
import subprocess
import uuid
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib import metadata
from typing import Any
from urllib.parse import quote

from app.version import __version__

FORMAT = "${db:Status-Status}\\t${Package}\\t${Version}\\t${Architecture}\\n"


def bill() -> str:
    """The bill of what this Python runs with: Debian packages and Python distributions."""
    parts = sorted({p["bom-ref"]: p for p in (*_debian(), *_python())}.items())
    components = [part for _, part in parts]
    own = _component("application", "mantle", __version__, f"pkg:pypi/mantle@{__version__}")
    listed = json.dumps(components)
    return json.dumps(
        {
            "bomFormat": "CycloneDX",
            "specVersion": "1.5",
            # The same packages have the same number.
            "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, listed)}",
            "version": 1,
            "metadata": {
                "timestamp": datetime.now(UTC).isoformat(timespec="seconds"),
                "component": own,
            },
            "components": [c for c in components if c["bom-ref"] != own["bom-ref"]],
        },
        indent=1,
    )


def _component(kind: str, name: str, version: str, url: str) -> dict[str, Any]:
    return {"type": kind, "bom-ref": url, "name": name, "version": version, "purl": url}


def _debian() -> Iterator[dict[str, Any]]:
    """Installed packages of Debian; none where it is another system."""
    try:
        command = ["dpkg-query", "-W", "-f", FORMAT]
        told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return
    for line in told.splitlines():
        status, name, version, architecture = line.split("\t")
        if status == "installed":
            url = f"pkg:deb/debian/{quote(name)}@{quote(version, safe='')}?arch={architecture}"
            yield _component("library", name, version, url)


def _python() -> Iterator[dict[str, Any]]:
    """Distributions that this Python finds, by their names in lower case with hyphens."""
    for found in metadata.distributions():
        name = found.metadata["Name"]
        if name:
            plain = name.lower().replace("_", "-").replace(".", "-")
            url = f"pkg:pypi/{quote(plain)}@{quote(found.version, safe='')}"
            yield _component("library", name, found.version, url)
