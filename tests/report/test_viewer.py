"""The view in three dimensions: its packed data, a real browser that draws it, stills."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.foundation.arrays import Floats
from app.report import pictures, viewer
from app.results.reading import Run

BROWSER = shutil.which("chromium-headless-shell") or shutil.which("chromium")
NEEDED = all((viewer.THREE / name).exists() for name in viewer.SCRIPTS)
Shown = Iterator[tuple[dict[str, Any], str, Floats]]


@pytest.fixture
def run(stems: tuple[Run, Run]) -> Run:
    return stems[0]


def unpacked(data: bytes, at: int, n: int) -> Floats:
    """Numbers of the page, as fractions of their range."""
    return np.frombuffer(data, "<u2", n, at).astype(np.float64) / viewer.LARGEST_INTEGER


def shown(head: dict[str, Any], data: bytes) -> Shown:
    """Fields of the page, the stage, and values, with nan for missing ones."""
    for field in head["fields"]:
        for stage, step in zip(head["stages"], field["steps"], strict=True):
            parts = unpacked(data, step["at"], head["points"]["n"])
            values = step["min"] + parts * (step["max"] - step["min"])
            yield field, stage, np.where(parts <= 1, values, np.nan)


def size(run: Run, name: str, stage: str) -> Floats:
    """A field of the files in the units of the page; the length of vectors."""
    factor = 1e3 if name.split("_")[-1] in ("slip", "gap", "motion") else 1.0
    values = run.on_points(name, stage)
    return factor * (np.linalg.norm(values, axis=1) if values.ndim == 2 else values)


def test_viewer_values_equal_those_of_files(run: Run) -> None:
    """Values agree to a part in 65534 of their range, after every stage.

    Places away from interfaces have none.
    """
    head, data = viewer.packed_view(run)
    assert head["stages"] == ["half", "whole"]
    n = head["points"]["n"]
    x = unpacked(data, head["points"]["at"], 3 * n).reshape(-1, 3)
    x = x * head["points"]["width"] + head["points"]["low"]
    shown_nodes = [t.ravel() for t in viewer.outsides(run, True).values()]
    nodes = np.unique(np.concatenate([*shown_nodes, run.cells[:, :4].ravel()]))
    assert (
        np.abs(x - run.points[nodes]).max()
        <= 0.51 * head["points"]["width"] / viewer.LARGEST_INTEGER
    )
    for field, stage, values in shown(head, data):
        sizes = size(run, field["name"], stage)[nodes]
        known = np.isfinite(values)
        assert np.abs(values - sizes)[known].max() <= 0.51 * np.ptp(sizes[known]) / 65534 + 1e-12
        contact = field["name"].rpartition("_")[0] if ":" in field["label"] else ""
        on = run.at_interface(contact, "status")[nodes] >= 0 if contact else True
        assert (known == on).all()
    for move, stage in zip(head["moves"], head["stages"], strict=True):
        u = (2 * unpacked(data, move["at"], 3 * n).reshape(-1, 3) - 1) * move["most"]
        assert np.abs(u - run.displacement(stage)[nodes]).max() < move["most"] / 6e4


def test_viewer_differences_equal_those_of_files(stems: tuple[Run, Run]) -> None:
    """Differences are drawn only on equal meshes."""
    run, rough = stems
    assert viewer.same_mesh(run, rough)
    head, data = viewer.packed_view(rough, run)
    assert head["signed"]
    shown_nodes = [t.ravel() for t in viewer.outsides(run, True).values()]
    nodes = np.unique(np.concatenate([*shown_nodes, run.cells[:, :4].ravel()]))
    for field, stage, values in shown(head, data):
        if field["name"].endswith("_slip"):
            a, b = (size(r, field["name"], stage)[nodes] for r in (run, rough))
            known = np.isfinite(values)
            assert np.abs(b - a)[known].max() > 0
            assert np.abs(values - (b - a))[known].max() <= 0.51 * np.ptp(b - a) / 65534 + 1e-12


def test_viewer_surfaces_are_closed_and_oriented(run: Run) -> None:
    """The volume inside each surface is that of its curved cells, at second order."""
    for name, triangles in viewer.outsides(run, False).items():
        x = run.points[triangles]
        inside = np.einsum("ti,ti->t", np.cross(x[:, 0], x[:, 1]), x[:, 2]).sum() / 6
        assert inside == pytest.approx(run.volumes()[run.region == run.regions[name]].sum())
    fine, coarse = viewer.outsides(run, True), viewer.outsides(run, False)
    assert all(len(fine[name]) == 4 * len(coarse[name]) for name in coarse)


def test_viewer_reduces_points_of_large_pages(run: Run) -> None:
    """The page keeps corners alone, then the last stages alone."""
    whole, data = viewer.packed_view(run)
    head, less = viewer.packed_view(run, most_bytes=len(data) // 2)
    assert head["points"]["n"] < whole["points"]["n"]
    assert len(less) < len(data) / 2
    assert viewer.packed_view(run, most_bytes=len(data) // 20)[0]["stages"] == ["whole"]


@pytest.mark.skipif(not NEEDED, reason="libjs-three is missing")
def test_viewer_has_no_external_references(run: Run, tmp_path: Path) -> None:
    """A browser would follow no reference to a file or a server. The program has few lines."""
    text = viewer.viewer({"": run.folder})
    assert not re.search(
        r"<[a-z]+[^>]*\s(src|href)=", re.sub(r"<script>.*?</script>", "", text, flags=re.S)
    )
    assert text.count("<script") == text.count("</script>")
    assert len(text) < 2_000_000
    script = Path(viewer.__file__).with_name("viewer.js").read_text(encoding="utf-8")
    assert len(script.splitlines()) < 400
    assert viewer.viewer({"": tmp_path}) == ""  # without fields


def test_viewer_names_of_runs_are_distinct() -> None:
    """Names have as much of the paths as they need."""
    assert viewer.distinct([Path("/a/b"), Path("/a/c")]) == ["b", "c"]
    assert viewer.distinct([Path("/a/x/out"), Path("/a/y/out")]) == ["x/out", "y/out"]
    assert viewer.distinct([Path("/a/b"), Path("/a/b")]) == ["//a/b (1)", "//a/b (2)"]


TRY = """
<pre id="found"></pre><script>
(async () => {
  while (!document.getElementById("view").dataset.ready) await new Promise(r => setTimeout(r, 20));
  const w = window.mantleView, found = [], cuts = [], cameras = [];
  let look = 0;
  for (const [x, y] of [[0.6, 0.8], [1, 0], [0, -1]]) {
    w.look(x, y, 0.2);
    cameras.push(w.views.map(v => v.camera.position.toArray().concat(v.camera.zoom)));
    const stages = w.views[0].head.stages;
    for (const field of w.views[0].head.fields) for (const stage of stages) {
      w.show(field.name, stage);
      for (const at of [[0, 0], [0, 0.2], [0, -0.3]]) {
        look++;
        w.views.forEach((view, run) => {
          const hit = view.pick(...at);
          if (hit) found.push({ field: field.name, stage, run, look, ...hit });
        });
      }
    }
  }
  const seen = gl => {
    const copy = document.createElement("canvas");
    Object.assign(copy, { width: gl.width, height: gl.height });
    const c2 = copy.getContext("2d");
    c2.drawImage(gl, 0, 0);
    return c2.getImageData(0, 0, gl.width, gl.height).data;
  };
  const canvases = [...document.querySelectorAll("#view canvas")];
  const colours = canvases.map(gl => new Set(seen(gl)).size);
  // Cut across y and looked at from there, all bodies visible: the field on the section.
  const spans = [[...w.views[0].span]];
  w.checks.forEach(c => { if (!c.checked) c.click(); });
  w.show("von_mises", "whole");
  spans.push([...w.views[0].span]);
  w.look(0, 1, 0);
  w.state.axis = 1;
  w.clip();
  for (let x = -0.9; x < 0.9; x += 0.1) for (const y of [-0.2, 0, 0.3]) {
    const hit = w.views[0].pick(x, y);
    if (hit) cuts.push({ ...hit, plane: w.views[0].meshes[0].material.clippingPlanes[0].constant });
  }
  const out = { found, colours, cameras, cuts, spans };
  document.getElementById("found").textContent = JSON.stringify(out);
})();
</script>
"""


MOTION = """
<pre id="found"></pre><script>
(async () => {
  while (!document.getElementById("view").dataset.ready) await new Promise(r => setTimeout(r, 20));
  const w = window.mantleView, view = w.views[0], frames = [], stages = view.head.stages;
  const [slider] = document.querySelectorAll(".bar label input[type=range]");
  slider.value = 50;
  slider.oninput();
  const bar = document.querySelector(".motion"), range = bar.querySelector("input");
  for (const field of ["stem_cement_slip", "von_mises"]) for (let k = 0; k < stages.length; k++) {
    w.show(field, w.state.stage);
    range.value = k;
    range.oninput();
    const text = document.querySelector("#view output").textContent;
    const caption = bar.querySelector("span").textContent;
    for (const at of [[0, 0], [0, 0.2]])
      frames.push({ field, k, span: view.span, hit: view.pick(...at), text, caption });
  }
  w.show("stem_cement_slip", stages[0]);
  const played = [];
  w.play.onclick();
  for (let i = 0; i < 6; i++) {
    await new Promise(r => setTimeout(r, 700));
    played.push(stages.indexOf(w.state.stage));
  }
  const label = w.play.textContent;
  w.play.onclick();
  const out = { frames, played, label, after: w.play.textContent, scale: w.state.scale };
  document.getElementById("found").textContent = JSON.stringify(out);
})();
</script>
"""


def tried(page: Path, text: str, script: str = TRY) -> dict[str, Any]:
    """Values that a browser without a network shows in a view."""
    page.write_text(f"<!DOCTYPE html><meta charset='utf-8'><body>{text}{script}</body>")
    options = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options += ["--enable-logging=stderr", "--virtual-time-budget=20000", "--window-size=900,700"]
    options += ["--host-resolver-rules=MAP * ~NOTFOUND", "--dump-dom", page.as_uri()]
    done = subprocess.run([str(BROWSER), *options], capture_output=True, text=True, timeout=120)
    assert "CONSOLE" not in done.stderr, done.stderr
    match = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.S)
    assert match and match[1], done.stderr
    return dict(json.loads(match[1]))


@pytest.mark.slow
@pytest.mark.skipif(not (BROWSER and NEEDED), reason="no browser or no libjs-three")
def test_viewer_browser_draws_runs_and_difference(stems: tuple[Run, Run], tmp_path: Path) -> None:
    """Headless Chromium has no network.

    There is no error, one camera, and values linear on the facets.
    """
    folders = {run.folder.name: run.folder for run in stems}
    shown = tried(tmp_path / "page.html", viewer.viewer(folders))
    assert len(shown["colours"]) == 3 and min(shown["colours"]) > 20  # drawn, and shaded
    for cameras in shown["cameras"]:
        assert cameras[1] == pytest.approx(cameras[0]) and cameras[2] == pytest.approx(cameras[0])
    run, triangles = stems[0], viewer.outsides(stems[0], True)
    looks: dict[Any, dict[int, float | None]] = {}
    for p in shown["found"]:
        looks.setdefault((p["field"], p["stage"], p["look"]), {})[p["run"]] = p["value"]
        if p["run"] == 0 and p["value"] is not None:
            sizes = size(run, p["field"], p["stage"])
            nearest = value_near(run.points, triangles[p["body"]], sizes, np.array(p["place"]))
            assert p["value"] == pytest.approx(nearest, abs=2e-3 * np.ptp(sizes) + 1e-9)
    assert {stage for _, stage, _ in looks} == {"half", "whole"}
    assert len({field for field, _, _ in looks}) >= 8
    compared = 0
    for (field, stage, _), values in looks.items():
        first, second, less = (values.get(k) for k in range(3))
        if first is not None and second is not None and less is not None:
            most = max(size(r, field, stage).max() for r in stems)
            assert less == pytest.approx(second - first, abs=2e-3 * most)
            compared += 1
    assert compared > 20
    # Sections show the field, linear in the cell; colours span what bodies that are visible have.
    filled = [p for p in shown["cuts"] if abs(p["place"][1] - p["plane"]) < 1e-3]
    mises = run.on_points("von_mises", "whole")
    for p in filled:
        cells = run.cells[run.region == run.regions[p["body"]]][:, :4]
        x = np.concatenate([run.points[cells], np.ones((len(cells), 4, 1))], axis=2)
        part = np.linalg.solve(x.transpose(0, 2, 1), np.array([*p["place"], 1.0])[None, :, None])
        k = int(part[:, :, 0].min(axis=1).argmax())
        assert p["value"] == pytest.approx(part[k, :, 0] @ mises[cells[k]], rel=0.01)
    assert len(filled) > 10 and len({p["body"] for p in filled}) == len(run.regions)
    stem = np.unique(run.cells[run.region == run.regions["stem"]])
    for span, field, on in zip(
        shown["spans"], (shown["found"][-1]["field"], "von_mises"), (stem, ...), strict=True
    ):
        values = np.concatenate([size(r, field, "whole")[on] for r in stems])
        assert values.min() - 1e-9 <= span[0] < span[1] <= values.max() + 1e-9
    # Colours end at the 99.5th percentile of the drawn nodes, the larger one of both runs.
    ends = []
    for r in stems:
        drawn = np.unique(np.concatenate([t.ravel() for t in viewer.outsides(r, True).values()]))
        ends.append(np.percentile(size(r, "von_mises", "whole")[drawn], 99.5, method="nearest"))
    assert shown["spans"][1][1] == pytest.approx(max(ends), rel=1e-3)


def value_near(x: Floats, triangles: Floats, values: Floats, place: Floats) -> float:
    """Value on the nearest of the triangles, linear on it."""
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


def test_viewer_interfaces_are_drawn_on_the_inner_body(run: Run, tmp_path: Path) -> None:
    """Facets are those of the contact area, and the picture has colours."""
    figure = pictures.sides(run, tmp_path)[0]
    assert (tmp_path / "interfaces.pdf").stat().st_size > 10_000
    import matplotlib.image

    pixels = matplotlib.image.imread(tmp_path / figure.name)[:, :, :3]
    coloured = np.ptp(pixels, axis=2) > 0.2
    assert 0.02 < coloured.mean() < 0.9
    bodies = viewer.outsides(run, curved=True)
    for contact, body in (("stem_cement", "stem"), ("cement_bone", "cement")):
        side = viewer.side_of(run, contact, bodies)
        assert side is not None and side[0] == body
        x = run.points[side[1]]
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum() / 2
        assert area == pytest.approx(run.areas(contact).sum(), rel=0.01)


def test_viewer_picture_says_that_pressures_are_means(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table has the maximum at a point, without rim and tip."""
    labels = list[str]()

    def save(figure: Any, path: Path, dpi: int) -> None:
        labels.extend(axes.get_xlabel() for axes in figure.axes)

    monkeypatch.setattr(pictures.figures, "save_figure", save)
    (figure,) = pictures.sides(run, tmp_path)
    of_stem = [label for label in labels if "on the stem" in label]
    means = ["largest mean at a node" in label for label in of_stem]
    assert means == ["pressure" in label for label in of_stem] and any(means)
    assert "may be larger" in figure.caption


