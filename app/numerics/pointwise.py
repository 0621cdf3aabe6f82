"""UFL expressions at points that belong to no mesh: arrays in, arrays out.

A law of `forms` that holds at each point is compiled on a mesh whose cells are the points: a row of
intervals on this rank alone. Each input has one value per cell. The intervals form one row because
dolfinx takes quadratic time to order cells that do not touch.

dolfinx identifies compiled code by a signature of the whole expression. UFL has to build it at
every start, which takes seconds for the contact law at corners. A law defined in a few files is
identified by their text instead. A note next to the meshes names its compiled code.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from mpi4py import MPI

import basix.ufl
import dolfinx
import ffcx
import numpy as np
import ufl
from dolfinx import fem, jit
from dolfinx.mesh import create_mesh
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr
from ufl.corealg.map_dag import map_expr_dags
from ufl.corealg.multifunction import MultiFunction

from app.foundation import files
from app.foundation.arrays import Floats, Ints
from app.foundation.dolfinx_features import CompiledExpression
from app.system import folders, form_cache

# What is compiled: expressions by name or in order, from inputs by name.
Build = Callable[[dict[str, Expr]], Mapping[str, Expr] | Sequence[Expr]]
# Names that ffcx gives to modules.
MODULE = re.compile(r"libffcx_expressions_[0-9a-f]+")
# Names that ffcx gives to expressions.
SYMBOL = re.compile(r"expression_[0-9a-f]+")


@dataclass(frozen=True)
class Kernel:
    """Compiled code of several expressions.

    Attributes:
        module: Name of the compiled module.
        symbol: Name of the expression in it.
        inputs: Names of the coefficients, in the order of the code.
        shapes: Shapes of the expressions.
        outputs: Their names, or numbers.
    """

    module: str
    symbol: str
    inputs: tuple[str, ...]
    shapes: tuple[tuple[int, ...], ...]
    outputs: tuple[str, ...]


class Pointwise:
    """Compiled expressions of named inputs at the points of one rank; made collectively.

    Attributes:
        outputs: Names of the expressions, or their numbers.

    Args:
        comm: Communicator on which the expressions are compiled once and shared.
        n: Number of points of this rank.
        sizes: Inputs by name: 1 for a scalar, 3 for a vector.
        build: Returns the expressions, by name or in order, from the inputs by name.
        note: Path of the note of the compiled code (`note_of`); without one the expressions
            are built at every start.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        n: int,
        sizes: Mapping[str, int],
        build: Build,
        note: Path | None = None,
    ) -> None:
        cells = max(n, 1)
        self._mesh = create_mesh(
            MPI.COMM_SELF,
            np.arange(cells, dtype=np.int64)[:, None] + np.arange(2),
            x=np.arange(cells + 1, dtype=np.float64).reshape(-1, 1),
            e=ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(1,))),
        )
        self._cell_of_point = np.argsort(self._mesh.topology.original_cell_index)[:n]
        self._cell_of_point = self._cell_of_point.astype(np.int32)
        spaces = {
            size: fem.functionspace(self._mesh, ("DG", 0, (size,) if size > 1 else ()))
            for size in sorted(set(sizes.values()))
        }
        self._inputs = {name: fem.Function(spaces[size]) for name, size in sizes.items()}
        for function in self._inputs.values():
            function.x.array[:] = 1
        compiled = load_noted(comm, note)
        if compiled is None:
            compiled = self._compile(comm, build)
            _write_note(comm, note, compiled[0])
        kernel, symbol, self._module = compiled
        inputs = [self._inputs[name]._cpp_object for name in kernel.inputs]
        self._expression = CompiledExpression(self._module.ffi, symbol, inputs)
        self._shapes, self.outputs = kernel.shapes, kernel.outputs
        self._size = sum(math.prod(shape) for shape in kernel.shapes)

    def _compile(self, comm: MPI.Comm, build: Build) -> tuple[Kernel, Any, ModuleType]:
        """Compile all expressions into one kernel, which evaluates common terms once."""
        built = build(dict(self._inputs))
        if not isinstance(built, Mapping):
            built = {str(k): e for k, e in enumerate(built)}
        built = {name: ufl.as_ufl(e) for name, e in built.items()}  # some are numbers
        # The labels of variables differ from run to run; without them compiled code is used again.
        without_labels = map_expr_dags(_WithoutVariables(), list(built.values()))
        all_components = ufl.as_vector([c for e in without_labels for c in _components(e)])
        options = {"scalar_type": np.float64}
        symbol, module, _ = jit.ffcx_jit(comm, (all_components, np.array([[0.5]])), options)
        coefficients = extract_coefficients(all_components)
        name_of_function = {function: name for name, function in self._inputs.items()}
        kernel = Kernel(
            module=module.__name__,
            symbol=next(name for name in dir(module.lib) if name.startswith("expression_")),
            inputs=tuple(
                name_of_function[coefficients[symbol.original_coefficient_positions[i]]]
                for i in range(symbol.num_coefficients)
            ),
            shapes=tuple(e.ufl_shape for e in built.values()),
            outputs=tuple(built),
        )
        return kernel, symbol, module

    def set(self, rows: Ints | None = None, /, **values: Floats | float) -> None:
        """Set inputs, scalar, (n,) or (n, size), at all points or some rows; others keep theirs."""
        cells = self._cell_of_point if rows is None else self._cell_of_point[rows]
        for name, value in values.items():
            function = self._inputs[name]
            space = function.function_space
            size = space.dofmap.index_map_bs
            array = function.x.array.reshape(-1, size)
            array[space.dofmap.list[cells, 0]] = np.reshape(value, (-1, size))

    def named(self, rows: Ints | None = None, /, **values: Floats) -> dict[str, Floats]:
        """Set inputs; return the values of the expressions (n, ...) by name, as `__call__`."""
        return dict(zip(self.outputs, self(rows, **values), strict=True))

    def __call__(self, rows: Ints | None = None, /, **values: Floats) -> list[Floats]:
        """Set inputs; return the values of the expressions (n, ...) at all points or some rows."""
        self.set(rows, **values)
        cells = self._cell_of_point if rows is None else self._cell_of_point[rows]
        values_at = np.zeros((len(cells), self._size))
        if len(cells):
            self._expression.evaluate(self._mesh, cells, values_at)
        expression_values, first_column = [], 0
        for shape in self._shapes:
            after_column = first_column + math.prod(shape)
            expression_values.append(
                values_at[:, first_column:after_column].reshape(len(cells), *shape)
            )
            first_column = after_column
        return expression_values


