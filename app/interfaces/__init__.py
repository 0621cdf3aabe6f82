"""Contact points of the interfaces on a conforming mesh: their facets, faces, normals and jumps.

It imports `meshes`. Begin with `contact_points`.
"""
