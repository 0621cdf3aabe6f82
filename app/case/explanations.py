"""Texts of ``mantle explain``: keys, kinds, entries of the library and results by any word.

A word is the path of a key, one of the values that a key allows, the name of a kind, or a name of
the library. It may also be a part of the name of a result, or a term of the field
(`TARGETS_OF_TERMS`, the glossary of the manual).
"""

from __future__ import annotations

import difflib
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import NamedTuple

import configs
from app.case import library, quantities
from app.case.case import Case
from app.case.keys import Key, KeySection, all_keys, key_sections, matches
from app.foundation.errors import InputError

WIDTH = 96
# Heading of the options of commands.
OPTIONS = "options of commands"
# End of the line of a result.
RESULT = ", a result"
# Headings of the units.
RESULT_UNITS = "Results, in summary.json and history.csv:"
KEY_UNITS = "Keys of a case. Write any unit, such as 4 mm or 110 GPa; mantle converts it to:"
# Most lines that list keys by a word in their meaning.
MOST_LINES = 12
# Letters from which a word also finds longer ones that begin with it.
SHORT_WORD = 4
# Words of a phrase that are not looked for.
WITHOUT_MEANING = {"a", "an", "and", "at", "by", "for", "in", "of", "on", "or", "the", "to", "with"}
GLOSSARY = configs.FOLDER.parent / "docs" / "glossary.md"
LOADS = "loads"
# Terms of the field: the keys, kinds, results and options that they stand for, the first one first.
TARGETS_OF_TERMS: dict[str, tuple[str, ...]] = {
    # Materials
    "e": ("regions.youngs_modulus",),
    "youngs_modulus": ("regions.youngs_modulus", "regions.axial_youngs_modulus"),
    "nu": ("regions.poisson_ratio",),
    "poissons_ratio": ("regions.poisson_ratio",),
    "density": ("regions.thermal.density", "loads.density", "heat.density"),
    "thermal_expansion": ("regions.thermal.thermal_expansion",),
    "cte": ("regions.thermal.thermal_expansion",),
    "rigid_body": ("regions: rigid",),
    # Interfaces
    "mu": ("interfaces.friction_coefficient",),
    "friction": ("interfaces.friction_coefficient", "interfaces.friction_heating"),
    "coulomb": ("interfaces.friction_coefficient",),
    "sliding": ("interfaces.sliding", "interfaces.slip_p99", "interfaces.slip_path_p99"),
    "finite_sliding": ("interfaces.sliding",),
    "contact": ("interfaces: contact",),
    "contact_law": ("interfaces: contact", "interfaces: cohesive", "interfaces: penalty"),
    "mortar": ("interfaces.quadrature",),
    "tie": ("interfaces: bonded",),
    "tied": ("interfaces: bonded",),
    "debonding": ("interfaces: cohesive", "interfaces.gap_p99", "interfaces.area_broken"),
    "cohesive_zone": ("interfaces: cohesive",),
    "czm": ("interfaces: cohesive",),
    "press_fit": ("interfaces.interference", "interfaces.gap"),
    "cementless": ("geometry.cement_thickness", "interfaces.interference"),
    "coating": ("interfaces.zones",),
    "compliance": ("interfaces.elastic_layer",),
    # Supports and loads
    "encastre": ("supports: fixed",),
    "clamp": ("supports: fixed",),
    "clamped": ("supports: fixed",),
    "boundary_condition": ("supports: fixed", "supports: roller", "supports: displacement"),
    "symmetry": ("supports: roller",),
    "prescribed_displacement": ("supports: displacement",),
    "spring": ("supports: foundation",),
    "body_weight": (LOADS,),
    "loads.body_weight": (LOADS,),
    "loads.library": (LOADS,),
    "loads.sagittal_tilt": (LOADS,),
    "sagittal_tilt": (LOADS,),
    "weight": ("loads: body_force",),
    "gravity": ("loads: body_force",),
    "load_history": ("loads.history", "stages"),
    "amplitude": ("loads.history",),
    "pressure": ("loads: pressure", "interfaces.pressure_p95"),
    "contact_pressure": ("interfaces.pressure_p95",),
    "course": ("loads.cycle_table", "motions.rotation.cycle_table", "heat.time_course"),
    # Mesh, steps, solver
    "mesh_size": ("mesh.size", "mesh.far_size"),
    "element_size": ("mesh.size", "mesh.far_size"),
    "element_order": ("mesh.order",),
    "time_step": ("time.first_step", "time.tolerance", "time.mechanical_step", "stages.increments"),
    "load_step": ("stages.increments", "stages.adaptive", "stages.max_cut_backs"),
    "increment": ("stages.increments",),
    "cut_back": ("stages.max_cut_backs",),
    "tolerance": ("solver.tolerance", "time.tolerance", "stages.creep_tolerance"),
    "convergence": ("solver.tolerance", "solver.max_iterations"),
    # Output
    "probe": ("output.probes",),
    "path": ("output.paths",),
    "figure": ("output.report", "--gif"),
    "picture": ("output.report", "--gif"),
    "svg": ("output.report",),
    "pdf": ("output.report",),
    "restart": ("--restart", "output.checkpoint"),
    "checkpoint": ("output.checkpoint", "--restart"),
    "micromotion": ("interfaces.motion_p99", "interfaces.area_motion_over_30um"),
    "temperature": (
        "heat: temperature",
        "thermal.regions.temperature_max",
        "regions.thermal.initial_temperature",
    ),
    "gruen": ("gruen.strain_energy_density", "gruen.volume", "gruen.interfaces"),
}
# Results by Gruen zone, which are in no table of `case.quantities`.
BY_ZONE = {
    "gruen.strain_energy_density": "strain energy density of the bone (MPa)",
    "gruen.volume": "volume of the bone (mm^3)",
    "gruen.interfaces": "gap, slip, motion, pressure and shear",
}


