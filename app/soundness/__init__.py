"""Can this case be solved, and why was it not?

It imports everything from `heat` and `mechanics` down. Begin with `well_posedness`.
"""
