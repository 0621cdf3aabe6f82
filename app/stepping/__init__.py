"""Stages, load steps and time steps; heat and mechanics are one system if they interact.

The package imports everything from `soundness` down. Begin with `stages`.
"""