def test_viewer_motion_has_the_steps_between_stages(moving: Run) -> None:
    """Steps are in order, with displacement and slip alone.

    A small limit of bytes reduces their number.
    """
    head, data = viewer.packed_view(moving, motion_bytes=viewer.MOTION)
    assert head["ends"] == ["half", "whole"] and head["recorded"] == 8
    assert head["stages"][4] == "half" and head["stages"][-1] == "whole"
    assert head["stages"][:2] == ["half, 20 % (step 1)", "half, 40 % (step 2)"]
    n = head["points"]["n"]
    fields = {field["name"]: field["steps"] for field in head["fields"]}
    for k, move in enumerate(head["moves"]):
        u = (2 * unpacked(data, move["at"], 3 * n).reshape(-1, 3) - 1) * move["most"]
        assert np.abs(u).max() == pytest.approx(np.abs(moving.displacement(k)).max(), rel=1e-4)
        slip = fields["stem_cement_slip"][k]
        largest = 1e3 * np.linalg.norm(moving.on_points("stem_cement_slip", k), axis=1).max()
        assert slip["max"] == pytest.approx(largest)
        assert (fields["von_mises"][k] is None) == (k not in (4, 7))
    less = viewer.packed_view(moving, motion_bytes=2 * n * 6 * 2)[0]["stages"]
    assert len(less) == 4
    assert [stage for stage in less if "step" not in stage] == ["half", "whole"]
    assert viewer.packed_view(moving)[0]["stages"] == ["half", "whole"]


