"""Newton's method, Krylov methods, sparse blocks, time integration: no physics.

It imports `app.errors` and `app.system`. Begin with `newton`.
"""
