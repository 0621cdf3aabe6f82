"""Weak forms and laws in UFL, one function per term, in the letters of the paper."""

from ufl.core.expr import Expr

# A scalar expression or a number.
Scalar = Expr | float
