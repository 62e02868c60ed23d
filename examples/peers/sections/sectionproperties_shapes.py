"""Shapes with inner corners by sectionproperties: what tests/verification/test_cross_sections.py
compares with.

    python3 -m venv .venv-sections && .venv-sections/bin/pip install sectionproperties
    .venv-sections/bin/python examples/peers/sections/sectionproperties_shapes.py > \\
        studies/data/section_references.json

Triangles are of 0.02 % of the area, and smaller in seven rings about each inner corner, where
stresses are infinite: uniform ones of that size leave an error of 1e-3. Lengths in mm: in metres
its solver fails. E = 1, nu = 0.3. It takes some minutes.
"""

import json

from sectionproperties.analysis import Section
from sectionproperties.pre import Geometry, Material
from sectionproperties.pre.geometry import CompoundGeometry
from shapely import Point, Polygon
from shapely.ops import unary_union

PLAIN = Material(
    name="plain", elastic_modulus=1, poissons_ratio=0.3, yield_strength=1, density=1, color="w"
)
SHARE, RINGS, SHRINK, SIDES = 2e-4, 7, 0.35, 6  # of the area; rings; radii; sides of a quarter
# a name: rectangles (y, z, width, height), those cut out, inner corners, thickness
SHAPES = {
    "i_beam": (
        [(-50, -100, 100, 10), (-50, 90, 100, 10), (-3, -100, 6, 200)],
        [],
        [(-3, -90), (3, -90), (-3, 90), (3, 90)],
        6,
    ),
    "box": (
        [(-50, -30, 100, 60)],
        [(-45, -25, 90, 50)],
        [(-45, -25), (45, -25), (45, 25), (-45, 25)],
        5,
    ),
    "channel": ([(0, 0, 6, 100), (0, 0, 50, 8), (0, 92, 50, 8)], [], [(6, 8), (6, 92)], 6),
    "angle": ([(0, 0, 80, 8), (0, 0, 8, 50)], [], [(8, 8)], 8),
}


def rectangle(y, z, width, height):
    return Polygon([(y, z), (y + width, z), (y + width, z + height), (y, z + height)])


def around(corners, radius):
    return unary_union([Point(c).buffer(radius, quad_segs=SIDES) for c in corners])


def solved(parts, cut, corners, thickness):
    shape = unary_union([rectangle(*part) for part in parts])
    for part in cut:
        shape = shape.difference(rectangle(*part))
    radii = [0.4 * thickness * SHRINK**k for k in range(RINGS)]
    pieces = [(shape.difference(around(corners, radii[0])), shape.area * SHARE)]
    for k, radius in enumerate(radii):
        ring = around(corners, radius).intersection(shape)
        if k + 1 < RINGS:
            ring = ring.difference(around(corners, radii[k + 1]))
        pieces += [(piece, (0.18 * radius) ** 2) for piece in getattr(ring, "geoms", [ring])]
    whole = CompoundGeometry([Geometry(piece, material=PLAIN) for piece, _ in pieces])
    whole.create_mesh(mesh_sizes=[size for _, size in pieces])
    section = Section(whole)
    section.calculate_geometric_properties()
    section.calculate_warping_properties()
    centre = [float(x) for x in section.get_c()]
    trefftz = [float(x) - c for x, c in zip(section.get_sc_t(), centre, strict=True)]
    return {
        "nodes": len(section.mesh["vertices"]),
        "J": float(section.get_ej()),
        "shear_areas": [float(x) for x in section.get_eas()],
        "shear_centre": trefftz,  # of Trefftz, from the centroid
    }


if __name__ == "__main__":
    print(json.dumps({name: solved(*shape) for name, shape in SHAPES.items()}, indent=1))
