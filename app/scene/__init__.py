"""The laws of a case with their places, and the bodies they act on.

Begin with `scene.build_scene`, or `scene.scene_of` from Python.
"""
