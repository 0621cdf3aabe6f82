"""Laws, loads, supports, materials and heat conditions.

Each is one class with its keys and its formula.
"""
