"""Saved state of a run: attributes that objects list, in rows that do not depend on ranks.

A class names its public attributes: ``saved = ("jump", "force")``. Numbers, texts and None
are the same on all ranks. Lists, dicts and dataclasses are saved item by item, other
objects by the attributes that they list.
Arrays and functions are by contact point, node or cell: ``row_keys``, of the object or of its
owner, numbers their rows, so that any number of ranks finds them again. It is one array of keys, or
a dict or list of them for attributes and items with different keys. Keys come from the numbers of
vertices and cells in the mesh file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import basix
import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from app.foundation.arrays import Ints

Array = NDArray[Any]
# Key of rows that are not saved.
NOT_SAVED = -1
# Vertices of each node of a tetrahedron in basix's order: a vertex, or the ends of an edge.
NODE_VERTICES = np.array(
    [*((v, v) for v in range(4)), *basix.topology(basix.CellType.tetrahedron)[1]], dtype=np.int64
)


@dataclass(frozen=True)
class Rows:
    """Values (n, ...) with their keys (n,), of one rank, or of all ranks in rising order."""

    keys: Ints
    values: Array

    def of(self, keys: Ints) -> Array:
        """The rows of some keys, of a state of all ranks.

        Raises:
            ValueError: A key is missing.
        """
        if not np.isin(keys, self.keys).all():
            raise ValueError("rows are missing")
        return np.array(self.values[np.searchsorted(self.keys, keys)])


def collect(value: Any, keys: Any = None) -> Any:
    """Copy the saved attributes of an object: dicts, lists, plain values, and arrays as `Rows`.

    ``keys`` are the keys of the rows of its arrays, unless it has `row_keys`.
    """
    if isinstance(value, fem.Function):
        return _saved_rows(_values_by_node(value), keys)
    if isinstance(value, np.ndarray):
        return _saved_rows(value, keys)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {name: collect(v, _inner_keys(keys, name)) for name, v in value.items()}
    if isinstance(value, list | tuple):
        return [collect(v, _inner_keys(keys, k)) for k, v in enumerate(value)]
    attribute_names = _saved_names(value)
    if attribute_names:
        keys = getattr(value, "row_keys", keys)
        return {
            name: collect(getattr(value, name), _inner_keys(keys, name)) for name in attribute_names
        }
    return value


def restored_object(value: Any, state: Any, keys: Any = None) -> Any:
    """Fill an object from a saved state; return it or its replacement.

    Raises:
        AttributeError, LookupError, TypeError, ValueError: The state does not fit the object.
    """
    if isinstance(value, fem.Function):
        is_saved = keys != NOT_SAVED
        _values_by_node(value)[is_saved] = state.of(keys[is_saved])
        return value
    if isinstance(value, np.ndarray) or isinstance(state, Rows):
        rows = state.of(keys)
        if value is not None and rows.shape != value.shape:
            raise ValueError("rows have another shape")
        return rows
    attribute_names = _saved_names(value)
    if attribute_names:
        keys = getattr(value, "row_keys", keys)
        new_values = {
            name: restored_object(getattr(value, name), state[name], _inner_keys(keys, name))
            for name in attribute_names
        }
        if not hasattr(value, "saved"):
            return replace(value, **new_values)
        for name, v in new_values.items():
            setattr(value, name, v)
        return value
    if isinstance(state, dict):
        old_values = value or {}
        return {
            name: restored_object(old_values.get(name), v, _inner_keys(keys, name))
            for name, v in state.items()
        }
    if isinstance(state, list):
        current = [*(value or ()), *[None] * (len(state) - len(value or ()))]
        numbered_pairs = enumerate(zip(current, state, strict=True))
        new_items = [restored_object(v, f, _inner_keys(keys, k)) for k, (v, f) in numbered_pairs]
        return tuple(new_items) if isinstance(value, tuple) else new_items
    return state


def restore(value: Any) -> None:
    """Call ``restored`` of filled objects, inner ones first, to update derived values."""
    inner: Iterator[Any] = iter(())
    if isinstance(value, dict):
        inner = iter(value.values())
    elif isinstance(value, list | tuple):
        inner = iter(value)
    elif hasattr(value, "saved"):
        inner = (getattr(value, name) for name in value.saved)
    for part in inner:
        restore(part)
    if hasattr(value, "restored"):
        value.restored()


def _saved_names(value: Any) -> tuple[str, ...]:
    if is_dataclass(value) and not hasattr(value, "saved"):
        return tuple(f.name for f in fields(value))
    return getattr(value, "saved", ())


def _inner_keys(keys: Any, name: str | int) -> Any:
    if isinstance(keys, dict):
        return keys.get(name)
    return keys[int(name)] if isinstance(keys, list) else keys


def _saved_rows(values: Array, keys: Ints) -> Rows:
    assert len(values) == len(keys)
    is_saved = keys != NOT_SAVED
    return Rows(keys[is_saved], values[is_saved])


def _values_by_node(function: fem.Function) -> Array:
    """Values of a function at the nodes of this rank with ghosts (n, components)."""
    values: Array = function.x.array.reshape(-1, function.function_space.dofmap.bs)
    return values


def node_keys(space: fem.FunctionSpace) -> Ints:
    """Keys of the nodes of a space of first or second order by vertices, ghosts last (n,)."""
    geometry, index_map = space.mesh.geometry, space.dofmap.index_map
    dofs = space.dofmap.list
    vertices = geometry.input_global_indices[geometry.dofmap[:, :4]]
    end_vertices = vertices[:, NODE_VERTICES[: dofs.shape[1]]]
    stride = geometry.index_map().size_global
    keys = np.zeros(index_map.size_local + index_map.num_ghosts, dtype=np.int64)
    keys[dofs] = end_vertices.min(axis=2) * stride + end_vertices.max(axis=2)
    return keys
