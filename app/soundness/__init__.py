"""Checks that a case can be solved, and explanations of failed solves.

The package imports everything from `heat` and `mechanics` down. Begin with `well_posedness`.
"""
