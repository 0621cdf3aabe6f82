"""End of the log of a run: closing tables, verdicts and main results.

Messages are written by `logging`, on rank 0 only.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Mapping

from app.case.number_text import NOT_RESOLVED
from app.case.quantities import ADDED, NECROSIS, TABLE
from app.case.summary import Numbers, Summary, name_of_implant
from app.case.summary_numbers import numbers_of
from app.foundation import layout
from app.foundation.verdict import Severity, recorded
from app.results.cycles import sentences
from app.results.verdicts import ERRORS

log = logging.getLogger("mantle")


def log_closing_lines(summary: Summary, table: bool = True) -> None:
    """Log the end of a run: its tables with ``table``, its verdicts, and last its main results."""
    if table:
        log.info("%s", "\n".join(closing_tables(summary)))
    # Notes are logged before the run begins.
    verdicts = [v for v in recorded(summary) if v.severity is not Severity.NOTE]
    sureness = [v for v in verdicts if v.where in ERRORS]
    for verdict in verdicts:
        if verdict not in sureness:
            log.info("%s", verdict, extra={"tone": verdict.tone})
    for sentence in headline(summary):
        log.info("%s", sentence)
    for verdict in sureness:
        log.info("%s", verdict, extra={"tone": verdict.tone})


# Main results


def headline(summary: Summary) -> Iterator[str]:
    """Yield the main results: motions, tension in the cement, temperature of bone."""
    rows: dict[str, dict[str, Numbers]] = {}
    for section, name, numbers in numbers_of(summary):
        rows.setdefault(section, {})[name] = numbers
    interfaces = rows.get("interfaces", {})
    moving = [(name, q) for name, q in interfaces.items() if "motion_p99" in q]
    inserted = [(name, q) for name, q in moving if "micromotion_p99" in q]
    other_rows = [row for row in moving if row not in inserted]
    for key, owners in (("motion_p99", other_rows), ("micromotion_p99", inserted)):
        if owners:
            number_texts = [f"{_with_unit('interfaces', key, q)} ({name})" for name, q in owners]
            is_pressed = all("insertion_pressure_max" in q for _, q in owners)
            since_text = " since the insertion" if is_pressed else ""
            has_edges = any("rim" in q for _, q in owners)
            surface = "surface without rim and tip" if has_edges else "surface"
            yield f"99 % of the {surface} moves{since_text} by less than {', '.join(number_texts)}"
    # Interfaces with finite sliding have no number for motion; pressure is their main result.
    pressed = [row for row in interfaces.items() if row not in moving and "pressure_max" in row[1]]
    if pressed:
        number_texts = [
            f"{_with_unit('interfaces', 'pressure_max', q)} ({name})" for name, q in pressed
        ]
        yield f"the largest contact pressure is {', '.join(number_texts)}"
    name_of_stem = name_of_implant(summary)
    for q in rows.get("stem", {}).values():
        template_name = "pressed_stem" if "insertion_subsidence" in q else "stem"
        yield _sentence("stem", name_of_stem, q, template_name=template_name)
        if "collar_force" in q:
            yield _sentence("stem", name_of_stem, q, template_name=_of_collar(q))
    for name, q in rows.get("regions", {}).items():
        if CEMENT_NUMBER in q:
            tension = _with_unit("regions", "principal_p99", q)
            yield f"99 % of the {name} has a tension below {tension}"
    bones = {n: q for n, q in rows.get("thermal.regions", {}).items() if "cem43_max" in q}
    if bones:
        name = max(bones, key=lambda bone: bones[bone]["temperature_max"])
        hottest = _with_unit("thermal.regions", "temperature_max", bones[name])
        yield f"the bone is hottest in {name}: {hottest}"


def _with_unit(section: str, key: str, numbers: Numbers) -> str:
    """Format a number with error and unit: ``41.3 ± 1.8 um``, ``0.3 ± 0.5 um (not resolved)``."""
    q = TABLE[section][key]
    return q.with_unit(numbers, q.shown)


# Tables

Rows = Mapping[str, Numbers]

# By section of the summary: titles of columns, that of the names first, and their quantities.
TABLES: dict[str, dict[str, str]] = {
    "interfaces": {
        "interface": "",
        "gap max/p99": "gap_max / gap_p99",
        "slip max/p99": "slip_max / slip_p99",
        "motion max/p99": "motion_max / motion_p99",
        "micromotion max/p99": "micromotion_max / micromotion_p99",
        "pressure max/p95": "pressure_max / pressure_p95",
        "shear max/p95": "shear_max / shear_p95",
        "open/stick/slip": "open_fraction / stick_fraction / slip_fraction",
    },
    "regions": {
        "region": "",
        "von Mises p99": "von_mises_p99",
        "tension max/p99": "principal_max / principal_p99",
        "mean stress": "mean_stress_min .. mean_stress_max",
    },
    "thermal.regions": {
        "temperature": "",
        "hottest": "temperature_max",
        "at time": "temperature_max_time",
        "hottest at end": "temperature_end_max",
        "mean at end": "temperature_mean",
        "over 47 degC": "seconds_over_47",
    },
    "thermal.interfaces": {
        "interface": "",
        "hottest, first side": "temperature_max_first",
        "second side": "temperature_max_second",
        "largest jump": "temperature_jump_max",
        "largest flux": "heat_flux_max",
    },
}
FAILING = "failure_load_factor"
# Number that only cement has.
CEMENT_NUMBER = "volume_over_3_MPa"
# Mark of unresolved numbers in tables, where the words would need wide columns.
STAR = "*"
LEGEND = "* not resolved: the error is larger than the number; refine the mesh"
SENTENCES = {
    "bonds": "{name} is bonded: {strength_fraction} of its area is above {limit}; "
    "mean normal traction {normal_mean}, mean shear {shear_mean}",
    "strength": "{name}: 1 % of the area fails at {failure_load_factor} times this load; "
    "failure index {failure_index_p99} (p99), {failure_index_max} (max)",
    "cure": "{name}: degree of cure {degree_min} to {degree_max}{reached}; largest rate {rate_max}",
    "stem": "the {name} moves against the bone: subsidence {subsidence}, "
    "retroversion {retroversion}, varus {varus}",
    "pressed_stem": "since the insertion the {name} moves against the bone: "
    "subsidence {subsidence}, retroversion {retroversion}, varus {varus}; "
    "the insertion itself: subsidence {insertion_subsidence}",
    "collar": "the collar presses on the bone by {collar_force} along the stem",
    "collar_and_flanks": "the collar presses on the bone by {collar_force} along the stem,"
    " {collar_share} of what collar and flanks carry",
    "pulling_flanks": "the collar presses on the bone by {collar_force} along the stem; the flanks"
    " do not carry the stem: they pull it onto the collar ({flank_force})",
}


def closing_tables(summary: Summary) -> Iterator[str]:
    """Yield the closing tables: interfaces, regions, bonds, temperatures, dead bone, cure."""
    table_lines = [*_tables(summary)]
    yield from table_lines
    if any(STAR in table_line for table_line in table_lines):
        yield LEGEND


def _tables(summary: Summary) -> Iterator[str]:
    rows: dict[str, dict[str, Numbers]] = {section: {} for section in TABLE}
    for section, name, numbers in numbers_of(summary):
        rows[section][name] = numbers
    for section in ("interfaces", "regions"):
        yield from _table(section, rows[section])
    for key, q in TABLE["interfaces"].items():
        having = (row for row in rows["interfaces"].items() if q.sentence and key in row[1])
        yield from (_filled(q.sentence, "interfaces", *row) for row in having)
    yield from (_sentence("bonds", *row) for row in rows["bonds"].items())
    strong = (row for row in (rows["interfaces"] | rows["bonds"]).items() if FAILING in row[1])
    yield from (_sentence("bonds", *row, template_name="strength") for row in strong)
    for section in (*ADDED, "thermal.regions", "thermal.interfaces"):
        yield from _table(section, rows[section])
    yield from _necrosis(rows["thermal.regions"])
    note = summary.get("thermal", {}).get("note")
    if note:
        yield note
    yield from (_sentence("cure", *row) for row in rows["cure"].items())
    yield from sentences(summary.get("cycles", {}))


def keys(section: str) -> list[str]:
    """Return the quantities in the table of a section, in its order."""
    return re.findall(r"\w+", " ".join(_columns(section).values()))


def _columns(section: str) -> Mapping[str, str]:
    """Return the columns of the table of a section; empty if it has no table."""
    return ADDED[section].columns if section in ADDED else TABLES.get(section, {})


def _table(section: str, rows: Rows) -> list[str]:
    """Return the lines of a table; quantities of other packages are its last columns."""
    quantities = TABLE[section]
    columns = dict(_columns(section)) | {q.label: key for key, q in quantities.items() if q.compute}
    templates = list(filter(None, columns.values()))

    def has_number(cell_text: str) -> bool:
        return any(map(str.isdigit, cell_text))

    def cell(template: str, numbers: Numbers) -> str:
        cell_text = re.sub(r"\w+", lambda key: quantities[key[0]].text(numbers), template)
        return cell_text.replace(NOT_RESOLVED, STAR)

    cells = [[name, *(cell(t, numbers) for t in templates)] for name, numbers in rows.items()]
    cells = [row for row in cells if any(map(has_number, row[1:]))]
    units = ["", *(quantities[column_template.split()[0]].shown for column_template in templates)]
    names, *others = zip(columns, units, *cells, strict=True)
    columns_with_numbers = [c for c in others if any(map(has_number, c[2:]))]
    titles, units, *cells = map(list, zip(names, *columns_with_numbers, strict=True))
    return layout.text_table(titles, cells, units).splitlines() if cells else []


def necrosis(regions: Rows) -> tuple[list[str], list[list[str]]]:
    """Return regions of bone, and rows of volume [mm3] and depth [mm] of dead bone by criterion."""
    quantities = TABLE["thermal.regions"]
    bones = [name for name, q in regions.items() if "necrosis_47C_1min_volume" in q]
    rows = []
    for rule, rule_text in NECROSIS.items():
        row = [rule_text]
        for name in bones:
            row.append(quantities[f"necrosis_{rule}_volume"].text(regions[name]))
            row.append(quantities[f"necrosis_{rule}_depth"].text(regions[name]))
        rows.append(row)
    return bones, rows


def _necrosis(regions: Rows) -> list[str]:
    bones, rows = necrosis(regions)
    if not bones:
        return []
    head = ["dead bone"]
    units = [""]
    for name in bones:
        head += [f"{name}, volume", f"{name}, depth"]
        units += ["mm^3", "mm"]
    return layout.text_table(head, rows, units).splitlines()


def _of_collar(numbers: Numbers) -> str:
    """Return the sentence of a collar: with flanks that carry, pull, or are bonded."""
    if "collar_share" in numbers:
        return "collar_and_flanks"
    return "pulling_flanks" if numbers.get("flank_force", 0.0) < 0.0 else "collar"


def _sentence(section: str, name: str, numbers: Numbers, template_name: str = "") -> str:
    times_reached = ""
    for percent in (50, 90):
        key = f"time_{percent}"
        if numbers.get(key) is not None:
            times_reached += f", {percent} % everywhere after {_with_unit(section, key, numbers)}"
    template = SENTENCES[template_name or section]
    # A bond without strength is compared with `bond_forces.CEMENT_ON_BONE`.
    limit = "its strength" if FAILING in numbers else "the strength of cement on bone"
    return _filled(template, section, name, numbers, reached=times_reached, limit=limit)


def _filled(template: str, section: str, name: str, numbers: Numbers, **more: str) -> str:
    """Fill in a sentence, in which names of quantities stand for their numbers."""
    scalars = [key for key, q in TABLE[section].items() if not q.vector]
    number_texts = {key: _with_unit(section, key, numbers) for key in scalars}
    return template.format(name=name, **number_texts, **more)
