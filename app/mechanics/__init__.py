"""The discrete equations of motion and contact.

It imports `scene`, `numerics` and `forms`; `heat` and it do not know each other. Begin with
`problem` and `jumps`.
"""
