"""Suites with known answers: verify, stress and bench.

It imports everything from `campaigns` down; `report` and it do not know each other. Begin with
`check` and `engine`.
"""
