"""Expressions for values that vary in space: arithmetic in x, y, z.

An expression such as ``-0.02 * (1 - z / 50)`` is parsed with Python's grammar and evaluated node by
node, with the operators, names and functions listed here alone.
"""

from __future__ import annotations

import ast
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.schema.section import Scalar, did_you_mean, fail
from app.schema.units import LARGEST, NUMBER, Dimension

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
# Longest expression [characters].
LONGEST_EXPRESSION = 1000
# Words of Python that follow a number in a condition; they are no units.
CONDITIONS = ("if", "and", "or")
# A number, or its values at points (n,).
Value = float | Floats


def calculate(expression: str, names: Mapping[str, Value]) -> Value:
    """Value of an expression of x, y, z, pi: an array (n,) or a float.

    Raises:
        ValueError: It is no valid expression; the argument names the error and what is allowed.
    """
    if len(expression) > LONGEST_EXPRESSION:
        raise ValueError(
            f"the expression has {len(expression)} characters; "
            f"at most {LONGEST_EXPRESSION} are allowed"
        )
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # about code that is refused below
            return _value(ast.parse(expression.strip(), mode="eval").body, names)
    except (SyntaxError, RecursionError, MemoryError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else "nested too deeply"
        raise ValueError(f"{expression!r} is not an expression in x, y, z: {reason}") from error


def _value(node: ast.expr, names: Mapping[str, Value]) -> Value:
    """Value of a node; nodes outside the language are refused."""
    match node:
        case ast.Constant(value=bool()):
            raise ValueError("true and false are not numbers")
        case ast.Constant(value=int() | float() as value):
            if value > LARGEST:
                raise ValueError("a number in the expression is too large")
            return float(np.float64(value))
        case ast.Name(id=name):
            if name not in names:
                hint = did_you_mean(name, (*names, *FUNCTIONS))
                raise ValueError(f"'{name}' is not one of {', '.join(names)}{hint}")
            return names[name]
        case ast.UnaryOp(op=op, operand=operand) if type(op) in OPERATORS:
            return getattr(np, OPERATORS[type(op)])(_value(operand, names))
        case ast.BinOp(op=op, left=left, right=right) if type(op) in OPERATORS:
            function = getattr(np, OPERATORS[type(op)])
            return function(_value(left, names), _value(right, names))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            if name not in FUNCTIONS:
                hint = did_you_mean(name, tuple(FUNCTIONS))
                raise ValueError(f"'{name}' is not one of {', '.join(FUNCTIONS)}{hint}")
            function, least_arguments, most_arguments = FUNCTIONS[name]
            if not least_arguments <= len(arguments) <= most_arguments:
                expected_count = (
                    f"{least_arguments} to {most_arguments} arguments"
                    if most_arguments > least_arguments
                    else f"{least_arguments} argument(s)"
                )
                raise ValueError(f"{name} takes {expected_count}, got {len(arguments)}")
            first_value, *other_values = (_value(argument, names) for argument in arguments)
            function = getattr(np, function)
            return (
                reduce(function, other_values, first_value)
                if other_values
                else function(first_value)
            )
        case ast.IfExp() | ast.Compare() | ast.BoolOp():
            raise ValueError(
                "an expression has no conditions; a step at x = 3 mm is "
                "'max(0, min(1, 1000 * (x - 3)))'"
            )
    raise ValueError(
        f"'{ast.unparse(node)[:40]}' is not allowed in an expression; allowed are numbers, x, y, "
        f"z, pi, + - * / **, parentheses and {', '.join(FUNCTIONS)}"
    )


def values_at_points(expression: str, x: Floats) -> Floats:
    """Values (n,) of an expression at points (n, 3) [mm].

    Raises:
        InputError: The expression is malformed or not finite at a point.
    """
    points = np.asarray(x, dtype=np.float64).reshape(-1, 3)
    value_of_name: dict[str, Value] = dict(zip("xyz", points.T, strict=True))
    value_of_name["pi"] = np.pi
    try:
        values = calculate(expression, value_of_name)
    except ValueError as error:
        raise InputError(str(error)) from error
    value_at_points = np.broadcast_to(values, len(points)).astype(np.float64)
    bad_points = np.flatnonzero(~np.isfinite(value_at_points))
    if bad_points.size:
        place = ", ".join(f"{c:g}" for c in points[bad_points[0]])
        raise InputError(f"expression {expression!r} is not finite at ({place}) mm")
    return value_at_points


@dataclass(frozen=True)
class Varying(Scalar):
    """Marks a field that is a dimensional value, or an expression for it in x, y, z."""

    constant: Dimension

    def read(self, value: object) -> float | str:
        """The value in the internal unit, or the checked text of an expression.

        Raises:
            PydanticCustomError: Neither.
        """
        # "0.02 mm" is a length and "0.02" one without its unit; "0.02 * x" is an expression.
        number = NUMBER.fullmatch(value) if isinstance(value, str) else None
        unit = number[2] if number else ""
        condition = unit.split(" ")[0] in CONDITIONS
        constant = number is not None and (not unit or unit[0].isalpha() or unit[0] in "°%")
        if not isinstance(value, str) or (constant and not condition):
            return self.constant.read(value)
        try:
            calculate(value, dict.fromkeys(("x", "y", "z", "pi"), 1.0))
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

    def __get_pydantic_json_schema__(self, *_: object) -> dict[str, object]:
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
