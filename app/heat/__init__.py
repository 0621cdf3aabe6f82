"""The discrete equations of temperature and of curing cement.

It imports `scene`, `numerics` and `forms`, never `mechanics`. Begin with `operators`.
"""
