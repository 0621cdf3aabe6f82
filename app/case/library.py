"""Materials and loads by name, each with its source: those that come with mantle, and one's own."""

from __future__ import annotations

import textwrap
from pathlib import Path

import configs
from app.errors import InputError
from app.schema import yaml_file
from app.schema.section import did_you_mean, show
from app.schema.yaml_file import CaseFile, Fault

SHIPPED = configs.FOLDER / "library" / "library.yaml"
# What an entry says beside its values.
ABOUT, SOURCE = "about", "source"
KINDS = {
    "materials": "a region takes one by `material: NAME`",
    "loads": "the loads of a case are those of a name by `library: NAME` among them",
}


def read(path: Path = SHIPPED) -> CaseFile:
    """The content of a library.

    Raises:
        InputError: The file cannot be read, or is none.
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


def listed(path: Path = SHIPPED) -> str:
    """The names in a library and what they are, as text."""
    lines = []
    for kind, entries in read(path).data.items():
        lines += [f"{kind}: {KINDS[kind]}"]
        wide = max(map(len, entries), default=0)
        lines += [f"  {name:<{wide}}  {entry.get(ABOUT, '')}" for name, entry in entries.items()]
    return "\n".join(lines)


def described(name: str, path: Path = SHIPPED) -> str:
    """An entry with its source, as it stands in the library.

    Raises:
        InputError: There is none of this name.
    """
    file = read(path)
    texts = path.read_text(encoding="utf-8-sig").splitlines()
    starts = sorted(p[1] for key, p in file.places.items() if len(key) <= 2)
    for kind in file.data:
        if name in file.data[kind]:
            start = int(file.places[kind, name][1])
            end = next((int(n) for n in starts if int(n) > start), len(texts) + 1)
            kept = [t for t in texts[start - 1 : end - 1] if not t.lstrip().startswith("#")]
            return textwrap.dedent("\n".join(kept)).strip()
    known = [n for entries in file.data.values() for n in entries]
    raise InputError(f"{name}: not in the library: {', '.join(known)}{did_you_mean(name, known)}")
