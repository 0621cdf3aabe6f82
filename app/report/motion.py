"""A film of the recorded steps of a run: an animated GIF, or MP4 if ffmpeg is installed.

A field of an interface is drawn on its inner body, seen from anterior and from medial. A field of
the bodies is drawn on their posterior half, seen from the cut. Colours and deformation have one
scale in all pictures.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from app.case.number_text import printed
from app.foundation.arrays import Bools, Ints
from app.foundation.errors import InputError
from app.plots import figures
from app.plots.surface_views import METAL, VIEWS, draw_surface
from app.report import viewer
from app.report.viewer import ShownField
from app.results.reading import Run
from app.schema.section import did_you_mean
from app.system.folders import writing
from meshes.data import exterior_facets

# Most pictures of a film.
MOST_PICTURES = 60
# Pictures per second.
RATE = 10
# Shortest duration of a film [s].
LEAST_SECONDS = 2.0
DPI = 100
# Percentile at which colours end.
CLIP = 99.5
# Largest displacement in a picture, as a fraction of the size of the model.
DEFORMED = 0.05
# Width and height of a view [inch].
VIEW = (3.6, 6.0)
FILM_FORMATS = {".gif": "an animated GIF", ".mp4": "a film in MP4"}


def write(folder: Path, path: Path, name: str = "") -> Path:
    """Write a film of a run; return it.

    Args:
        folder: The run directory.
        path: The file; its suffix is ``.gif`` or ``.mp4``.
        name: Field of the film by its name in the field file; the first of the page by default.

    Raises:
        InputError: There are no fields, the field is unknown, the suffix is not known, or ffmpeg
            is missing.
        StoppedError: The file cannot be written.
    """
    if path.suffix not in FILM_FORMATS:
        raise InputError(f"--gif {path}: expected a file whose name ends in .gif or .mp4")
    if path.suffix == ".mp4" and not FFMpegWriter.isAvailable():
        gif = path.with_suffix(".gif")
        raise InputError(f"--gif {path}: ffmpeg is not installed; expected {gif}")
    if not (folder / "fields.vtkhdf").exists():
        fault = "has no fields.vtkhdf; expected a run with output.fields: true"
        raise InputError(f"--gif: {folder} {fault}")
    run = Run(folder)
    field, triangles, views = _shown(run, name)
    seconds = max(LEAST_SECONDS, min(MOST_PICTURES, len(run.times)) / RATE)
    steps = [*range(len(run.times))][:: -(-len(run.times) // MOST_PICTURES)]
    steps = [*steps[:-1], len(run.times) - 1]
    rate = max(1, round(len(steps) / seconds))
    writer = PillowWriter(rate) if path.suffix == ".gif" else FFMpegWriter(rate)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        _draw(run, field, triangles, views, steps, writer, path)
    return path


def _shown(run: Run, name: str) -> tuple[ShownField, Ints, list[str]]:
    """Field of a film, the triangles to draw (t, 3), and the views.

    Raises:
        InputError: The run has no such field.
    """
    kinds = viewer.fields_to_show(run)
    field_by_name = {kind.name: kind for kind in kinds}
    outsides = viewer.outsides(run, curved=False)
    chosen_name = name or str(viewer.opening(run, kinds, outsides)["field"])
    if chosen_name not in field_by_name:
        hint = did_you_mean(chosen_name, [*field_by_name])
        fault = f"this run has no field '{chosen_name}'; it has {', '.join(field_by_name)}{hint}"
        raise InputError(f"--field: {fault}")
    field = field_by_name[chosen_name]
    side = viewer.side_of(run, field.contact, outsides) if field.contact else None
    if side:
        return field, outsides[side[0]], ["anterior", "medial"]
    # The half behind the middle plane, with the cut towards the viewer.
    middle = run.points[run.cells[:, :4]].mean(axis=1)[:, 1]
    lowest_y, highest_y = run.points[:, 1].min(), run.points[:, 1].max()
    plane = 0.0 if lowest_y < 0 < highest_y else 0.5 * (lowest_y + highest_y)
    facets, _ = exterior_facets(run.cells[middle < plane][:, :4])
    return field, facets, ["anterior"]


def _draw(
    run: Run,
    field: ShownField,
    triangles: Ints,
    views: list[str],
    steps: list[int],
    writer: AbstractMovieWriter,
    path: Path,
) -> None:
    """Draw the steps one after another into a file."""
    values = [field.factor * viewer.lengths(run, field.name, k)[triangles] for k in steps]
    is_on_interface: Bools = np.ones(len(triangles), dtype=bool)
    if field.contact:
        status = run.at_interface(field.contact, "status")[triangles]
        is_on_interface = np.asarray((status >= 0).all(axis=1))
    all_values = np.concatenate([v[is_on_interface].ravel() for v in values])
    lowest = 0.0 if field.contact else float(np.percentile(all_values, 100 - CLIP))
    highest = float(np.percentile(all_values, CLIP))
    colours = ScalarMappable(
        Normalize(lowest, highest if highest > lowest else lowest + 1.0), "viridis"
    )
    has_displacement = "displacement" in run.point_fields
    largest = max(np.abs(run.displacement(k)).max() for k in steps) if has_displacement else 0.0
    scale = 0.0
    if run.case.get("motions"):
        scale = 1.0
    elif largest:
        scale = _round(DEFORMED * float(np.ptp(run.points)) / float(largest))
    moments = viewer.moments_of(run)
    grey = np.array([int(METAL[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    figure = figures.new(VIEW[0] * len(views) + 1.0, VIEW[1])
    axes = figure.subplots(1, len(views), squeeze=False)[0]
    unit = f" ({printed(field.unit)})" if field.unit else ""
    extend = "max" if all_values.max() > highest * (1 + 1e-6) else "neither"
    figure.colorbar(colours, ax=[*axes], label=f"{field.label}{unit}", extend=extend, shrink=0.6)
    x, undeformed = run.points, run.points[triangles].reshape(-1, 3)
    reach = scale * largest
    deformed = f", deformation × {scale:g}" if scale not in (0.0, 1.0) else ""
    with writer.saving(figure, str(path), DPI):
        for k, of_step in zip(steps, values, strict=True):
            moved_points = x + scale * run.displacement(k) if has_displacement and scale else x
            moved_triangles = moved_points[triangles]
            triangle_colours = colours.to_rgba(of_step.mean(axis=1))[:, :3]
            triangle_colours[~is_on_interface] = grey
            for ax, view in zip(axes, views, strict=True):
                ax.clear()
                draw_surface(
                    ax, moved_triangles, moved_triangles, np.asarray(triangle_colours), None, view
                )
                across, leftward, _ = VIEWS[view]
                left_limit = undeformed[:, across].min() - reach
                right_limit = undeformed[:, across].max() + reach
                ax.set_xlim((right_limit, left_limit) if leftward else (left_limit, right_limit))
                ax.set_ylim(undeformed[:, 2].min() - reach, undeformed[:, 2].max() + reach)
                ax.set_title(f"from {view}", fontsize=9)
                ax.set_axis_off()
            moment = moments[k].replace("_", " ")
            figure.suptitle(f"{moment}{deformed}", fontsize=10)
            writer.grab_frame()


def _round(scale: float) -> float:
    """Return a scale of the deformation rounded to one digit, at least 1."""
    value = max(scale, 1.0)
    power = 10.0 ** math.floor(math.log10(value))
    return math.floor(value / power) * power
