"""What is solved: the terms of a case and the bodies they act on. Only here choices are made.

It imports `schema`, `numerics` and `mantle.forms`. Begin with `build`.
"""
