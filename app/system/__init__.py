"""The machine: ranks, signals, folders and locks, caches, BLAS.

It imports `mantle.errors` alone, and knows nothing of cases. Begin with `ranks` and `folders`.
"""
