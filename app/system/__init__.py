"""The machine: ranks, signals, folders and locks, caches, BLAS.

It imports `app.errors` alone, and knows nothing of cases. Begin with `ranks` and `folders`.
"""
