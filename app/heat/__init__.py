"""The discrete equations of temperature and of curing cement.

It imports `scene`, `numerics` and `forms`; `mechanics` and it do not know each other. Begin
with `conduction`.
"""
