"""The case: from YAML to frozen data that are valid, without the solver stack.

It imports `app.errors` and the small shapes of `meshes`. Begin with `config`.
"""
