"""Numbers by Gruen zone, stress shielding, and thickness of the mantle."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path

from app.case.number_text import Number
from app.case.quantities import TABLE
from app.case.summary import Numbers, Zone
from app.foundation.layout import two_digits
from app.plots import figures
from app.report import page
from app.report.page import Block, Figure
from app.report.sweep_results import (
    INTERFACES,
    QUANTITIES,
    QUANTITY_LABELS,
    SweptCase,
    magnitude,
    named,
)

# Last zone of the frontal view; higher numbers belong to the lateral view.
FRONTAL = 7
BONES = ("cortical_bone", "cancellous_bone")
# kJ/m3 in 1 MPa.
KJ = 1e3
# Mark of a number without error next to others with errors: no coarser mesh has this bone there.
UNKNOWN = " (error unknown)"


def zones(case: SweptCase) -> dict[str, Zone]:
    """The Gruen zones of a case; empty if it has none."""
    return case.summary.get("gruen") or {}


def blocks(cases: Iterable[tuple[str, SweptCase]]) -> list[Block]:
    """Return the tables of each case that has zones, below its title."""
    all_blocks = []
    for title, case in cases:
        case_blocks: list[Block] = []
        for heading, head, rows in tables(case):
            case_blocks += page.titled(heading, page.table(head, rows))
        all_blocks += page.titled(title, case_blocks)
    return all_blocks


def tables(case: SweptCase) -> list[tuple[str, list[str], list[list[str]]]]:
    """Return tables by zone: of cement and bone, and of each interface.

    Each has a title, a head and rows. Tables without numbers are left out.
    """
    by_zone = zones(case)
    cement = (case.summary.get("mantle") or {}).get("gruen", {})
    known_interfaces: set[str] = set()
    known_bones: set[str] = set()
    for zone in by_zone.values():
        known_interfaces |= zone["interfaces"].keys()
        known_bones |= zone["strain_energy_density"].keys()
    interfaces = [interface for interface in INTERFACES if interface in known_interfaces]
    bones = [bone for bone in BONES if bone in known_bones]
    head = ["zone"]
    if cement:
        head.append("cement thickness, min / mean / max (mm)")
    head += [f"strain energy, {named(b)} (kJ/m³)" for b in bones]
    known_errors = [z for z in by_zone.values() if z.get("strain_energy_density_error")]
    rows = []
    for zone_name, zone in by_zone.items():
        row = [_zone(zone_name)]
        if cement:
            row.append(" / ".join(two_digits(v) for v in cement.get(zone_name, {}).values()) or "-")
        density, errors = zone["strain_energy_density"], zone.get("strain_energy_density_error", {})
        for bone in bones:
            if bone in errors:
                row.append(Number(KJ * density[bone], KJ * errors[bone]).marked)
            else:
                is_unknown = bool(known_errors) and bone in density
                row.append(_shown(density.get(bone), KJ) + (UNKNOWN if is_unknown else ""))
        rows.append(row)
    titled_tables = []
    if len(head) > 1:
        titled_tables.append(("Cement and bone" if cement else "Bone", head, rows))
    for interface in interfaces:
        known_names: set[str] = set()
        for zone in by_zone.values():
            known_names |= zone["interfaces"].get(interface, {}).keys()
        unit_of_quantity = {
            q: unit for q, (unit, _) in QUANTITIES.items() if f"{q}_mean" in known_names
        }
        if "micromotion" in unit_of_quantity:
            del unit_of_quantity["motion"]  # because it contains the interference
        head = ["zone", *(f"{QUANTITY_LABELS[q]} ({unit})" for q, unit in unit_of_quantity.items())]
        rows = []
        for zone_name, zone in by_zone.items():
            numbers = zone["interfaces"].get(interface, {})
            rows.append(
                [
                    _zone(zone_name),
                    *(_largest_and_mean(quantity, numbers) for quantity in unit_of_quantity),
                ]
            )
        titled_tables.append((f"{QUANTITY_LABELS[interface]} interface", head, rows))
    return titled_tables


def _zone(number: str) -> str:
    view = "frontal" if int(number) <= FRONTAL else "lateral"
    return f"{number} ({view})"


def _largest_and_mean(quantity: str, numbers: Numbers) -> str:
    largest, mean = (
        TABLE["interfaces"][f"{quantity}_{statistic}"] for statistic in ("max", "mean")
    )
    return f"{largest.text(numbers)} / {mean.text(numbers)}"


def _shown(value: float | None, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.3g}"


def intact(cases: Sequence[SweptCase]) -> SweptCase | None:
    """The case with zones and without a stem, if a sweep has one."""
    return next((c for c in cases if zones(c) and "stem" not in c.data.get("regions", {})), None)


def shielding(case: SweptCase, intact: SweptCase) -> dict[str, dict[str, float]]:
    """Return the relative change of the strain energy density against the intact femur.

    It is by kind of bone and by zone [-].
    """
    changes: dict[str, dict[str, float]] = {}
    intact_zones = zones(intact)
    for zone_name, zone in zones(case).items():
        for bone, density in zone["strain_energy_density"].items():
            density_before = (
                intact_zones.get(zone_name, {}).get("strain_energy_density", {}).get(bone)
            )
            if bone in BONES and density_before:
                changes.setdefault(bone, {})[zone_name] = density / density_before - 1
    return changes


def shielding_picture(
    cases: Mapping[str, SweptCase], intact: SweptCase | None, folder: Path
) -> list[Figure]:
    """Draw the stress shielding of each case; nothing without an intact femur."""
    if intact is None:
        return []
    all_shielding = {stem: shielding(c, intact) for stem, c in cases.items() if c is not intact}
    changes = {stem: by_bone for stem, by_bone in all_shielding.items() if by_bone}
    if not changes:
        return []
    changed_bones = set(chain.from_iterable(changes.values()))
    bones = [bone for bone in BONES if bone in changed_bones]
    figure = figures.new(9.4, 2.9 * len(bones) + 0.5)
    grid = figure.subplots(len(bones), 1, squeeze=False, sharex=True).ravel()
    width = 0.8 / len(changes)
    for axes, bone in zip(grid, bones, strict=True):
        for k, (stem, by_bone) in enumerate(changes.items()):
            values = by_bone.get(bone, {})
            positions = [int(z) + (k - 0.5 * (len(changes) - 1)) * width for z in values]
            percent = [100 * v for v in values.values()]
            axes.bar(positions, percent, 0.94 * width, color=figures.colour(k), label=stem)
        axes.axhline(0, color="0.2", lw=0.8)
        axes.axvline(FRONTAL + 0.5, color="0.6", lw=0.8, ls=":")
        figures.set_title(axes, named(bone))
        axes.set_ylabel("change of strain\nenergy density (%)")
        figures.grid(axes, "y")
        axes.set_xticks(range(1, 15))
    grid[-1].set_xlabel("Gruen zone (1 to 7 frontal, 8 to 14 lateral view)")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False)
    figures.save_figure(figure, folder / "shielding.png", 120)
    caption = (
        "Stress shielding: strain energy per volume of bone against the intact femur"
        f" ({intact.name}). Below zero the stem takes load from the bone."
    )
    sentences = []
    for stem, by_bone in changes.items():
        for bone, by_zone in by_bone.items():
            percentages = [f"zone {z} {100 * change:.0f} %" for z, change in by_zone.items()]
            sentences.append(f"{stem}, {named(bone)}: {', '.join(percentages)}")
    return [Figure("shielding.png", "Stress shielding", caption, ". ".join(sentences))]


def mantles(cases: Sequence[SweptCase]) -> tuple[list[str], list[list[str]]]:
    """Return head and rows: thickness and volume of cement mantles, and the thinnest cortex."""
    keys = ("min", "p5", "median", "mean", "p95", "max")
    head = ["geometry", "mesh (mm)", "given (mm)", *(f"{k} (mm)" for k in keys)]
    head += ["made thinner by the canal", "cement (cm³)", "thinnest cortex (mm)"]
    nominal: dict[tuple[str, ...], float] = {}
    for case in cases:
        mantle = case.summary.get("mantle") or {}
        thickness = mantle.get("thickness", {})
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
            _shown(mantle.get("volume"), 1e-3),
            _shown(mantle.get("cortex_min")),
        )
        nominal[row] = thickness["nominal"]
    return head, [list(row) for row in sorted(nominal, key=lambda r: (*r[:2], nominal[r]))]
