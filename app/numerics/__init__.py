"""Newton's method, Krylov methods, sparse blocks, time integration: no physics.

It imports `app.foundation.errors` and `app.system`. Begin with `newton`.
"""
