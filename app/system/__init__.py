"""The machine: ranks, signals, folders and locks, caches, BLAS.

It imports `app.foundation` alone, and knows nothing of cases. Begin with `ranks` and `folders`.
"""