@pytest.mark.slow
@pytest.mark.skipif(not (BROWSER and NEEDED), reason="no browser or no libjs-three")
def test_viewer_browser_plays_the_steps(moving: Run, tmp_path: Path) -> None:
    """Slider and button in headless Chromium show each step, with colours for all steps."""
    shown = tried(tmp_path / "page.html", viewer.viewer({"": moving.folder}), MOTION)
    triangles = viewer.outsides(moving, True)
    picked = 0
    for frame in shown["frames"]:
        k, hit = frame["k"], frame["hit"]
        assert frame["caption"].startswith(f"step {k + 1} of 8: ")
        if frame["field"] == "von_mises":
            assert (frame["text"] == "in this page at the ends of stages") == (k not in (4, 7))
            continue
        slip = 1e3 * np.linalg.norm(moving.on_points("stem_cement_slip", k), axis=1)
        if hit and hit["value"] is not None:
            picked += 1
            near = value_near(moving.points, triangles[hit["body"]], slip, np.array(hit["place"]))
            assert hit["value"] == pytest.approx(near, abs=3e-3 * np.ptp(slip) + 1e-9)
    assert picked > 8
    spans = {tuple(f["span"]) for f in shown["frames"] if f["field"] == "stem_cement_slip"}
    assert len(spans) == 1
    assert len(set(shown["played"])) > 2
    assert (shown["label"], shown["after"]) == ("pause", "play")
    assert shown["scale"] > 0
