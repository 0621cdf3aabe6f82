"""Labels of points of a curve, put where they cover nothing."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from app.plots import figures

# Sides of a point where its label may stand, the best first: to the right and above is (1, 1).
SIDES = ((1, 1), (1, -1), (-1, -1), (-1, 1), (0, 1), (0, -1), (1, 0), (-1, 0))
# Horizontal alignment of a label by its side: 0, 1 or -1.
ACROSS = ("center", "left", "right")
# Vertical alignment.
ALONG = ("center", "bottom", "top")
# Distance of a label from its point [points].
APART = 5
# Half the width of a marker [pixels].
MARKER = 5.0


def label(axes: Axes, texts: Sequence[str], x: Sequence[float], y: Sequence[float], k: int) -> None:
    """Label the points of the k-th curve; `place` puts the labels where they cover nothing."""
    halo = [withStroke(linewidth=2.0, foreground="white")]
    for text, *position in zip(texts, x, y, strict=True):
        axes.annotate(
            text,
            (position[0], position[1]),
            xytext=(APART, APART),
            textcoords="offset points",
            color=figures.colour(k),
            fontsize=7,
            path_effects=halo,
            in_layout=False,
            zorder=5,
        )


def place(axes: Axes) -> None:
    """Move the labels of points to where they cover nothing; hide those without room.

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
        for side, (x, y) in enumerate(SIDES):
            point_label.set(position=(APART * x, APART * y), ha=ACROSS[x], va=ALONG[y])
            box = point_label.get_window_extent()
            outside = len(box.corners()) - axes.bbox.count_contains(box.corners())
            crossed = sum(path.intersects_bbox(box, filled=False) for path in curves)
            candidates.append((box.count_overlaps(taken_boxes) + outside, crossed, side, box))
        overlaps, _, side, box = min(candidates)
        x, y = SIDES[side]
        position = (APART * x, APART * y)
        point_label.set(position=position, ha=ACROSS[x], va=ALONG[y], visible=not overlaps)
        taken_boxes.append(box)
