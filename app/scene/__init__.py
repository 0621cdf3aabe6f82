"""Terms of a case and the bodies they act on. Only here a case is translated into terms.

It imports `schema`, `numerics` and `forms`. Begin with `build`.
"""
