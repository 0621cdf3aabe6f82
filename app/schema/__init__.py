"""The case: from YAML to frozen data that are valid, without the solver stack.

It imports `mantle.errors` and the small shapes of `mantle.meshes`. Begin with `config`.
"""