def explained(key: str = "", options: Mapping[str, str] | None = None) -> str:
    """Explain a word: keys with meaning, value, unit, default and example; results; options.

    A phrase is looked for as a whole, then all of its words, then each word, the last one first.

    Args:
        key: A key as after ``--set``, without names or its last word alone; a value that keys
            allow, such as ``broach``; a kind; a name of the library, ``materials`` or ``loads`` for
            all of them; a term of the field. Without it, the sections of a case are listed.
        options: Options of commands with their meanings.

    Raises:
        InputError: Nothing has to do with the word.
    """
    query = key.strip().strip(".").replace(" ", "_")
    if query in ("unit", "units"):
        return _units()
    if not query:
        return "\n".join(
            [
                *map(_line, key_sections()[0].keys),
                "",
                *map(library.listed, library.KINDS_OF_ENTRIES),
            ]
        )
    typed_words = [word for word in key.split() if word.lower() not in WITHOUT_MEANING]
    explanations = _answers(query, options or {}) or _answers_to_all(typed_words)
    for word in reversed(typed_words):
        explanations = explanations or _answers(word, options or {})
    if explanations:
        return "\n\n".join(explanations)
    nearest = ", ".join(_nearest(query, library.entries_as_text())) or ", ".join(Case.model_fields)
    raise InputError(f"{key}: is not a key, kind, result or term of mantle; nearest: {nearest}")


def _answers(query: str, options: Mapping[str, str]) -> list[str]:
    """Return explanations of keys, kinds or an entry of the library, then lines, then options.

    Args:
        query: A key, a kind or a name as typed, with underscores for spaces.
        options: Options of commands with their meanings.
    """
    word = re.sub("[ -]", "_", query.lower().replace("'", ""))
    targets = TARGETS_OF_TERMS.get(word, (query,))
    blocks = [block for target in targets for block in (*_keys(target), *_kind(target))]
    library_lists = [
        library.listed(t).replace("`", "") for t in targets if t in library.KINDS_OF_ENTRIES
    ]
    blocks += library_lists
    library_entry = library.entries_as_text().get(query)
    if library_entry and not blocks:
        blocks.append(library_entry)
    lines = [_results()[target] for target in targets if target in _results()]
    option_lines = list(_options_named([*targets, f"--{word.replace('_', '-')}"], options))
    if not blocks and not lines and not option_lines:
        lines += [_line(k) for k in all_keys() if word in k.name.lower()]
    if not library_lists:
        lines += _lines_with(word)
    if not blocks:
        blocks += _keys_with_choice(query)
    if not blocks and not lines and not option_lines:
        lines += list(_lines_on([word.replace("_", " ")]))[:MOST_LINES]
    explanations = list(dict.fromkeys(blocks))
    if lines:
        explanations.append("\n".join(dict.fromkeys(lines)))
    if option_lines:
        explanations.append("\n".join([OPTIONS, *dict.fromkeys(option_lines)]))
    return explanations


def _answers_to_all(typed_words: Sequence[str]) -> list[str]:
    """Return lines on terms, results, kinds and keys that have two or more words in them."""
    if len(typed_words) < 2:
        return []
    patterns = [_pattern(word) for word in typed_words]

    def has_all(text: str) -> bool:
        return all(pattern.search(text.replace("_", " ")) for pattern in patterns)

    # Terms that have the words in their names are first.
    terms = sorted(_terms(), key=lambda term: not has_all(f"{term.name} {term.other_names}"))
    lines = [_line_of(term) for term in terms if has_all(" ".join(term))]
    lines += filter(has_all, _results().values())
    lines += _lines_on([word.lower() for word in typed_words])
    return ["\n".join(dict.fromkeys(lines[:MOST_LINES]))] if lines else []


