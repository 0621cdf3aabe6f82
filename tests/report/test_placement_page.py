"""The page of `mantle place`: a real browser shows the numbers of ``mantle check``."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ruamel.yaml

from app.case import overlay
from app.case.case import Case, valid_parts
from app.case.geometries import Femur
from app.case.hips import OperatedHip
from app.cli import main
from app.foundation.errors import InputError
from app.report import placement_page, viewer
from meshes import room
from meshes.placement import Position
from tests.meshes import cad_stems

BROWSER = shutil.which("chromium-headless-shell") or shutil.which("chromium")
NEEDED = all((viewer.THREE / name).exists() for name in viewer.SCRIPTS)
MOST_BYTES = 6_000_000
FIRST_PICTURE = 2000.0  # ms
PHONE = "390,844"
CASE = """\
base: stance
geometry:
  stem: {length: 110 mm}
  cement_thickness: 3 mm
  tip_z: -81 mm
  insertion: {depth: 1 mm, varus: 2.5 deg, version: {angle: 5 deg}}
"""


CAD_CASE = """\
base: stance
geometry:
  stem: {step: short.step}
  cement_thickness: 2 mm
  tip_z: -72 mm
  canal_widening: 1 mm
  insertion: {depth: 1 mm, varus: 1 deg, version: {angle: 5 deg}, medial_offset: 0.5 mm}
mesh: {size: 8 mm}
"""


def read(folder: Path) -> tuple[Case, Path]:
    """The case of a stem that does not fit."""
    source = folder / "hip.yaml"
    source.write_text(CASE)
    case, faults = valid_parts(overlay.read(source).data, folder)
    assert not faults
    return case, source


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[OperatedHip, Path]:
    """The geometry and its page."""
    folder = tmp_path_factory.mktemp("place")
    case, source = read(folder)
    assert isinstance(case.geometry, OperatedHip)
    return case.geometry, placement_page.write(case, source, folder / "place.html")


def drawn(number: int) -> list[dict[str, float]]:
    """Random positions in mm and degrees."""
    rng = np.random.default_rng(7)
    low, high = np.array([[-3, -3, -3, -20, -4, -4], [12, 3, 3, 20, 4, 4]])
    keys = ("depth", "varus", "flexion", "version", "medial", "anterior")
    return [
        dict(zip(keys, map(float, row), strict=True))
        for row in rng.uniform(low, high, (number, 6)).round(3)
    ]


def expected(geometry: OperatedHip, numbers: dict[str, float]) -> list[float]:
    """Least room and the head's centre by ``mantle check --mesh`` [mm]."""
    angles = {key: float(np.radians(numbers[key])) for key in ("varus", "flexion", "version")}
    at = Position(
        numbers["depth"], **angles, medial=numbers["medial"], anterior=numbers["anterior"]
    )
    canal = room.widest_canal(geometry)
    placement = canal.cut.put(geometry.implant, at, geometry.femur.mirrored)
    fit = room.fit(canal, room.StemSurface.of(geometry.implant, placement), placement)
    implant = geometry.implant
    return [fit.least, *placement.to_model([implant.head_offset, 0.0, implant.head_height])]


