"""Newton's method, Krylov methods, sparse blocks, time integration: no physics.

It imports `mantle.errors` and `mantle.system`. Begin with `newton`.
"""
