"""Numbers by Gruen zone, stress shielding, and thickness of the mantle."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from app.case.quantities import TABLE
from app.plots import figures
from app.report import page
from app.report.page import Blocks, Figure
from app.report.sweep_results import INTERFACES, QUANTITIES, WORDS, Number, SweptCase, magnitude

FRONTAL = 7  # so many zones are of the frontal view, the others of the lateral one
BONES = {"cortical_bone": "cortical bone", "cancellous_bone": "cancellous bone"}
KJ = 1e3  # kJ/m3 of a MPa

Table = tuple[list[str], list[list[str]]]


def zones(case: SweptCase) -> dict[str, dict[str, Any]]:
    """The Gruen zones of a case; empty if it has none."""
    return case.summary.get("gruen") or {}


def blocks(cases: Iterable[tuple[str, SweptCase]]) -> Blocks:
    """A table below its title for each case that has zones."""
    tables = (page.titled(title, page.table(*table(case))) for title, case in cases)
    return [block for own in tables for block in own]


def table(case: SweptCase) -> Table:
    """Cement thickness, peaks of both interfaces, strain energy of the bone by zone, if any."""
    own, cement = zones(case), (case.summary.get("mantle") or {}).get("gruen", {})
    places = [p for p in INTERFACES if any(p in z["interfaces"] for z in own.values())]
    bones = [b for b in BONES if any(b in z["strain_energy_density"] for z in own.values())]
    head = ["zone", *(["cement, min / mean / max (mm)"] if cement else [])]
    head += [f"{WORDS[p]} {WORDS[q]} ({u})" for p in places for q, (u, _) in QUANTITIES.items()]
    head += [f"strain energy, {BONES[b]} (kJ/m³)" for b in bones]
    rows = []
    for z, zone in own.items():
        row = [f"{z} ({'frontal' if int(z) <= FRONTAL else 'lateral'})"]
        if cement:
            row.append(" / ".join(f"{v:.2g}" for v in cement.get(z, {}).values()) or "-")
        for place in places:
            numbers = zone["interfaces"].get(place, {})
            for name in QUANTITIES:
                most, mean = (TABLE["interfaces"][f"{name}_{how}"] for how in ("max", "mean"))
                row.append(f"{most.text(numbers)} / {mean.text(numbers)}")
        density, errors = zone["strain_energy_density"], zone.get("strain_energy_density_error", {})
        row += [
            str(Number(KJ * density[b], KJ * errors[b]))
            if b in errors
            else _shown(density.get(b), KJ)
            for b in bones
        ]
        rows.append(row)
    return head, rows


def _shown(value: float | None, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.3g}"


def intact(cases: Sequence[SweptCase]) -> SweptCase | None:
    """The case with zones and without a stem, if a sweep has one."""
    return next((c for c in cases if zones(c) and "stem" not in c.data.get("regions", {})), None)


def shielding(case: SweptCase, without: SweptCase) -> dict[str, dict[str, float]]:
    """Relative change of the energy density against the intact femur, by kind of bone and zone."""
    found: dict[str, dict[str, float]] = {}
    before = zones(without)
    for name, zone in zones(case).items():
        for bone, b in zone["strain_energy_density"].items():
            a = before.get(name, {}).get("strain_energy_density", {}).get(bone)
            if bone in BONES and a:
                found.setdefault(bone, {})[name] = b / a - 1
    return found


def shielding_picture(
    cases: Mapping[str, SweptCase], without: SweptCase | None, folder: Path
) -> list[Figure]:
    """Draw the stress shielding of each case; nothing without an intact femur."""
    if without is None:
        return []
    every = {stem: shielding(c, without) for stem, c in cases.items() if c is not without}
    changes = {stem: by_bone for stem, by_bone in every.items() if by_bone}
    if not changes:
        return []
    bones = [b for b in BONES if any(b in c for c in changes.values())]
    figure = figures.new(9.4, 2.9 * len(bones) + 0.5)
    grid = figure.subplots(len(bones), 1, squeeze=False, sharex=True).ravel()
    width = 0.8 / len(changes)
    for axes, bone in zip(grid, bones, strict=True):
        for k, (stem, by_bone) in enumerate(changes.items()):
            values = by_bone.get(bone, {})
            at = [int(z) + (k - 0.5 * (len(changes) - 1)) * width for z in values]
            percent = [100 * v for v in values.values()]
            axes.bar(at, percent, 0.94 * width, color=figures.colour(k), label=stem)
        axes.axhline(0, color="0.2", lw=0.8)
        axes.axvline(FRONTAL + 0.5, color="0.6", lw=0.8, ls=":")
        figures.title(axes, BONES[bone])
        axes.set_ylabel("change of strain\nenergy density (%)")
        figures.grid(axes, "y")
        axes.set_xticks(range(1, 15))
    grid[-1].set_xlabel("Gruen zone (1 to 7 frontal, 8 to 14 lateral view)")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False)
    figures.save(figure, folder / "shielding.png", 120)
    caption = (
        f"Strain energy per volume of bone against the intact femur ({without.name}); below zero "
        "the stem takes load from the bone."
    )
    text = ". ".join(
        f"{stem}, {BONES[bone]}: " + ", ".join(f"zone {z} {100 * v:.0f} %" for z, v in own.items())
        for stem, by_bone in changes.items()
        for bone, own in by_bone.items()
    )
    return [Figure("shielding.png", "Stress shielding", caption, text)]


def mantles(cases: Sequence[SweptCase]) -> Table:
    """Thickness and volume of each mantle, and the least cortex around it, where recorded."""
    keys = ("min", "p5", "median", "mean", "p95", "max")
    head = ["geometry", "mesh (mm)", "nominal (mm)", *(f"{k} (mm)" for k in keys)]
    head += ["clipped by the canal", "cement (cm³)", "least cortex (mm)"]
    found: dict[tuple[str, ...], float] = {}
    for case in cases:
        own = case.summary.get("mantle") or {}
        thickness = own.get("thickness", {})
        if "nominal" not in thickness:
            continue
        clipped = thickness["clipped_fraction"]
        size = magnitude(case.data.get("mesh", {}).get("size"))
        row = (
            str(case.data.get("geometry", {}).get("kind", "")),
            "-" if size is None else f"{size:g}",
            f"{thickness['nominal']:g}",
            *(_shown(thickness.get(k)) for k in keys),
            f"{100 * clipped:.0f} %",
            _shown(own.get("volume"), 1e-3),
            _shown(own.get("cortex_min")),
        )
        found[row] = thickness["nominal"]
    return head, [list(row) for row in sorted(found, key=lambda r: (*r[:2], found[r]))]
