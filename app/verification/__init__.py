"""Suites with known answers: verify, stress and bench.

It imports everything from `campaigns` down; `report` is not imported. Begin with `suite`
and `problem`.
"""
