"""The unknowns of a node and the strains of an element: in space, in a plane, and for small
rotations.
"""
