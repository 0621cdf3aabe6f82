"""Library of materials and loads by name, each with its source: shipped and of the user."""

from __future__ import annotations

import textwrap
from pathlib import Path

import configs
from app.schema import yaml_file
from app.schema.section import show
from app.schema.yaml_file import CaseFile, Fault

SHIPPED = configs.FOLDER / "library" / "library.yaml"
# Keys of an entry beside its values.
ABOUT, SOURCE = "about", "source"
KINDS = {
    "materials": "a region takes one by `material: NAME`",
    "loads": "the loads of a case are those of a name by `library: NAME` among them",
}


def read(path: Path = SHIPPED) -> CaseFile:
    """The content of a library.

    Raises:
        InputError: The file cannot be read or is no library.
    """
    file = yaml_file.read(path)
    faults = []
    for kind, entries in file.data.items():
        if kind not in KINDS:
            faults.append(Fault((kind,), f"unknown key; allowed: {', '.join(KINDS)}"))
        elif not isinstance(entries, dict):
            faults.append(Fault((kind,), f"{show(entries)} is not a mapping of names to entries"))
        else:
            for name, entry in entries.items():
                if not (isinstance(entry, dict) and isinstance(entry.get(SOURCE), str)):
                    text = f"expected a mapping with '{SOURCE}', a text that tells where it is from"
                    faults.append(Fault((kind, name), text))
    file.raise_all(faults)
    return file


def listed(kind: str) -> str:
    """List the shipped names of a kind with their descriptions, as text."""
    entries = read().data[kind]
    wide = max(map(len, entries), default=0)
    lines = [f"  {name:<{wide}}  {entry.get(ABOUT, '')}" for name, entry in entries.items()]
    return "\n".join([f"{kind}: {KINDS[kind]}", *lines])


def names() -> list[str]:
    """The shipped names of all kinds."""
    return [name for entries in read().data.values() for name in entries]


def described(name: str) -> str:
    """Text of a shipped entry with its source, as in the library."""
    file = read()
    texts = SHIPPED.read_text(encoding="utf-8").splitlines()
    starts = sorted(p[1] for key, p in file.places.items() if len(key) <= 2)
    kind = next(kind for kind in file.data if name in file.data[kind])
    start = int(file.places[kind, name][1])
    end = next((int(n) for n in starts if int(n) > start), len(texts) + 1)
    kept = [t for t in texts[start - 1 : end - 1] if not t.lstrip().startswith("#")]
    return textwrap.dedent("\n".join(kept)).strip()
