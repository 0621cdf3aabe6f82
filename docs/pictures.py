"""Draw pictures of the manual: ``./mantle shell -c 'python3 docs/pictures.py'``.

The reference body beside its image, and the study of the stance from the numbers in
``study_stance.json``. ``python3 docs/pictures.py FOLDER`` takes those from a study first.
"""

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch

from app import extensions  # noqa: F401  (registers keys that cases have)
from app.campaigns import study, study_picture
from app.campaigns.runs import Result
from app.campaigns.study_results import Report
from app.case import study as study_file
from app.case import summary_numbers
from app.case.case import load_case
from app.foundation.arrays import Floats, Ints
from app.plots import figures, sections
from app.plots.figures import PNG
from meshes import reference_body, swept
from meshes.layered_surfaces import LayeredSurfaces

DOCS = Path(__file__).resolve().parent
STANCE = DOCS.parent / "configs/studies/stance.yaml"
NUMBERS = DOCS / "study_stance.json"
CACHED = ("mesh", "compile", "error")  # phases that a study does not count
TETS = np.array([(0, 1, 2, 5), (0, 1, 4, 5), (0, 3, 4, 5)])  # of a prism with sorted corners
SIDES = {4: [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]}
SIDES[6] = [(0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)]
# Directions to the viewer and to the light.
EYE = np.array([0.42, 0.8, 0.42])
LIGHT = np.array([0.1, 0.75, 0.65])
RIGHT = np.array([-EYE[1], EYE[0], 0.0]) / np.hypot(*EYE[:2])
SCREEN = np.stack([RIGHT, np.cross(EYE, RIGHT) / np.linalg.norm(EYE)], axis=1)


def draw(ax: Any, title: str, x: Floats, cells: Ints, tets: Ints, colours: Floats) -> None:
    """Draw what the plane y = 0 leaves of prisms or tetrahedra: outside and section."""
    faces = [(c, nodes) for side in SIDES[cells.shape[1]] for c, nodes in enumerate(cells[:, side])]
    times = Counter(frozenset(nodes.tolist()) for _, nodes in faces)
    seen = []
    for cell, nodes in faces:
        normal = np.cross(x[nodes[1]] - x[nodes[0]], x[nodes[2]] - x[nodes[0]])
        normal *= np.sign(normal @ (x[nodes[0]] - x[cells[cell]].mean(axis=0)))
        if times[frozenset(nodes.tolist())] == 1 and normal @ EYE > 0 and x[nodes, 1].min() < -1e-6:
            lit = 0.55 + 0.45 * max(0.0, normal @ LIGHT / np.linalg.norm(normal))
            flat = np.minimum(x[nodes], [np.inf, 0.0, np.inf]) @ SCREEN
            seen.append((x[nodes].mean(axis=0) @ EYE, flat, colours[cell] * lit))
    _, flats, lights = zip(*sorted(seen, key=lambda face: float(face[0])), strict=True)
    ax.add_collection(PolyCollection(flats, facecolors=lights, edgecolors="k", linewidths=0.25))
    of = np.repeat(np.arange(len(cells)), len(tets) // len(cells))
    polygons = [
        (corners, of[of_face]) for corners, of_face in sections.cut_tetrahedra(x, tets, 1, 0.0)
    ]
    for flat, of_face in polygons:
        ax.add_collection(
            PolyCollection(list(flat @ SCREEN), color=colours[of_face], linewidths=0.3)
        )
    edges = list(sections.outlines(polygons)[0] @ SCREEN)
    ax.add_collection(LineCollection(edges, colors="k", linewidths=0.3))
    ax.autoscale_view()
    ax.set(aspect="equal", frame_on=False, xticks=[], yticks=[], title=title)


def reference_body_and_image() -> None:
    """Draw ``reference_body.png``."""
    case = load_case(DOCS.parent / "configs" / "stance.yaml").config
    surfaces = LayeredSurfaces(case.geometry, case.mesh)
    body = reference_body.make(surfaces.outline(), surfaces.through, surfaces.segments)
    image = swept.meshed_layers(surfaces, curved=False)
    column, z = body.section, image.nodes.x[:, 2]
    levels = np.linspace(z.min(), z.max(), int(body.slab.max()) + 2)  # equidistant stations
    x = np.column_stack([np.tile(column, (len(levels), 1)), np.repeat(levels, len(column))])
    prisms = np.sort(body.columns, axis=1) + len(column) * body.slab[:, None]
    prisms = np.hstack([prisms, prisms + len(column)])
    colours = sections.colours_of(body.names)
    rgb = np.array([to_rgb(colours[name]) for name in body.names])
    figure = figures.new(7.5, 8.5)
    left, right = figure.subplots(1, 2, sharey=True)
    draw(
        left, "reference body, by gmsh", x, prisms, prisms[:, TETS].reshape(-1, 4), rgb[body.region]
    )
    draw(right, "its image by the map", image.nodes.x, image.cells, image.cells, rgb[image.region])
    handles = [Patch(facecolor=c, edgecolor="k", label=n) for n, c in colours.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    figures.save_figure(figure, DOCS / "reference_body.png", 110, PNG)


def store(folder: Path) -> None:
    """Keep the numbers of the study of the stance in a folder.

    The time of a run on one rank is its CPU time: another program may have run beside it.
    """
    record = json.loads((folder / "study.json").read_text(encoding="utf-8"))
    wanted, planned, _ = study_file.read(STANCE)
    runs, kept = [*record["runs"], *record["reference_runs"]], {}
    for plan, run in zip(planned, runs, strict=True):
        path = folder / "runs" / Path(run["folder"]).name / "summary.json"
        summary = json.loads(path.read_text(encoding="utf-8"))
        values = {q: summary_numbers.read(summary, q) for q in wanted.quantities}
        cpu = {phase: time for phase, time in summary["cpu"].items() if phase not in CACHED}
        kept[plan.name] = {q: float(f"{v:.6g}") for q, v in values.items() if v is not None}
        kept[plan.name]["cpu"] = round(sum(cpu.values()), 2)
    NUMBERS.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


def stance() -> Report:
    """The study of the stance, from the numbers that are kept."""
    wanted, planned, _ = study_file.read(STANCE)
    kept, runs = json.loads(NUMBERS.read_text(encoding="utf-8")), []
    for plan in planned:
        values = kept[plan.name]
        summary: dict[str, Any] = {"timing": {"total": values["cpu"]}, "stem": {}, "interfaces": {}}
        for name in wanted.quantities:
            owner, _, key = name.partition(".")
            part = summary if owner == "stem" else summary["interfaces"]
            part.setdefault(owner, {})[key] = values[name]
        runs.append(study._study_run(Result(plan, DOCS, 0, values["cpu"], summary, "")))
    return study.report_of_runs(wanted, runs)


def main() -> None:
    """Draw all pictures."""
    if sys.argv[1:]:
        store(Path(sys.argv[1]))
    reference_body_and_image()
    (picture,) = study_picture.draw(stance(), DOCS)
    (DOCS / picture).replace(DOCS / "study_stance.png")


if __name__ == "__main__":
    main()
