"""The discrete equations of motion and contact.

It imports `scene`, `numerics` and `forms`, never `heat`. Begin with `problem` and `contact`.
"""
