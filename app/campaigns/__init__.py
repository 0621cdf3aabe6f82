"""Many runs: sweeps, studies and the scheduler under them.

It imports everything from `simulation` down. Begin with `batch`.
"""
