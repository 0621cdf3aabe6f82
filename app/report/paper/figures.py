"""The paper's figures 3 to 8, drawn anew from a sweep."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from app.report.curves import STEM_COLOURS, Figure, Line, Panel, draw, in_words, too_few
from app.report.paper.cases import (
    QUANTITIES,
    STEMS,
    WORDS,
    Cases,
    contact,
    series,
)
from app.report.paper.compare import READINGS, published
from app.report.paper.heat import bone_p99, bone_peak, cement_peak
from app.report.sweep_results import Number, SweptCase
from app.system.style import COLOURS, MARKERS

PLACES = ("cement_bone", "stem_cement")

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


def paper(cases: Cases, folder: Path) -> tuple[list[Figure], list[str]]:
    """Draw the paper's figures, as far as there are cases for them.

    Returns:
        The figures, and what could not be drawn.
    """
    figures, missing = [], []
    for number, title, panels, x, lacking in _planned(cases):
        if too_few(panels):
            missing.append(f"figure {number}: {lacking}")
            continue
        name = f"figure{number}.png"
        draw(folder / name, panels, x, 2)
        note = HOT if number == 8 else NOTE
        figures.append(Figure(name, f"Figure {number}. {title}", note, in_words(panels)))
    return figures, missing


def _planned(cases: Cases) -> Iterator[tuple[int, str, list[Panel], str, str]]:
    """Number, title, panels and horizontal axis of each figure, and why there may be none."""
    thickness = "thickness of the mantle (mm)"
    over_thickness: list[tuple[int, tuple[str, ...], str]] = [
        (3, ("gap",), "Largest debonding over the thickness of the mantle"),
        (4, ("shear",), "Largest interfacial shear stress over the thickness of the mantle"),
        (5, ("slip", "motion"), "Largest sliding and motion over the thickness of the mantle"),
    ]
    for number, compared, title in over_thickness:
        panels = [_over_thickness(cases, p, q) for q in compared for p in PLACES]
        yield number, title, panels, thickness, "no stem at two thicknesses"
    friction = "friction coefficient of the cement-bone interface"
    over_friction: list[tuple[int, tuple[str, ...], str]] = [
        (6, ("gap", "slip", "motion"), "Debonding, sliding, motion over the cement-bone friction"),
        (7, ("pressure", "shear"), "Pressure and shear over the cement-bone friction"),
    ]
    for number, compared, title in over_friction:
        panels = [_over_friction(cases, p, q) for q in compared for p in PLACES]
        yield number, title, panels, friction, "no stem at two frictions"
    title, lacking = (
        "Highest temperatures over the thickness of the mantle",
        "no case of hot cement",
    )
    yield 8, title, _temperatures(cases), thickness, f"{lacking} at two thicknesses"


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
            series(family, contact(place, quantity, "percentile")),
            series(family, contact(place, quantity, "max")),
            stars(stem),
        )
        for k, (stem, family) in enumerate(families.items())
    ]
    return Panel(WORDS[place], f"{WORDS[quantity]} ({QUANTITIES[quantity][0]})", lines)


def _stars(stem: str, place: str, quantity: str) -> list[tuple[float, float, float]]:
    """What the paper gives; its slip may be sliding or all motion."""
    return published(stem, place, "slip" if quantity == "motion" else quantity)


def _over_thickness(cases: Cases, place: str, quantity: str) -> Panel:
    families = {stem: cases.stances(stem) for stem in STEMS.values()}
    return _panel(
        place, quantity, families, lambda s: [(t, v) for t, _, v in _stars(s, place, quantity)]
    )


def _over_friction(cases: Cases, place: str, quantity: str) -> Panel:
    families = {stem: cases.frictions(stem) for stem in STEMS.values()}
    return _panel(
        place,
        quantity,
        families,
        lambda s: [(mu, v) for t, mu, v in _stars(s, place, quantity) if t == 4.0],
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
