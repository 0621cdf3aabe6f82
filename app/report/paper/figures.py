"""The curves of a report: the paper's figures 3 to 8, and numbers over whatever else varies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mantle.report.paper.cases import (
    QUANTITIES,
    STEMS,
    WORDS,
    Cases,
    contact,
    series,
)
from mantle.report.paper.compare import READINGS, named, published
from mantle.report.paper.heat import bone_p99, bone_peak, cement_peak
from mantle.report.sweep_results import Number, SweptCase, magnitude
from mantle.schema import quantities
from mantle.system import style
from mantle.system.style import COLOURS, MARKERS

STEM_COLOURS = dict(zip(STEMS.values(), COLOURS, strict=False))
PLACES = ("cement_bone", "stem_cement")
# Largest over smallest value from which an axis is logarithmic.
DECADE = 12.0
ROUNDED = {"µm": 1e-6, "MPa": 1e-8}  # below which a contact quantity is zero
MOST_PANELS = 12
MOST_SERIES = 8

HOT = (
    "The paper's “100 degrees” read as the cement's initial temperature (cement: after 10 s, "
    "for at the start it is 100 °C; the paper names no time) and as held. Bone, filled: the "
    "99th percentile over the area, after 10 s or at the end of cement that is held; hollow: "
    "the largest value at any time, which sits where bone is thinnest. Stars: the paper."
)
NOTE = (
    "Filled, with bars: mantle's 99th percentile and its estimated error. Light, hollow: mantle's "
    "largest value, which depends on the mesh. Stars: the paper."
)


@dataclass(frozen=True)
class Figure:
    """A picture of the report.

    Attributes:
        name: Of the file.
        title: A line above it.
        caption: What is to be said of it.
        text: What is drawn, in words, for who cannot see it.
    """

    name: str
    title: str
    caption: str
    text: str


@dataclass(frozen=True)
class Line:
    """A curve.

    Attributes:
        label: Its name in the legend.
        colour: Its colour.
        marker: Its marker.
        numbers: With errors, over x.
        peaks: The largest values over x, which have none.
        stars: What is published: x and value.
    """

    label: str
    colour: str
    marker: str
    numbers: dict[float, Number]
    peaks: dict[float, Number]
    stars: Sequence[tuple[float, float]] = ()


@dataclass(frozen=True)
class Panel:
    """Axes with curves."""

    title: str
    y: str
    lines: Sequence[Line]


def paper(cases: Cases, folder: Path) -> tuple[list[Figure], list[str]]:
    """Draw the paper's figures, as far as there are cases for them.

    Returns:
        The figures, and what could not be drawn.
    """
    figures, missing = [], []
    for number, title, panels, x, lacking in _planned(cases):
        if _few(panels):
            missing.append(f"figure {number}: {lacking}")
            continue
        name = f"figure{number}.png"
        draw(folder / name, panels, x, 2)
        note = HOT if number == 8 else NOTE
        figures.append(Figure(name, f"Figure {number}. {title}", note, _words(panels)))
    return figures, missing


def _planned(cases: Cases) -> Iterator[tuple[int, str, list[Panel], str, str]]:
    """Number, title, panels and horizontal axis of each figure, and why there may be none."""
    thickness = "thickness of the mantle (mm)"
    for number, quantity, title in (
        (3, "gap", "Largest debonding over the thickness of the mantle"),
        (4, "shear", "Largest interfacial shear stress over the thickness of the mantle"),
        (5, "slip", "Largest sliding over the thickness of the mantle"),
    ):
        panels = [_over_thickness(cases, place, quantity) for place in PLACES]
        yield number, title, panels, thickness, "no stem at two thicknesses"
    friction = "friction coefficient of the cement-bone interface"
    for number, compared, title in (
        (6, ("gap", "slip"), "Debonding and sliding over the cement-bone friction, mantle of 4 mm"),
        (7, ("pressure", "shear"), "Pressure and shear over the cement-bone friction"),
    ):
        panels = [_over_friction(cases, p, q) for q in compared for p in PLACES]
        yield number, title, panels, friction, "no stem at two frictions"
    title, lacking = (
        "Highest temperatures over the thickness of the mantle",
        "no case of hot cement",
    )
    yield 8, title, _temperatures(cases), thickness, f"{lacking} at two thicknesses"


def _few(panels: Sequence[Panel]) -> bool:
    """Whether nothing has two points."""
    return all(max(len(x.numbers), len(x.peaks)) < 2 for p in panels for x in p.lines)


def _panel(
    place: str,
    quantity: str,
    families: dict[str, dict[float, SweptCase]],
    stars: Callable[[str], list[tuple[float, float]]],
) -> Panel:
    lines = [
        Line(
            stem,
            STEM_COLOURS[stem],
            MARKERS[k],
            series(family, contact(place, quantity, "p99")),
            series(family, contact(place, quantity, "max")),
            stars(stem),
        )
        for k, (stem, family) in enumerate(families.items())
    ]
    return Panel(WORDS[place], f"{WORDS[quantity]} ({QUANTITIES[quantity][0]})", lines)


def _over_thickness(cases: Cases, place: str, quantity: str) -> Panel:
    families = {stem: cases.stances(stem) for stem in STEMS.values()}
    return _panel(
        place, quantity, families, lambda s: [(t, v) for t, _, v in published(s, place, quantity)]
    )


def _over_friction(cases: Cases, place: str, quantity: str) -> Panel:
    families = {stem: cases.frictions(stem) for stem in STEMS.values()}
    return _panel(
        place,
        quantity,
        families,
        lambda s: [(mu, v) for t, mu, v in published(s, place, quantity) if t == 4.0],
    )


def _temperatures(cases: Cases) -> list[Panel]:
    panels = []
    for place, title in (
        ("cement", "cement"),
        ("cement_bone", "bone at the cement-bone interface"),
    ):
        lines = []
        stars = [(t, v) for t, _, v in published("CoCr", place, "temperature")]
        for k, ((model, reading), family) in enumerate(cases.heats().items()):

            def of(case: SweptCase, reading: str = reading, place: str = place) -> Number | None:
                return cement_peak(case, reading) if place == "cement" else bone_p99(case, reading)

            label = f"{model}, {READINGS[reading]}, {cases.conductance(model)}"
            peaks = {} if place == "cement" else series(family, bone_peak)
            lines.append(Line(label, COLOURS[k], MARKERS[k], series(family, of), peaks, stars))
            stars = []
        panels.append(Panel(title, "temperature (°C)", lines))
    return panels


def _words(panels: Sequence[Panel]) -> str:
    """The values of a figure."""
    texts = []
    for p in panels:
        for line in p.lines:
            values = line.numbers or line.peaks
            if values:
                each = "; ".join(f"{x:g}: {n}" for x, n in values.items())
                texts.append(f"{p.title}, {p.y}, {line.label}: {each}")
    return ". ".join(texts)


def draw(path: Path, panels: Sequence[Panel], x: str, columns: int) -> None:
    """Draw panels with a common legend.

    Args:
        path: The PNG to write.
        panels: What is drawn.
        x: Label of the horizontal axes.
        columns: Panels beside each other at most.
    """
    columns = min(columns, len(panels))
    figure, every = style.panels(len(panels), columns, 4.7, 3.2)
    for axes, panel in zip(every, panels, strict=True):
        _draw(axes, panel)
        axes.set_xlabel(x)
    handles = style.handles(every)
    # A legend is filled column by column: curves, then peaks, then what is published.
    kinds = zip(*(_labels(line) for p in panels for line in p.lines), strict=True)
    kinds_shown = [[n for n in dict.fromkeys(kind) if n in handles] for kind in kinds]
    shown = [label for kind in kinds_shown for label in kind]
    same = len({len(kind) for kind in kinds_shown}) == 1
    room = 95 * columns // 2 // (max(map(len, shown), default=1) + 8)  # labels in a row
    if len(shown) > 1:
        figure.legend(
            [handles[label] for label in shown],
            shown,
            loc="outside lower center",
            ncols=len(kinds_shown) if same else max(1, min(len(shown), room)),
            frameon=False,
            fontsize=9,
        )
    figure.savefig(path, dpi=120)


def _draw(axes: Any, panel: Panel) -> None:
    axes.set_title(panel.title, fontsize=11, loc="left")
    axes.set_ylabel(panel.y)
    axes.grid(True, which="major", color="0.9")
    axes.set_axisbelow(True)
    xs = sorted({x for line in panel.lines for x in (*line.numbers, *line.peaks)})
    apart = 0.012 * (xs[-1] - xs[0]) if len(xs) > 1 else 0.0
    for k, line in enumerate(panel.lines):
        # Side by side, so that bars of equal numbers can both be seen.
        shift = apart * (k - 0.5 * (len(panel.lines) - 1))
        _line(axes, line, shift)
    values = [v for line in panel.lines for v in _values(line)]
    if values and panel.y in ROUNDED and max(map(abs, values)) < ROUNDED[panel.y]:
        axes.set_ylim(-0.05, 1)
        axes.text(0.5, 0.5, "zero to rounding", transform=axes.transAxes, ha="center", color="0.4")
    elif values and min(values) > 0 and max(values) > DECADE * min(values):
        from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

        axes.set_yscale("log")
        axes.set_ylabel(f"{panel.y}, log. scale")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    elif values and min(values) >= 0 and max(values) > 2 * min(values):
        axes.set_ylim(bottom=0)
    if not xs:
        axes.text(0.5, 0.5, "no results", transform=axes.transAxes, ha="center", color="0.4")
    elif len(xs) < 9:
        axes.set_xticks(xs, [f"{x:g}" for x in xs])


def _labels(line: Line) -> tuple[str, str, str]:
    """Of the curve, its peaks and what is published, in the legend."""
    own = line.label in STEM_COLOURS
    paper = f"{line.label}, paper" if own else "paper"
    curve = f"{line.label}, p99" if own and line.peaks else line.label
    return curve, f"{line.label}, max", paper


def _values(line: Line) -> list[float]:
    numbers = [n.value for n in (*line.numbers.values(), *line.peaks.values())]
    return numbers + [v for _, v in line.stars]


def _line(axes: Any, line: Line, shift: float) -> None:
    """A curve with bars, its peaks, and what is published."""
    label, peak_label, star_label = _labels(line)
    if line.peaks:
        axes.plot(
            [x + shift for x in line.peaks],
            [n.value for n in line.peaks.values()],
            color=line.colour,
            alpha=0.45,
            marker=line.marker,
            mfc="white",
            ms=4.5,
            lw=1,
            ls=(0, (3, 2)),
            label=peak_label,
            zorder=2,
        )
    if line.numbers:
        axes.errorbar(
            [x + shift for x in line.numbers],
            [n.value for n in line.numbers.values()],
            yerr=[n.error or 0.0 for n in line.numbers.values()],
            color=line.colour,
            marker=line.marker,
            ms=5.5,
            lw=1.6,
            capsize=3,
            label=label,
            zorder=3,
        )
    if line.stars:
        axes.plot(
            [x + shift for x, _ in line.stars],
            [v for _, v in line.stars],
            "*",
            color=line.colour if line.label in STEM_COLOURS else "#f2c14e",
            mec="0.15",
            mew=0.7,
            ms=12,
            ls="",
            label=star_label,
            zorder=4,
        )


# Sweeps of anything


def headlines(cases: Sequence[SweptCase]) -> list[str]:
    """Names of the numbers to show of cases, those that matter most first."""
    found: dict[str, None] = {}
    for case in cases:
        for name in case.summary.get("interfaces", {}):
            found |= {f"{name}.{q}_p99": None for q in QUANTITIES}
    for case in cases:
        # What burns is the bone; cement may be as hot as it starts.
        regions = case.summary.get("thermal", {}).get("regions", {})
        order = sorted(regions, key=lambda name: name not in case.bones)
        found |= {f"{name}.temperature_max": None for name in order}
    for case in cases:
        found |= dict.fromkeys(case.numbers)
    return [name for name in found if any(c.number(name) is not None for c in cases)]


def label(name: str) -> tuple[str, str]:
    """A number's name for people, and its unit."""
    place, _, key = name.partition(".")
    if (q := quantities.get(name)) is None:
        return f"{named(place)} {key}".replace("_", " "), ""
    return f"{named(place)} {key.replace(q.key, q.label)}", quantities.printed(q.shown)


