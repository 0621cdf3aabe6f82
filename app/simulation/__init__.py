"""One run from case to folder, its variations and its checkpoints.

It imports everything from `results` down. Begin with `session`.
"""
