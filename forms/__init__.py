"""Weak forms and laws in UFL, one function per term, in the letters of the paper."""
