"""The view in three dimensions: what is packed into the page, and a real browser that draws it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from mantle.arrays import Floats
from mantle.report import viewer
from mantle.results.reading import Run
from tests.support import STEM, extended

BROWSER = shutil.which("chromium-headless-shell") or shutil.which("chromium")
NEEDED = all((viewer.THREE / name).exists() for name in viewer.SCRIPTS)
CASE = STEM.replace("order: 1", "order: 2") + "stages: [{name: half}, {name: whole}]\n"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A stem loaded in two stages, at second order."""
    folder = tmp_path_factory.mktemp("viewed")
    text = CASE.replace(
        "force: [300 N, 0 N, -900 N]", "force: [300 N, 0 N, -900 N], history: [0.5, 1]"
    )
    done = extended(folder, "", text, "run", "case.yaml", "-o", "out")
    assert done.returncode == 0, done.stderr
    return Run(folder / "out")


def unpacked(data: bytes, at: int, n: int, kind: str = "<u2") -> Floats:
    """Numbers of the page."""
    return np.frombuffer(data, kind, n, at).astype(np.float64)


def test_values_are_those_of_the_files(run: Run) -> None:
    """To a part in 65534 of their range, after every stage; nothing away from interfaces."""
    head, data = viewer.packed(run)
    assert head["stages"] == ["half", "whole"]
    n = head["points"]["n"]
    x = unpacked(data, head["points"]["at"], 3 * n).reshape(-1, 3) / viewer.LEVELS * head["size"]
    x += head["low"]
    nodes = np.unique(np.concatenate([t.ravel() for t in viewer.outsides(run, True).values()]))
    assert np.abs(x - run.points[nodes]).max() <= 0.51 * head["size"] / viewer.LEVELS
    for k, stage in enumerate(head["stages"]):
        for field in head["fields"]:
            step = field["steps"][k]
            parts = unpacked(data, step["at"], n)
            values = step["min"] + parts / viewer.LEVELS * (step["max"] - step["min"])
            own = run.on_points(field["name"], stage)[nodes]
            own = np.linalg.norm(own, axis=1) if own.ndim == 2 else own
            known = parts <= viewer.LEVELS
            factor = 1e3 if field["unit"] == "µm" else 1.0
            room = 0.51 * (step["max"] - step["min"]) / viewer.LEVELS + 1e-12
            assert np.abs(values - factor * own)[known].max() <= room
            if ":" in field["label"]:
                contact = field["name"].rsplit("_", 1)[0]
                assert (known == (run.at_interface(contact, "status")[nodes] >= 0)).all()
            else:
                assert known.all()
        u = unpacked(data, head["moves"][k]["at"], 3 * n).reshape(-1, 3) / viewer.LEVELS
        most = head["moves"][k]["most"]
        assert np.abs((2 * u - 1) * most - run.displacement(stage)[nodes]).max() < most / 6e4


def test_outsides_are_closed_and_turned_outwards(run: Run) -> None:
    """The volume inside each is that of its cells, which are curved: to the second order."""
    for name, triangles in viewer.outsides(run, False).items():
        x = run.points[triangles]
        inside = np.einsum("ti,ti->t", np.cross(x[:, 0], x[:, 1]), x[:, 2]).sum() / 6
        assert inside == pytest.approx(run.volumes()[run.region == run.regions[name]].sum())
    fine, coarse = viewer.outsides(run, True), viewer.outsides(run, False)
    assert all(len(fine[name]) == 4 * len(coarse[name]) for name in coarse)