def multiples(cases: Sequence[SweptCase], folder: Path) -> list[Figure]:
    """Draw each headline number over each numeric key that varies.

    Args:
        cases: Those that have something in common.
        folder: Where the pictures go.
    """
    done = [c for c in cases if c.done]
    keys = dict.fromkeys(key for c in done for key in c.overrides)
    figures = []
    for key in keys:
        groups = _groups(done, key)
        if not groups:
            continue
        panels = []
        for name in headlines([c for _, own in groups for c in own.values()]):
            text, unit = label(name)
            lines = []
            for k, (common, own) in enumerate(groups[:MOST_SERIES]):
                values = {x: n for x, c in own.items() if (n := c.number(name))}
                lines.append(Line(common or "mantle", COLOURS[k], MARKERS[k], values, {}))
            if any(map(_varies, lines)):
                panels.append(Panel(text, unit or "value", lines))
        panels = panels[:MOST_PANELS]
        if _few(panels):
            continue
        file = f"over_{''.join(c if c.isalnum() else '_' for c in key)}.png"
        draw(folder / file, panels, f"{key} ({unit_of(done, key)})".replace(" ()", ""), 3)
        left = len(groups) - MOST_SERIES
        more = f" {left} further curves are left out." if left > 0 else ""
        caption = f"Bars: estimated errors, where they are known.{more}"
        figures.append(Figure(file, f"Numbers over {key}", caption, _words(panels)))
    return figures


def _varies(line: Line) -> bool:
    """Whether a curve is more than rounding."""
    values = [n.value for n in line.numbers.values()]
    return max(values, default=0.0) - min(values, default=0.0) > max(ROUNDED.values())


def unit_of(cases: Sequence[SweptCase], key: str) -> str:
    """The unit of a key's values, as written."""
    texts = [str(c.overrides[key]).split(maxsplit=1) for c in cases if key in c.overrides]
    units = {t[1] for t in texts if len(t) > 1}
    return units.pop() if len(units) == 1 else ""


def _groups(cases: Sequence[SweptCase], key: str) -> list[tuple[str, dict[float, SweptCase]]]:
    """Cases that differ in a numeric key alone, with what they have in common in words."""
    found: dict[str, dict[float, SweptCase]] = {}
    for c in cases:
        x = magnitude(c.overrides.get(key))
        if x is not None:
            rest = {k: v for k, v in c.overrides.items() if k != key}
            common = ", ".join(f"{k.split('.')[-1]} {v}" for k, v in rest.items())
            found.setdefault(": ".join(filter(None, (c.part, common))), {})[x] = c
    return [(t, dict(sorted(own.items()))) for t, own in found.items() if len(own) > 1]
