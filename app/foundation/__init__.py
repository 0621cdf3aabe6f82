"""Modules that every package may import: errors, array types, files, output of libraries.

It imports nothing of the program. Begin with `errors`.
"""
