"""Many runs: sweeps, studies, fits, and the scheduler that they use.

It imports everything from `simulation` down. Begin with `batch`.
"""