TRY = """
<pre id="found"></pre><script>
(async () => {
  while (!document.documentElement.dataset.ready) await new Promise(r => setTimeout(r, 20));
  const w = window.mantlePlace, $ = id => document.getElementById(id);
  const found = POSITIONS.map(p => { const e = w.evaluate(p); return [e.least, ...e.centre]; });
  const before = { least: w.now.least, verdict: $("verdict").textContent };
  // Keyboard: a slider takes the focus, and an arrow key moves it.
  const slider = $("slider-depth");
  slider.focus();
  const focused = document.activeElement === slider;
  slider.stepUp();
  slider.dispatchEvent(new Event("input"));
  const depth = w.state.p.depth;
  const canvas = document.querySelector("#stage canvas"), seen = document.createElement("canvas");
  canvas.focus();
  canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
  [...document.querySelectorAll("#views button")].forEach(b => b.click());
  $("reset").click();
  const yaml = $("yaml").value;
  $("best").click();
  const again = [w.now.least, ($("best").click(), w.now.least)];
  Object.assign(seen, { width: canvas.width, height: canvas.height });
  const c2 = seen.getContext("2d");
  c2.drawImage(canvas, 0, 0);
  const pixels = c2.getImageData(0, 0, seen.width, seen.height).data, colours = new Set();
  for (let k = 0; k < pixels.length; k += 4)
    colours.add(pixels[k] << 16 | pixels[k + 1] << 8 | pixels[k + 2]);
  const page = document.documentElement;
  const best = { yaml: $("yaml").value, least: w.now.least, verdict: $("verdict").textContent };
  const views = document.querySelectorAll("#views button").length;
  const out = { ready: +page.dataset.ready, beyond: page.scrollWidth - innerWidth,
    colours: colours.size, found, before, focused, depth, yaml, best, again, views };
  $("found").textContent = JSON.stringify(out);
})();
</script>
"""


TRY_STANCE = """
<pre id="found"></pre><script>
(async () => {
  while (!document.documentElement.dataset.ready) await new Promise(r => setTimeout(r, 20));
  const w = window.mantlePlace, found = [];
  for (const depth of [w.state.p.depth, -3, 0, 3.5, 8, 13]) {
    document.getElementById("reset").click();
    w.change("depth", depth);
    const before = w.now.excess;
    document.getElementById("best").click();
    found.push([depth, before, w.now.excess, document.getElementById("gain").textContent]);
  }
  document.getElementById("found").textContent = JSON.stringify({ found });
})();
</script>
"""


TRY_CASE = """
<pre id="found"></pre><script>
(async () => {
  while (!document.documentElement.dataset.ready) await new Promise(r => setTimeout(r, 20));
  const { least, offset, leg, version } = window.mantlePlace.now;
  const texts = ["about", "numbers", "room", "sliders"].map(
    id => document.getElementById(id).textContent
  );
  const out = { least, offset, leg, version, texts };
  document.getElementById("found").textContent = JSON.stringify(out);
})();
</script>
"""


