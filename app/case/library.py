"""Library of materials, cycle tables, loads and contexts of use by name, shipped or of the user."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import configs
from app.case.former_keys import (
    FORMER_KEYS_OF_LIBRARIES,
    KEY,
    check_version,
    with_present_names,
)
from app.schema import yaml_file
from app.schema.section import show
from app.schema.yaml_file import CaseFile, Fault

SHIPPED = configs.FOLDER / "library" / "library.yaml"
# A name and the lines below it.
ENTRY = r"^  ([\w-]+):\n(?:    .*\n)+"
# Key of an entry with its description.
ABOUT = "about"
# Key of a set of loads: number of times that a patient repeats the activity in a day.
PER_DAY = "per_day"
# Keys that do not go into a case.
FOR_PEOPLE = (ABOUT, PER_DAY)
# Key of an entry: origin of its values.
SOURCE = "source"
# Keys that go into the case with the values.
ORIGIN = ("status", SOURCE)
KINDS_OF_ENTRIES = {
    "materials": "a region takes one by `material: NAME`",
    "finishes": "a cohesive interface takes one by `finish: NAME`",
    "cycle_tables": "a motion, a load or all loads take one by `cycle_table: NAME`",
    "loads": "a case takes the loads of one by `library: NAME` below `loads`",
    "contexts": "a case takes one by `credibility: {library: NAME}`",
}


def read(path: Path = SHIPPED) -> CaseFile:
    """Read and check a library.

    Raises:
        InputError: The file cannot be read or is no library.
    """
    file = yaml_file.read(path)
    check_version(file)
    file.data.pop(KEY, None)
    file.data = with_present_names(file, file.data, (), FORMER_KEYS_OF_LIBRARIES)
    faults = []
    for kind, values_by_name in file.data.items():
        if kind not in KINDS_OF_ENTRIES:
            faults.append(Fault((kind,), f"unknown key; allowed: {', '.join(KINDS_OF_ENTRIES)}"))
        elif not isinstance(values_by_name, dict):
            faults.append(
                Fault((kind,), f"{show(values_by_name)} is not a mapping of names to entries")
            )
        else:
            for name, entry_values in values_by_name.items():
                if not (
                    isinstance(entry_values, dict) and isinstance(entry_values.get(SOURCE), str)
                ):
                    message = (
                        f"expected a mapping with '{SOURCE}', a text with the origin of its values"
                    )
                    faults.append(Fault((kind, name), message))
    file.raise_all(faults)
    return file


def listed(kind: str) -> str:
    """List the shipped names of a kind with their descriptions, as text."""
    entries = read().data[kind]
    width = max(map(len, entries), default=0)
    lines = [f"  {name:<{width}}  {entry.get(ABOUT, '')}" for name, entry in entries.items()]
    return "\n".join([f"{kind}: {KINDS_OF_ENTRIES[kind]}", *lines])


def entries_as_text() -> dict[str, str]:
    """Text of each shipped entry with its source, as in the library, by name."""
    entries = re.finditer(ENTRY, SHIPPED.read_text(encoding="utf-8"), re.MULTILINE)
    return {entry[1]: textwrap.dedent(entry[0]).strip() for entry in entries}
