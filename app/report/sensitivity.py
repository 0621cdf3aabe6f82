"""Which of several varied keys matters: rank correlation over the cases of a part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.report.sweep_figures import headlines, label, scale, title
from app.report.sweep_results import SweptCase

FEWEST = 6  # cases, below which ranks say little
MOST = 11  # numbers


def table(cases: Sequence[SweptCase]) -> tuple[list[str], list[list[str | Sequence[str]]]]:
    """Spearman's coefficients of each headline number with each key: head and rows.

    Parts that vary fewer than two keys with numbers have none: a curve says more.
    """
    from scipy.stats import rankdata

    head = ["part", "number", "rank correlation with"]
    rows: list[list[str | Sequence[str]]] = []
    parts: dict[str, list[SweptCase]] = {}
    for case in cases:
        if case.done:
            parts.setdefault(case.part, []).append(case)
    for part, own in parts.items():
        keys = {}
        for key in own[0].overrides:
            number = scale(own, key)[1]
            levels = [number(c.overrides.get(key)) for c in own]
            if _varies(levels):
                keys[key] = rankdata(levels)
        if len(keys) < 2 or len(own) < FEWEST:
            continue
        for name in headlines(own)[:MOST]:
            numbers = [c.number(name) for c in own]
            values = [None if n is None else n.value for n in numbers]
            if not _varies(values):
                continue
            y = rankdata(values)
            found = []
            for key, x in keys.items():
                found.append((float(np.corrcoef(x, y)[0, 1]), title(key)))
            found.sort(key=lambda pair: -abs(pair[0]))
            words = [f"{r:+.2f} {key}" for r, key in found]
            rows.append([part or "all", label(name)[0], words])
    return head, rows


def _varies(values: Sequence[float | None]) -> bool:
    """Whether all are known and not all equal."""
    return None not in values and len(set(values)) > 1
