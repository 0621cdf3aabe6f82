"""Pictures: curves, maps in the plane, sections and surfaces of a mesh, in one style.

Only this package knows the style of pictures: colours, markers, fonts, sizes, files.
"""
