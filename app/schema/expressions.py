"""Expressions for values that vary in space: arithmetic in x, y, z.

An expression such as ``-0.02 * (1 - z / 50)`` is parsed with Python's grammar and evaluated node by
node, with the operators, names and functions listed here alone.
"""

from __future__ import annotations

import ast
import warnings
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any

from app.errors import InputError
from app.schema.section import Scalar, did_you_mean, fail
from app.schema.units import NUMBER, Dimension, finite

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

COORDINATES = ("x", "y", "z")
OPERATORS = {
    ast.Add: "add",
    ast.Sub: "subtract",
    ast.Mult: "multiply",
    ast.Div: "divide",
    ast.Pow: "power",
    ast.USub: "negative",
    ast.UAdd: "positive",
}
# name in the language -> numpy function and allowed numbers of arguments
FUNCTIONS: dict[str, tuple[str, int, int]] = {
    **{name: (name, 1, 1) for name in ("sqrt", "sin", "cos", "tan", "exp", "log", "abs")},
    "min": ("minimum", 2, 9),
    "max": ("maximum", 2, 9),
    "atan2": ("arctan2", 2, 2),
    "hypot": ("hypot", 2, 2),
}
LONGEST = 1000


def parse(expression: str) -> ast.expr:
    """Parse and check an expression.

    Raises:
        ValueError: It is no valid expression; the argument names the error and what is allowed.
    """
    if len(expression) > LONGEST:
        raise ValueError(f"expression of {len(expression)} characters; at most {LONGEST}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about code that is refused below
            tree = ast.parse(expression.strip(), mode="eval").body
        _check(tree)
    except (SyntaxError, RecursionError, MemoryError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else "nested too deeply"
        raise ValueError(f"{expression!r} is not an expression in x, y, z: {reason}") from error
    return tree


def _check(node: ast.expr) -> None:
    """Refuse nodes outside the language."""
    match node:
        case ast.Constant(value=bool()):
            raise ValueError("true and false are not numbers")
        case ast.Constant(value=int() | float() as value):
            if not finite(value):
                raise ValueError("a number in the expression is too large")
        case ast.Name(id=name):
            allowed = (*COORDINATES, "pi")
            if name not in allowed:
                hint = did_you_mean(name, (*allowed, *FUNCTIONS))
                raise ValueError(f"'{name}' is not one of {', '.join(allowed)}{hint}")
        case ast.UnaryOp(op=op, operand=operand) if type(op) in OPERATORS:
            _check(operand)
        case ast.BinOp(op=op, left=left, right=right) if type(op) in OPERATORS:
            _check(left)
            _check(right)
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            if name not in FUNCTIONS:
                hint = did_you_mean(name, tuple(FUNCTIONS))
                raise ValueError(f"'{name}' is not one of {', '.join(FUNCTIONS)}{hint}")
            _, least, most = FUNCTIONS[name]
            if not least <= len(arguments) <= most:
                wanted = f"{least} to {most} arguments" if most > least else f"{least} argument(s)"
                raise ValueError(f"{name} takes {wanted}, got {len(arguments)}")
            for argument in arguments:
                _check(argument)
        case _:
            text = ast.unparse(node)
            raise ValueError(
                f"'{text[:40]}' is not allowed in an expression; allowed are numbers, x, y, z, pi, "
                f"+ - * / **, parentheses and {', '.join(FUNCTIONS)}"
            )


def evaluate(expression: str, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (n,) of an expression at points (n, 3) [mm].

    Raises:
        InputError: The expression is malformed or not finite at a point.
    """
    import numpy as np

    try:
        tree = parse(expression)
    except ValueError as error:
        raise InputError(str(error)) from error
    points = np.asarray(x, dtype=np.float64).reshape(-1, 3)
    names = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2], "pi": np.pi}
    with np.errstate(all="ignore"):
        result = np.broadcast_to(_value(tree, names), points.shape[0]).astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(result))
    if bad.size:
        place = ", ".join(f"{c:g}" for c in points[bad[0]])
        raise InputError(f"expression {expression!r} is not finite at ({place}) mm")
    return result


def _value(node: ast.expr, names: dict[str, Any]) -> Any:
    """Value of a checked node: an array (n,) or a float."""
    import numpy as np

    match node:
        case ast.Constant(value=value):
            return np.float64(value)  # type: ignore[arg-type]
        case ast.Name(id=name):
            return names[name]
        case ast.UnaryOp(op=op, operand=operand):
            return getattr(np, OPERATORS[type(op)])(_value(operand, names))  # type: ignore[index]
        case ast.BinOp(op=op, left=left, right=right):
            function = getattr(np, OPERATORS[type(op)])  # type: ignore[index]
            return function(_value(left, names), _value(right, names))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            function = getattr(np, FUNCTIONS[name][0])
            values = [_value(argument, names) for argument in arguments]
            return reduce(function, values) if len(values) > 1 else function(values[0])
    raise AssertionError("the tree was not checked")


@dataclass(frozen=True)
class Varying(Scalar):
    """Marks a field that is a dimensional value, or an expression for it in x, y, z.

    Attributes:
        constant: Dimension of a constant value.
    """

    constant: Dimension

    def read(self, value: object) -> float | str:
        """The value in the internal unit, or the checked text of an expression.

        Raises:
            PydanticCustomError: Neither.
        """
        # "0.02 mm" is a length and "0.02" one without its unit; "0.02 * x" is an expression.
        if not isinstance(value, str) or (
            (match := NUMBER.fullmatch(value))
            and (not match[2] or match[2][0].isalpha() or match[2][0] == "°")
        ):
            return self.constant.read(value)
        try:
            parse(value)
        except ValueError as error:
            kind = self.constant
            fail(
                f"{error}; expected {kind.what} such as '{kind.example}' or an expression in "
                f"x, y, z (mm) that gives {kind.unit}"
            )
        return value

    def write(self, value: float | str) -> str:
        """The value as text that reads back to the same."""
        return value if isinstance(value, str) else self.constant.write(value)

    def json_schema(self) -> dict[str, Any]:
        """Text."""
        kind = self.constant
        return {
            "type": "string",
            "description": f"{kind.what} with a unit, or an expression in x, y, z (mm) that gives "
            f"{kind.unit}",
            "examples": [kind.example, f"{kind.example.split()[0]} * (1 - z / 50)"],
            "x-value": f"{kind.in_words}, or an expression",
            "x-unit": kind.unit,
        }
