"""Labels of the points of curves, placed without overlap."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from app.plots import figures

# Sides of a point where its label may stand, the best first: to the right and above is (1, 1).
LABEL_SIDES = ((1, 1), (1, -1), (-1, -1), (-1, 1), (0, 1), (0, -1), (1, 0), (-1, 0))
# Horizontal alignment of a label by its side: 0, 1 or -1.
H_ALIGN = ("center", "left", "right")
# Vertical alignment.
V_ALIGN = ("center", "bottom", "top")
# Distance of a label from its point [points].
OFFSET = 5
# Half the width of a marker [pixels].
MARKER = 5.0


def label(axes: Axes, texts: Sequence[str], x: Sequence[float], y: Sequence[float], k: int) -> None:
    """Label the points of the k-th curve; `place_labels` moves the labels apart."""
    halo = [withStroke(linewidth=2.0, foreground="white")]
    for text, x_of_point, y_of_point in zip(texts, x, y, strict=True):
        axes.annotate(
            text,
            (x_of_point, y_of_point),
            xytext=(OFFSET, OFFSET),
            textcoords="offset points",
            color=figures.colour(k),
            fontsize=7,
            path_effects=halo,
            in_layout=False,
            zorder=5,
        )


def place_labels(axes: Axes) -> None:
    """Move the labels of points so that they do not overlap; hide those without room.

    The figure has been drawn, so that its axes have their places.
    """
    curves = [line.get_transform().transform_path(line.get_path()) for line in axes.lines]
    labels = [text for text in axes.texts if isinstance(text, Annotation)]
    taken_boxes = [text.get_window_extent() for text in axes.texts if text not in labels]
    for point_label in labels:
        centre = axes.transData.transform(point_label.xy)
        taken_boxes.append(Bbox.from_extents(*(centre - MARKER), *(centre + MARKER)))
    for point_label in labels:
        candidates = []
        for side, (x, y) in enumerate(LABEL_SIDES):
            point_label.set(position=(OFFSET * x, OFFSET * y), ha=H_ALIGN[x], va=V_ALIGN[y])
            box = point_label.get_window_extent()
            outside = len(box.corners()) - axes.bbox.count_contains(box.corners())
            crossed = sum(path.intersects_bbox(box, filled=False) for path in curves)
            candidates.append((box.count_overlaps(taken_boxes) + outside, crossed, side, box))
        # Fewest overlaps, then fewest crossed curves, then the preferred side.
        overlaps, _, side, box = min(candidates)
        x, y = LABEL_SIDES[side]
        position = (OFFSET * x, OFFSET * y)
        point_label.set(position=position, ha=H_ALIGN[x], va=V_ALIGN[y], visible=not overlaps)
        taken_boxes.append(box)
