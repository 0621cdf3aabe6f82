"""Through stages, load steps and time, with heat and mechanics as one system if they interact.

It imports everything from `soundness` down. Begin with `stages`.
"""
