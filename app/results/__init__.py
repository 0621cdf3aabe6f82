"""Numbers, fields, errors and files of a run.

It imports everything from `stepping` down. Begin with `quantities` and `output`.
"""