def test_a_page_that_would_be_too_large_has_fewer_points(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Corners alone, then the last stages alone."""
    whole, data = viewer.packed(run)
    monkeypatch.setattr(viewer, "MOST", len(data) // 2)
    head, less = viewer.packed(run)
    assert head["points"]["n"] < whole["points"]["n"]
    assert len(less) < len(data) / 2
    monkeypatch.setattr(viewer, "MOST", len(data) // 20)
    assert viewer.packed(run)[0]["stages"] == ["whole"]


@pytest.mark.skipif(not NEEDED, reason="libjs-three is missing")
def test_nothing_in_it_points_elsewhere_or_ends_its_script(run: Run) -> None:
    """No reference to a file or a server that a browser would follow; few lines of our own."""
    text = viewer.viewer(run.folder)
    assert text is not None
    assert not re.search(
        r"<[a-z]+[^>]*\s(src|href)=", re.sub(r"<script>.*?</script>", "", text, flags=re.S)
    )
    assert text.count("<script") == text.count("</script>")
    assert len(text) < 2_000_000
    own = Path(viewer.__file__).with_name("viewer.js").read_text(encoding="utf-8")
    assert len(own.splitlines()) < 300


def test_no_fields_no_view(tmp_path: Path) -> None:
    """A run that wrote no fields has none."""
    assert viewer.viewer(tmp_path) is None


TRY = """
<pre id="found"></pre><script>
(async () => {
  while (!document.getElementById("view").dataset.ready) await new Promise(r => setTimeout(r, 20));
  const view = window.mantleView, found = [];
  for (const [x, y] of [[0.6, 0.8], [1, 0], [0, -1]]) {
    view.look(x, y, 0.2);
    view.head.fields.forEach((field, k) => view.head.stages.forEach((stage, s) => {
      view.show(k, s);
      for (const at of [[0, 0], [0.03, 0.2], [-0.02, -0.3]]) {
        const hit = view.pick(...at);
        if (hit) found.push({ field: field.name, stage, ...hit });
      }
    }));
  }
  const gl = document.querySelector("#view canvas");
  const copy = document.createElement("canvas");
  Object.assign(copy, { width: gl.width, height: gl.height });
  const c2 = copy.getContext("2d");
  c2.drawImage(gl, 0, 0);
  const seen = new Set(c2.getImageData(0, 0, gl.width, gl.height).data);
  document.getElementById("found").textContent = JSON.stringify({ found, colours: seen.size });
})();
</script>
"""


@pytest.mark.slow
@pytest.mark.skipif(not (BROWSER and NEEDED), reason="no browser or no libjs-three")
def test_a_browser_draws_it_and_picks_the_values_of_the_field(run: Run, tmp_path: Path) -> None:
    """In headless Chromium without a network: no error, and values linear on the facets."""
    page = tmp_path / "page.html"
    text = viewer.viewer(run.folder)
    page.write_text(f"<!DOCTYPE html><meta charset='utf-8'><body>{text}{TRY}</body>")
    options = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options += ["--enable-logging=stderr", "--virtual-time-budget=20000", "--window-size=900,700"]
    options += ["--host-resolver-rules=MAP * ~NOTFOUND", "--dump-dom", page.as_uri()]
    done = subprocess.run([str(BROWSER), *options], capture_output=True, text=True, timeout=120)
    assert "CONSOLE" not in done.stderr, done.stderr
    told = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.S)
    assert told and told[1], done.stderr
    found = json.loads(told[1])
    assert found["colours"] > 20  # something is drawn, and shaded
    picks = [p for p in found["found"] if p["value"] is not None]
    assert {p["stage"] for p in picks} == {"half", "whole"}
    assert len({p["field"] for p in picks}) >= 8
    triangles = viewer.outsides(run, True)
    for p in picks:
        own = run.on_points(p["field"], p["stage"])
        own = np.linalg.norm(own, axis=1) if own.ndim == 2 else own
        factor = 1e3 if p["field"].split("_")[-1] in ("slip", "gap", "motion") else 1.0
        nearest = value_near(run.points, triangles[p["body"]], factor * own, np.array(p["place"]))
        assert p["value"] == pytest.approx(nearest, abs=2e-3 * np.ptp(factor * own) + 1e-9)


def value_near(x: Floats, triangles: Floats, values: Floats, place: Floats) -> float:
    """Value on the nearest of triangles, linear on it."""
    a, b, c = (x[triangles[:, k]] for k in range(3))
    edges = np.stack([b - a, c - a], axis=1)
    gram = np.einsum("tki,tli->tkl", edges, edges)
    right = np.einsum("tki,ti->tk", edges, place - a)
    part = np.linalg.solve(gram, right[:, :, None])[:, :, 0]
    bary = np.clip(np.column_stack([1 - part.sum(axis=1), part]), 0, 1)
    bary /= bary.sum(axis=1, keepdims=True)
    far = np.linalg.norm(np.einsum("tk,tki->ti", bary, x[triangles]) - place, axis=1)
    k = int(np.argmin(far))
    return float(bary[k] @ values[triangles[k]])
