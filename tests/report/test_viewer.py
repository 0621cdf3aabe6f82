"""The view in three dimensions: what is packed, a real browser that draws it, and stills."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.arrays import Floats
from app.report import pictures, viewer
from app.results.reading import Run
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


@pytest.fixture(scope="module")
def stiffer(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The same stem with more friction, on the same mesh."""
    folder = tmp_path_factory.mktemp("stiffer")
    text = (run.folder.parent / "case.yaml").read_text(encoding="utf-8")
    more = ["--set", "interfaces.stem_cement.friction_coefficient=0.9"]
    done = extended(folder, "", text, "run", "case.yaml", "-o", "out", *more)
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


def test_a_page_that_would_be_too_large_has_fewer_points(run: Run) -> None:
    """Corners alone, then the last stages alone."""
    whole, data = viewer.packed(run)
    head, less = viewer.packed(run, most_bytes=len(data) // 2)
    assert head["points"]["n"] < whole["points"]["n"]
    assert len(less) < len(data) / 2
    assert viewer.packed(run, most_bytes=len(data) // 20)[0]["stages"] == ["whole"]


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


def test_differences_are_those_of_the_files(run: Run, stiffer: Run) -> None:
    """Where meshes are the same; their values are the second's less the first's."""
    assert viewer.same_mesh(run, stiffer)
    head, data = viewer.packed(stiffer, run)
    assert head["signed"]
    nodes = np.unique(np.concatenate([t.ravel() for t in viewer.outsides(run, True).values()]))
    field = next(f for f in head["fields"] if f["name"].endswith("_slip"))
    step = field["steps"][0]
    parts = unpacked(data, step["at"], head["points"]["n"])
    values = step["min"] + parts / viewer.LEVELS * (step["max"] - step["min"])
    a, b = (np.linalg.norm(r.on_points(field["name"], "half"), axis=1) for r in (run, stiffer))
    known = parts <= viewer.LEVELS
    assert np.abs(1e3 * (b - a))[nodes][known].max() > 0
    room = 0.51 * (step["max"] - step["min"]) / viewer.LEVELS
    assert np.abs(values - 1e3 * (b - a)[nodes])[known].max() <= room + 1e-12


def test_names_of_runs_differ() -> None:
    """By as much of their paths as it takes."""
    assert viewer.distinct([Path("/a/b"), Path("/a/c")]) == ["b", "c"]
    assert viewer.distinct([Path("/a/x/out"), Path("/a/y/out")]) == ["x/out", "y/out"]
    assert viewer.distinct([Path("/a/b"), Path("/a/b")]) == ["//a/b (1)", "//a/b (2)"]


def test_no_fields_no_view(tmp_path: Path) -> None:
    """A run that wrote no fields has none."""
    assert viewer.viewer(tmp_path) is None


TRY = """
<pre id="found"></pre><script>
(async () => {
  while (!document.getElementById("view").dataset.ready) await new Promise(r => setTimeout(r, 20));
  const w = window.mantleView, found = [], cuts = [], cameras = [];
  for (const [x, y] of [[0.6, 0.8], [1, 0], [0, -1]]) {
    w.look(x, y, 0.2);
    cameras.push(w.views.map(v => v.camera.position.toArray().concat(v.camera.zoom)));
    const stages = w.views[0].head.stages;
    for (const field of w.views[0].head.fields) for (const stage of stages) {
      w.show(field.name, stage);
      for (const at of [[0, 0], [0, 0.2], [0, -0.3]]) w.views.forEach((view, run) => {
        const hit = view.pick(...at);
        if (hit) found.push({ field: field.name, stage, run, ...hit });
      });
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
  // Cut across x and looked at from there: the middle of the picture is the filled section.
  w.look(1, 0, 0);
  w.state.axis = 0;
  w.clip();
  const gl = canvases[0], data = seen(gl);
  const row = Math.round(gl.height * 0.62);
  let tint = 0;
  const bytes = c => [c.r, c.g, c.b].map(v => Math.round(255 * v)).join();
  const own = w.views[0].meshes.map(m => bytes(m.tint));
  for (let k = 0; k < gl.width; k++)
    tint += own.includes([0, 1, 2].map(i => data[4 * (row * gl.width + k) + i]).join());
  for (let y = -0.9; y < 0.9; y += 0.1) {
    const hit = w.views[0].pick(0, y);
    if (hit) cuts.push({ ...hit, plane: w.views[0].meshes[0].section[2].position.x });
  }
  const out = { found, colours, cameras, cuts, tint };
  document.getElementById("found").textContent = JSON.stringify(out);
})();
</script>
"""


def tried(page: Path, text: str) -> dict[str, Any]:
    """What a browser without a network found in a view."""
    page.write_text(f"<!DOCTYPE html><meta charset='utf-8'><body>{text}{TRY}</body>")
    options = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options += ["--enable-logging=stderr", "--virtual-time-budget=20000", "--window-size=900,700"]
    options += ["--host-resolver-rules=MAP * ~NOTFOUND", "--dump-dom", page.as_uri()]
    done = subprocess.run([str(BROWSER), *options], capture_output=True, text=True, timeout=120)
    assert "CONSOLE" not in done.stderr, done.stderr
    told = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.S)
    assert told and told[1], done.stderr
    return dict(json.loads(told[1]))


@pytest.mark.slow
@pytest.mark.skipif(not (BROWSER and NEEDED), reason="no browser or no libjs-three")
def test_a_browser_draws_it_and_picks_the_values_of_the_field(run: Run, tmp_path: Path) -> None:
    """In headless Chromium without a network: no error, and values linear on the facets."""
    found = tried(tmp_path / "page.html", viewer.viewer(run.folder) or "")
    assert found["colours"][0] > 20  # something is drawn, and shaded
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
    # The section is filled: in the plane, without a value.
    filled = [p for p in found["cuts"] if p["value"] is None]
    assert found["tint"] > 10
    assert filled and all(p["place"][0] == pytest.approx(p["plane"], abs=1e-3) for p in filled)


@pytest.mark.slow
@pytest.mark.skipif(not (BROWSER and NEEDED), reason="no browser or no libjs-three")
def test_a_browser_draws_runs_side_by_side_under_one_camera(
    run: Run, stiffer: Run, tmp_path: Path
) -> None:
    """Two runs and their difference: the third value is the second less the first."""
    found = tried(tmp_path / "page.html", viewer.viewer(run.folder, stiffer.folder) or "")
    assert len(found["colours"]) == 3 and min(found["colours"]) > 20
    for cameras in found["cameras"]:
        assert cameras[1] == pytest.approx(cameras[0]) and cameras[2] == pytest.approx(cameras[0])
    looks: dict[Any, dict[int, Any]] = {}
    order: dict[tuple[str, str, int], int] = {}
    for p in found["found"]:
        key = p["field"], p["stage"], p["run"]
        order[key] = order.get(key, -1) + 1
        looks.setdefault((*key[:2], order[key]), {})[p["run"]] = p
    compared = 0
    for (field, stage, _), by_run in looks.items():
        values = [by_run[k]["value"] for k in sorted(by_run)]
        if len(values) == 3 and None not in values:
            size = max(np.abs(r.on_points(field, stage)).max() for r in (run, stiffer))
            factor = 1e3 if field.split("_")[-1] in ("slip", "gap", "motion") else 1.0
            assert values[2] == pytest.approx(values[1] - values[0], abs=2e-3 * factor * size)
            compared += 1
    assert compared > 20


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


def test_each_interface_is_drawn_on_its_inner_body(run: Run, tmp_path: Path) -> None:
    """Its facets are those of the contact area, and the picture has colours."""
    figure = pictures.sides(run, tmp_path)[0]
    assert (tmp_path / "interfaces.pdf").stat().st_size > 10_000
    import matplotlib.image

    pixels = matplotlib.image.imread(tmp_path / figure.name)[:, :, :3]
    coloured = np.ptp(pixels, axis=2) > 0.2
    assert 0.02 < coloured.mean() < 0.9
    bodies = viewer.outsides(run, curved=True)
    for contact, body in (("stem_cement", "stem"), ("cement_bone", "cement")):
        side = pictures._side(run, contact, bodies)
        assert side is not None and side[0] == body
        x = run.points[side[1]]
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum() / 2
        assert area == pytest.approx(run.areas(contact).sum(), rel=0.01)
