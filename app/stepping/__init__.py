"""Through stages, load steps and time, with heat and mechanics as one system where they are.

It imports everything from `soundness` down. Begin with `stages`.
"""
