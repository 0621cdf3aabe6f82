"""One run from case to folder, its variations and its checkpoints.

The package imports everything from `results` down. Begin with `session`.
"""
