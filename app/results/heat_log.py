"""The closing tables of heat and cure, in plain words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

CRITERIA = {
    "47C_1min": "47 degC for 1 min",
    "cem43_16": "CEM43 of 16 min",
    "cem43_60": "CEM43 of 60 min",
    "cem43_240": "CEM43 of 240 min",
    "henriques_moritz": "Henriques-Moritz",
}


def tables(summary: dict[str, Any]) -> list[str]:
    """Lines on temperatures, dead bone and cure; none in a run without heat."""
    lines: list[str] = []
    if thermal := summary.get("thermal"):
        lines += _regions(thermal["regions"]) + _interfaces(thermal["interfaces"])
        lines += _necrosis(thermal["regions"])
    return lines + [_cure(name, q) for name, q in summary.get("cure", {}).items()]


def _number(q: dict[str, Any], key: str, digits: int) -> str:
    """A number, ``41.3 ± 1.8`` where its error is known, a dash where there is none."""
    if q.get(key) is None:
        return "-"
    error = q.get(f"{key}_error")
    return f"{q[key]:.{digits}f}" + ("" if error is None else f" ± {error:.{digits}f}")


def _wide(tables: dict[str, Any]) -> int:
    return 14 if any(k.endswith("_error") for q in tables.values() for k in q) else 9


def _regions(regions: dict[str, Any]) -> list[str]:
    w = _wide(regions)
    titles = ("hottest", "at time", "hottest at end", "mean at end", "over 47 degC")
    units = ("degC", "s", "degC", "degC", "s")
    widths = (w, w, max(w, 14), max(w, 11), max(w, 12))
    lines = [_line("temperature", titles, widths), _line("", units, widths)]
    for name, q in regions.items():
        cells = [
            _number(q, key, 1)
            for key in (
                *("temperature_max", "temperature_max_time", "temperature_end_max"),
                *("temperature_mean", "seconds_over_47"),
            )
        ]
        lines.append(_line(name, cells, widths))
    return lines


def _interfaces(interfaces: dict[str, Any]) -> list[str]:
    if not interfaces:
        return []
    w = _wide(interfaces)
    titles = ("hottest, first side", "second side", "largest jump", "largest flux")
    units = ("degC", "degC", "K", "W/m^2")
    widths = (max(w, 19), max(w, 11), max(w, 12), max(w, 12))
    lines = [_line("interface", titles, widths), _line("", units, widths)]
    for name, q in interfaces.items():
        cells = [
            _number(q, key, digits)
            for key, digits in (
                *(("temperature_max_first", 1), ("temperature_max_second", 1)),
                *(("temperature_jump_max", 1), ("heat_flux_max", 0)),
            )
        ]
        lines.append(_line(name, cells, widths))
    return lines


def _necrosis(regions: dict[str, Any]) -> list[str]:
    """Dead bone by every criterion, because they disagree."""
    bone = {name: q for name, q in regions.items() if "necrosis_47C_1min_volume" in q}
    if not bone:
        return []
    titles = [f"{name}{what}" for name in bone for what in ("", ", depth")]
    units = ["mm^3", "mm"] * len(bone)
    widths = [max(_wide(bone), len(title)) for title in titles]
    lines = [_line("dead bone", titles, widths), _line("", units, widths)]
    for key, words in CRITERIA.items():
        cells = []
        for q in bone.values():
            cells.append(_number(q, f"necrosis_{key}_volume", 1))
            cells.append(_number(q, f"necrosis_{key}_depth", 2))
        lines.append(_line(words, cells, widths))
    return lines


def _line(first: str, cells: Sequence[str], widths: Sequence[int]) -> str:
    return f"{first:<18}" + "".join(f" {c:>{w}}" for c, w in zip(cells, widths, strict=True))


def _cure(name: str, q: dict[str, Any]) -> str:
    half, most = (_number(q, key, 1) for key in ("time_50", "time_90"))
    reached = [
        f"{part} everywhere at {when} s"
        for part, when in (("50 %", half), ("90 %", most))
        if when != "-"
    ]
    return (
        f"{name} has set to {q['degree_min']:.4f} .. {q['degree_max']:.4f}"
        + "".join(f", {r}" for r in reached)
        + f"; fastest rate {_number(q, 'rate_max', 4)} 1/s"
    )
