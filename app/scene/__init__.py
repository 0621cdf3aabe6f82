"""Laws of a case with the bodies and boundaries they act on.

Begin with `scene.build_scene`, or `scene.scene_of` from Python.
"""