def _nearest(query: str, names: Iterable[str]) -> list[str]:
    """Keys, names and terms that are spelled like a word, the nearest first."""
    known_names = [
        *names,
        *TARGETS_OF_TERMS,
        *(re.sub(r"\.<name>|\[\]", "", k.path) for k in all_keys()),
    ]
    name_of_word = {
        w: name for name in reversed(known_names) for w in (name, name.rpartition(".")[2])
    }
    close_names = [
        name_of_word[match]
        for word in (query, query.rpartition(".")[2])
        for match in difflib.get_close_matches(word, name_of_word, 3)
    ]
    return list(dict.fromkeys(close_names))


def _units() -> str:
    """Return the units of the results and the internal units of the keys, with their names."""
    results: dict[str, list[str]] = {}
    for numbers in quantities.TABLE.values():
        for quantity in numbers.values():
            results.setdefault(quantity.unit, []).append(quantity.key)
    keys: dict[str, list[str]] = {}
    for key in all_keys():
        if key.unit:
            keys.setdefault(key.unit, []).append(key.name)
    tables = []
    for heading, names_of_units in ((RESULT_UNITS, results), (KEY_UNITS, keys)):
        lines = [heading]
        for unit, key_names in sorted(names_of_units.items()):
            name_list = textwrap.shorten(", ".join(dict.fromkeys(key_names)), WIDTH - 20)
            lines.append(f"  {unit:<14} {name_list}")
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


# ------------------------------------------------------------------------------------ blocks


def _keys(query: str) -> Iterator[str]:
    """Explain the key at a path, or all keys whose paths end with a word or with words."""
    keys = [k for k in all_keys() if matches(k, query)]
    keys = keys or [k for k in all_keys() if f".{k.path}".endswith(f".{query}")]
    heads: dict[str, list[str]] = {}
    for key in keys:
        with_kind = key.kind and key.name != "kind"
        heading = f"{key.path}  (kind {key.kind})" if with_kind else key.path
        heads.setdefault(_kinds(key.path) if key.name == "kind" else _body(key), []).append(heading)
    for body, paths in heads.items():
        yield "\n".join([*dict.fromkeys(paths), body])


def _keys_with_choice(word: str) -> list[str]:
    """Explain all keys of which a word is one of the values that they allow, such as ``broach``."""
    if word in ("true", "false"):
        return []
    paths = [
        key.path
        for key in all_keys()
        if key.name != "kind" and f"`{word}`" in key.value.partition("e.g.")[0]
    ]
    return [block for path in dict.fromkeys(paths) for block in _keys(path)]


def _kind(query: str) -> Iterator[str]:
    """Explain a kind (``fixed``) in all sections, or in the section named before it."""
    section_path, _, name = query.rpartition(": ")
    for section in key_sections():
        if section.kind == name and (not section_path or section.path.startswith(section_path)):
            keys = [key.name for key in section.keys if key.name != "kind"]
            rows = {
                "": section.meaning.partition("\n")[0],
                "keys": ", ".join(keys),
                "example": _example_of(section),
            }
            yield f"{section.path}  of kind {name}\n{_table(rows)}"


def _kinds(path: str) -> str:
    """The kinds of a section, each as an example with its required keys."""
    lines = []
    for section in (s for s in key_sections() if f"{s.path}.kind" == path and s.kind):
        summary = re.split(r"[.] |\n", section.meaning.replace("`", ""))[0]
        for text in (_example_of(section), f"  {summary}"):
            lines.append(textwrap.indent(textwrap.fill(text, WIDTH, subsequent_indent="  "), "  "))
    return "\n".join(lines)


def _example_of(section: KeySection) -> str:
    """A section of a kind with its required keys."""
    required = [k for k in section.keys if not k.default and k.name not in ("kind", "rigid")]
    keys = [f"kind: {section.kind}", *(_example(k) or f"{k.name}: ..." for k in required)]
    return f"{{{', '.join(keys)}}}"


def _example(key: Key) -> str:
    """A key with a value that it may have; empty if none is known."""
    key_text = f"{key.value} such as {key.default} such as {key.value} {key.meaning}"
    example = re.search(r"(?:e\.g\.|such as) `([^`]*)`", key_text)
    value = "0.3" if key.value.startswith("number") else ""
    if example:
        value = example[1]
    return f"{key.name}: {value}" if value else ""


