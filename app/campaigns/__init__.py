"""Many runs: sweeps, studies and the engine under them.

It imports everything from `simulation` down. Begin with `batch`.
"""
