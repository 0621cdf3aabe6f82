"""Integer tags of names, chosen here only.

A mesher works with names; dolfinx wants one integer per cell and per facet. Regions count from 1
in the order given. A boundary is a union of *patches*, disjoint sets of facets with one tag each.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from app.arrays import Floats, Ints
from meshes.data import MeshData, exterior_facets

UNTAGGED = 0


def number(names: Iterable[str]) -> dict[str, int]:
    """Tags 1, 2, ... in the order of the names."""
    return {name: tag for tag, name in enumerate(names, start=1)}


def assemble(
    points: Floats,
    cells: Ints,
    cell_tags: npt.NDArray[np.int32],
    regions: Mapping[str, int],
    interfaces: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]],
    boundaries: Mapping[str, npt.NDArray[np.bool_]],
    exterior: tuple[Ints, Ints] | None = None,
) -> MeshData:
    """Make a ``MeshData`` from boundaries that may overlap; facets without a name are left out.

    Facets that belong to the same set of names form one patch, so ``bone_surface`` may contain
    ``gluteus_medius`` and ``top`` be the union of three ends. ``boundaries`` are masks over the
    exterior facets; ``exterior``, if known (facets, cells), saves their search.
    """
    facets, _ = exterior_facets(cells) if exterior is None else exterior
    masks = np.array([boundaries[name] for name in boundaries], dtype=bool)
    masks = masks.reshape(len(boundaries), len(facets))
    patterns, inverse = np.unique(masks.T, axis=0, return_inverse=True)
    tag_of_pattern = np.zeros(len(patterns), dtype=np.int32)
    named = np.flatnonzero(patterns.any(axis=1)) if len(boundaries) else np.zeros(0, int)
    tag_of_pattern[named] = np.arange(1, len(named) + 1)
    facet_tags = tag_of_pattern[inverse.ravel()]
    keep = facet_tags != UNTAGGED
    return MeshData(
        points=points,
        cells=cells,
        cell_tags=cell_tags.astype(np.int32),
        facets=facets[keep],
        facet_tags=facet_tags[keep],
        regions=dict(regions),
        boundaries={
            name: tuple(int(t) for t in tag_of_pattern[named[patterns[named, i]]])
            for i, name in enumerate(boundaries)
        },
        interfaces=dict(interfaces),
    )