def _body(key: Key) -> str:
    """Text of an explanation below its heading."""
    rows = {
        "": key.meaning,
        "value": key.value,
        "unit": key.unit,
        "default": key.default or "none: it is required",
        "keys": "; ".join(f"{k}: {', '.join(n)}".removeprefix(": ") for k, n in key.inner),
        "example": _example(key),
    }
    return _table(rows)


def _table(rows: Mapping[str, str]) -> str:
    """Titles and texts in two columns, without Markdown; empty texts are left out."""
    lines = []
    for name, text in rows.items():
        plain_text = re.sub(r"\[([^\]]*)\]\(#[^)]*\)", r"\1", text).replace("`", "")
        first_indent = f"  {name:<9}" if name else "  "
        further_indent = " " * len(first_indent)
        lines += textwrap.wrap(
            plain_text,
            WIDTH,
            initial_indent=first_indent,
            subsequent_indent=further_indent,
            break_on_hyphens=False,
        )
    return "\n".join(lines)


# ------------------------------------------------------------------------------------- lines


def _line(key: Key) -> str:
    """A key and its meaning in one line."""
    meaning = key.meaning.replace("`", "").partition("\n")[0]
    return f"  {key.path:<44} {textwrap.shorten(meaning, WIDTH - 20, placeholder=' ...')}"


@cache
def _results() -> dict[str, str]:
    """Lines of all results by section and key."""
    lines = {
        f"{section}.{q.key}": f"{q.label} ({q.unit})"
        for section, numbers in quantities.TABLE.items()
        for q in numbers.values()
    }
    return {name: f"  {name:<44} {text}{RESULT}" for name, text in (lines | BY_ZONE).items()}


def _lines_on(words: Sequence[str]) -> Iterator[str]:
    """Kinds and keys with all words in their meaning."""
    for section in key_sections():
        if section.kind and all(word in section.meaning.lower() for word in words):
            heading = f"{section.path}: {section.kind}"
            meaning = textwrap.shorten(section.meaning.replace("`", ""), WIDTH - 20)
            yield f"  {heading:<44} {meaning}"
        for key in section.keys:
            if all(word in key.meaning.lower() for word in words):
                yield _line(key)


def _options_named(names: Sequence[str], options: Mapping[str, str]) -> Iterator[str]:
    """Lines of the options of a command (``mesh``), or of options by their name (``--restart``)."""
    for option, meaning in options.items():
        if any(name in option.split() for name in names):
            option_line = f"  {option:<44} {meaning}"
            yield textwrap.fill(
                option_line, WIDTH, subsequent_indent=" " * 47, break_on_hyphens=False
            )


def _pattern(word: str) -> re.Pattern[str]:
    """Pattern of a word; short words stand alone, longer ones may be the beginning of a word."""
    end = r"(?![a-z0-9])" if len(word) < SHORT_WORD else ""
    text = re.escape(word.replace("_", " "))
    return re.compile(rf"(?<![a-z0-9]){text}{end}", re.IGNORECASE)


def _lines_with(word: str) -> Iterator[str]:
    """Entries of the library, results and terms of the glossary with a word in them."""
    pattern = _pattern(word)

    def has_word(line: str) -> bool:
        return len(word) > 1 and pattern.search(line.replace("_", " ")) is not None

    for kind in library.KINDS_OF_ENTRIES:
        yield from filter(has_word, library.listed(kind).splitlines()[1:])
    for name, line in _results().items():
        section, _, key = name.rpartition(".")
        label = line.removesuffix(RESULT).removeprefix(f"  {name} ")
        if has_word(key) or has_word(label) or (has_word(section) and name in BY_ZONE):
            yield line
    for term in _terms():
        if has_word(term.name) or has_word(term.other_names):
            yield _line_of(term)


class Term(NamedTuple):
    """A row of the glossary: term, meaning, other names."""

    name: str
    meaning: str
    other_names: str


@cache
def _terms() -> tuple[Term, ...]:
    """Rows of the glossary; none if the manual is not installed."""
    glossary = GLOSSARY.read_text(encoding="utf-8") if GLOSSARY.exists() else ""
    # Term, symbol and unit, meaning, place in the code, other names.
    row = r"^\| ([^|]+) \|[^|]*\| ([^|]+) \|[^|]*\|([^|]*)\|$"
    return tuple(Term(*cells) for cells in re.findall(row, glossary, re.MULTILINE))


def _line_of(term: Term) -> str:
    """A term with its meaning, without Markdown."""
    plain_text = re.sub("[*$`]", "", f"  {term.name}: {term.meaning}")
    return textwrap.fill(plain_text, WIDTH, subsequent_indent="    ")
