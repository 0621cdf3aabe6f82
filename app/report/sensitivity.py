"""The most influential keys: rank correlation over the cases of a part."""

from __future__ import annotations

from collections.abc import Sequence

from app.campaigns.uncertainty import correlation
from app.report.sweep_figures import headlines, label, scale, title
from app.report.sweep_results import SweptCase

FEWEST = 6  # cases, below which ranks say little
MOST = 11  # numbers


def table(cases: Sequence[SweptCase]) -> tuple[list[str], list[list[str | Sequence[str]]]]:
    """Spearman's coefficients of each headline number with each key: head and rows.

    Parts with fewer than two varied numeric keys have none, as a curve shows more.
    """
    rows: list[list[str | Sequence[str]]] = []
    for part in dict.fromkeys(c.part for c in cases if c.done):
        own = [c for c in cases if c.done and c.part == part]
        levels = {}
        for key in own[0].overrides:
            number = scale(own, key)[1]
            levels[key] = [x for c in own if (x := number(c.overrides.get(key))) is not None]
        varied = {k: x for k, x in levels.items() if len(x) == len(own) and len(set(x)) > 1}
        for name in headlines(own)[:MOST] if len(varied) > 1 and len(own) >= FEWEST else ():
            y = [found.value for c in own if (found := c.number(name)) is not None]
            ranks = {k: correlation(x, y) for k, x in varied.items() if len(y) == len(own)}
            known = [(r, title(key)) for key, r in ranks.items() if r is not None]
            known.sort(key=lambda pair: -abs(pair[0]))
            if known:
                rows.append([part or "all", label(name)[0], [f"{r:+.2f} {k}" for r, k in known]])
    return ["part", "number", "rank correlation with"], rows