def tried(page: Path, test: str) -> dict[str, Any]:
    """Numbers that a browser of a phone's size, without a network, reads from a page."""
    text = page.read_text(encoding="utf-8").replace("</body>", f"{test}</body>")
    copy = page.with_name("try.html")
    copy.write_text(text, encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--use-angle=swiftshader"]
    options += ["--enable-unsafe-swiftshader", "--enable-logging=stderr"]
    options += ["--virtual-time-budget=20000", f"--window-size={PHONE}"]
    options += ["--host-resolver-rules=MAP * ~NOTFOUND", "--dump-dom", copy.as_uri()]
    done = subprocess.run([str(BROWSER), *options], capture_output=True, text=True, timeout=120)
    assert "CONSOLE" not in done.stderr, done.stderr
    match = re.search(r'<pre id="found">([^<]+)</pre>', done.stdout)
    assert match, done.stderr
    return dict(json.loads(match[1]))


@pytest.mark.skipif(not NEEDED, reason="libjs-three is missing")
def test_placement_page_is_one_small_file(written: tuple[OperatedHip, Path]) -> None:
    """The page refers to no file and no server, and contains the licence of three.js."""
    text = written[1].read_text(encoding="utf-8")
    assert len(text.encode()) < MOST_BYTES
    outside_scripts = re.sub(r"<script>.*?</script>", "", text, flags=re.S)
    assert not re.search(r"<[a-z]+[^>]*\s(src|href)=", outside_scripts)
    assert text.count("<script") == text.count("</script>")
    assert "The MIT License" in outside_scripts and "three.js authors" in outside_scripts


@pytest.mark.slow
@pytest.mark.skipif(not (BROWSER and NEEDED), reason="no browser or no libjs-three")
def test_placement_page_numbers_equal_those_of_check(
    written: tuple[OperatedHip, Path], tmp_path: Path
) -> None:
    """Random positions agree to 0.01 mm. Buttons work, and a case accepts the page's YAML."""
    geometry, page = written
    positions = drawn(6)
    shown = tried(page, TRY.replace("POSITIONS", json.dumps(positions)))
    for numbers, evaluated in zip(positions, shown["found"], strict=True):
        assert evaluated == pytest.approx(expected(geometry, numbers), abs=0.01), numbers
    assert shown["ready"] < FIRST_PICTURE
    assert shown["beyond"] <= 0  # nothing is beyond a phone's edge
    assert shown["focused"] and shown["depth"] == pytest.approx(1.5)
    assert shown["views"] == 3 and shown["colours"] > 50
    assert "cuts" in shown["before"]["verdict"] and shown["best"]["verdict"] == "The stem fits."
    assert shown["again"][0] == shown["again"][1]
    given = shown["yaml"], shown["before"]["least"]
    best = shown["best"]["yaml"], shown["best"]["least"]
    for text, least in (given, best):
        keys = ruamel.yaml.YAML(typ="safe").load(text)["insertion"]
        case = geometry.model_dump(mode="json", exclude_none=True) | {"insertion": keys}
        hip = Femur.model_validate(case)
        stem = room.StemSurface.of(hip.implant, hip.placement)
        fit = room.fit(room.widest_canal(hip), stem, hip.placement)
        assert fit.least == pytest.approx(least, abs=0.01)


@pytest.mark.slow
@pytest.mark.skipif(not (BROWSER and NEEDED), reason="no browser or no libjs-three")
def test_placement_page_best_never_has_less_room(tmp_path: Path) -> None:
    """The search starts from the position of the case at any depth.

    The page reports a search without gain.
    """
    assert main(["place", "stance", "-o", str(tmp_path / "place.html")]) == 0
    for depth, before, after, words in tried(tmp_path / "place.html", TRY_STANCE)["found"]:
        assert after >= before, depth
        assert ("The stem stays" in words) == (after == before), depth
        # A stem with 0.1 mm more than the wanted thickness is not moved.
        assert ("enough room" in words) == (after == before and before >= 0.1), depth


@pytest.mark.slow
@pytest.mark.skipif(not (BROWSER and NEEDED), reason="no browser or no libjs-three")
def test_placement_page_of_a_cad_stem_shows_the_numbers_of_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both agree to 0.1 mm and 0.1 degrees. Check prints room to 0.01 mm, the head to 0.1."""
    cad_stems.write("short", tmp_path)
    source = tmp_path / "hip.yaml"
    source.write_text(CAD_CASE)
    assert main(["place", str(source), "-o", str(tmp_path / "place.html")]) == 0
    shown = tried(tmp_path / "place.html", TRY_CASE)
    capsys.readouterr()
    assert main(["check", "--mesh", str(source)]) == 0
    text = capsys.readouterr().out
    number = r"([+-]?[0-9.]+)"
    found = re.search(rf"room around the stem: at least {number} mm", text)
    assert found, text
    assert shown["least"] == pytest.approx(float(found[1]), abs=0.1)
    head = rf"offset {number} mm .* leg length {number} mm, version {number} deg"
    found = re.search(head, text)
    assert found, text
    printed = [float(part) for part in found.groups()]
    assert [shown[key] for key in ("offset", "leg", "version")] == pytest.approx(printed, abs=0.1)


@pytest.mark.slow
@pytest.mark.skipif(not (BROWSER and NEEDED), reason="no browser or no libjs-three")
@pytest.mark.parametrize(
    ("relative", "words"),
    [
        ("neck", "The slider and the key measure version from the neck, the table from the"),
        ("condyles", "Version is measured from the condyles."),
    ],
)
def test_placement_page_names_the_line_of_version(
    relative: str, words: str, tmp_path: Path
) -> None:
    """The parametric femur has condyles."""
    source, page = tmp_path / "hip.yaml", tmp_path / "place.html"
    version = f"version: {{relative_to: {relative}, angle: 0 deg}}"
    source.write_text(f"base: stance\ngeometry: {{insertion: {{{version}}}}}\n")
    assert main(["place", str(source), "-o", str(page)]) == 0
    about, numbers, room_text, sliders = tried(page, TRY_CASE)["texts"]
    assert words in about and "from the condyles; change" in numbers
    assert room_text.startswith("Room is the distance of the stem from the widest canal")
    assert "lateral shift (−medial_offset)" in sliders and "−0.0" not in numbers


def test_placement_page_offers_other_stems_with_unit_and_collar(tmp_path: Path) -> None:
    """A case with another stem gets the values of that stem."""
    for name in ("short", "exeter"):
        cad_stems.write(name, tmp_path)
    stem = {
        "step": tmp_path / "short.step",
        "unit": "mm",
        "collar": {"thickness": "2.5 mm", "angle": "120 deg"},
    }
    this, other = placement_page.sizes(Femur.model_validate({"stem": stem}), tmp_path)
    assert this.yaml == ""
    section = ruamel.yaml.YAML(typ="safe").load(other.yaml)["stem"]
    assert section == {
        "step": "exeter.step",
        "collar": {"thickness": "2.5 mm", "angle": "120 deg"},
    }
    assert other.implant.collar_thickness == 2.5


def test_placement_page_of_a_stem_that_fits_nowhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is at the position of the file: the search has none with room."""
    source, path = tmp_path / "hip.yaml", tmp_path / "place.html"
    for insertion in ("best", "{depth: 3 mm, varus: 1 deg, best: {}}"):
        source.write_text(
            "base: stance\ngeometry:\n"
            "  stem: {length: 110 mm, half_width: 14 mm, half_depth: 11 mm, corner_radius: 5 mm,"
            " tip_half_width: 11 mm, tip_half_depth: 9 mm, tip_corner_radius: 4 mm}\n"
            f"  tip_z: -81 mm\n  insertion: {insertion}\n"
        )
        assert main(["place", str(source), "-o", str(path)]) == 0
        output = capsys.readouterr()
        assert "no position within the limits of the search" in output.err
        assert "; widen the canal (canal_widening), use a smaller or shorter stem or" in output.err
        assert "at the position as given" in output.err and output.out.strip() == str(path)
        head = json.loads(re.search(r'"position": (\{.*?\})', path.read_text("utf-8"))[1])
        assert head["varus"] == pytest.approx(0.0 if insertion == "best" else 1.0)


def test_placement_page_replaces_pages_alone(
    written: tuple[OperatedHip, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As `mantle mesh` replaces its files; a file of another kind stays."""
    case, source = read(tmp_path)
    page, text = tmp_path / "place.html", source.read_text()
    placement_page.write(case, source, page)
    page.write_text(page.read_text("utf-8").replace("<title>", "<title>old "), "utf-8")
    assert main(["place", str(source), "-o", str(page)]) == 0
    assert "<title>old " not in page.read_text("utf-8")
    shutil.copy(written[1], page)
    with pytest.raises(InputError, match=r"place\.html: is the page of another case; choose"):
        placement_page.write(case, source, page)
    assert page.read_bytes() == written[1].read_bytes()
    with pytest.raises(InputError, match=r"hip\.yaml: exists and is not a page"):
        placement_page.write(case, source, source)
    assert source.read_text() == text


def test_placement_page_refuses_a_case_without_a_stem(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["place", "blocks", "-o", str(tmp_path / "place.html")]) == InputError.exit_code
    assert "blocks has no stem to place; expected femur or patient" in capsys.readouterr().err
    page = str(tmp_path / "place.html")
    assert main(["place", "iso_7206_4", "-o", page]) == InputError.exit_code
    assert "as a pot on a test bench is; expected a stem in bone" in capsys.readouterr().err


def test_placement_page_is_linked_by_check(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "stance"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"to place the stem by eye:\n  \S+ place stance\n", text)
    assert re.search(r"to check that the stem fits:\n  \S+ check stance --mesh\n", text)
    assert "head of the stem: offset 43.0 mm (+0.0 against the intact head)" in text
