"""``mantle report`` on made-up sweeps: pages of samples and texts."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from app.report import sweep_results as rs
from app.report import sweep_tables
from app.report.page import bullets, page


def test_report_of_samples_has_no_curves_and_sorted_levels(tmp_path: Path) -> None:
    """Samples vary in all inputs, so a curve over one of them would join two unrelated runs."""
    levels = np.random.default_rng(4).permutation(np.arange(1, 41) / 8)
    samples = [
        rs.SweptCase(f"s{k}", tmp_path / f"s{k}", "converged", "samples", {"mesh.size": f"{x} mm"})
        for k, x in enumerate(levels)
    ]
    grid = [rs.SweptCase("g", tmp_path / "g", "converged", "grid", {"mesh.size": "2 mm"})]
    results = rs.SweepResults(tmp_path, "A sweep", [*samples, *grid], uncertainty={"samples": {}})
    assert results.on_axes == grid
    (sentence,) = sweep_tables.axes_in_words(samples)
    assert "40 levels from 0.125 to 5" in sentence


def test_report_keys_between_backticks_are_code() -> None:
    texts = ["pressure: reduce `mesh.size` or set `mesh.order: 2`", "converged: `<b>` in 3 s"]
    html = page("A run", [], bullets(texts))
    assert "reduce <code>mesh.size</code> or set <code>mesh.order: 2</code></li>" in html
    assert "</span>: <code>&lt;b&gt;</code> in 3 s</li>" in html
    assert "`" not in html.split("<body>")[-1]