class _WithoutVariables(MultiFunction):  # type: ignore[misc]
    """The expression inside each variable; each shared term once, unlike `strip_variables`."""

    expr = MultiFunction.reuse_if_untouched

    def variable(self, o: Expr, inner: Expr, label: Expr) -> Expr:
        """The expression inside."""
        return inner


def _components(e: Expr) -> list[Expr]:
    return [e[i] for i in np.ndindex(*e.ufl_shape)] if e.ufl_shape else [e]


def note_of(law: str, sources: Sequence[Path]) -> Path | None:
    """Path of the note of a law; None without a cache.

    Args:
        law: Key of the law among the laws of the same sources.
        sources: All files that define it.
    """
    folder = folders.cache("laws")
    if folder is None:
        return None
    digest = hashlib.sha256(law.encode())
    for file in sources:
        digest.update(file.read_bytes())
    versions = [m.__version__ for m in (dolfinx, ffcx, ufl)]
    options = {**jit.get_options(), **ffcx.get_options(), "cache_dir": None}
    digest.update(repr([versions, options]).encode())
    return folder / f"law-{digest.hexdigest()[:24]}.json"


def load_noted(comm: MPI.Comm, note: Path | None) -> tuple[Kernel, Any, ModuleType] | None:
    """Noted code of a law, its expression and module; None if missing on any rank; collective."""
    compiled = None
    errors_of_damaged_notes = (
        OSError,
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
        ImportError,
        RecursionError,
    )
    with suppress(*errors_of_damaged_notes):
        if note is not None:
            compiled = _load_kernel(json.loads(note.read_text()))
    return compiled if comm.allreduce(compiled is not None, MPI.LAND) else None


def _load_kernel(noted: dict[str, Any]) -> tuple[Kernel, Any, ModuleType] | None:
    shapes = tuple(tuple(int(k) for k in shape) for shape in noted["shapes"])
    described = tuple(noted["inputs"]), shapes, tuple(noted["outputs"])
    kernel = Kernel(noted["module"], noted["symbol"], *described)
    if not (MODULE.fullmatch(kernel.module) and SYMBOL.fullmatch(kernel.symbol)):
        return None
    folder = Path(jit.get_options()["cache_dir"])
    # ffcx writes this mark when its compiler has finished, and trusts no module without it.
    if not form_cache.usable(folder, kernel.module):
        return None
    module = form_cache.load_module(folder, kernel.module)
    return kernel, getattr(module.lib, kernel.symbol), module


def _write_note(comm: MPI.Comm, note: Path | None, kernel: Kernel) -> None:
    if note is not None and comm.rank == 0:
        with suppress(OSError):  # it is made again at the next start
            files.clear(note.parent, note.name)
            folders.write_json(note, asdict(kernel))
