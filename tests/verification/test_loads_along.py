"""Loads that are known along the beam: what their nodes bear has the force and the moment of the
integral, so that supports and section forces are those of statics, whatever the mesh.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

L, Q = 4.0, 1e4  # m, N/m
SECTION = tb.Section.from_stiffness(EA=1e9, GA=1e9, GJ=1e6, EI=1e8, mass=20.0)
HELD = [tb.Support(0, rotation="xz"), tb.Support(-1, position="yz", rotation="xz")]
MESHES = {
    "order 1": lambda beam: beam(order=1),
    "order 2": lambda beam: beam(order=2),
    "linked": lambda beam: beam(order=1).linked(),
}
# of s/L: the load by Q, its integral by Q L, and its moment about the start by Q L^2
SHAPES = {
    "right half": (lambda x: x >= 0.5, 1 / 2, 3 / 8),
    "right half without its end": (lambda x: x > 0.5, 1 / 2, 3 / 8),
    "triangle": (lambda x: x, 1 / 2, 1 / 3),
    "parabola": (lambda x: 4 * x * (1 - x), 2 / 3, 1 / 3),
    "fourth power": (lambda x: x**4, 1 / 5, 1 / 6),
}


def along(shape, axis=2):
    """-Q times a function of s/L, along one axis."""
    on = torch.eye(3)[axis]
    return tb.Along(lambda s, t: -Q * shape(s / L)[..., None] * on)


def simple_beam(mesh, elements, load):
    beam = MESHES[mesh](lambda order: tb.Beam.straight(L, elements, SECTION, order=order))
    return tb.Scene(beam, [load], supports=HELD, small=True)


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("shape", SHAPES)
def test_reactions_of_a_simple_beam(shape, mesh):
    """B = moment / L and A = force - B (statics), to rounding: of the load along a few elements,
    with a jump at a node whichever side has its value there.
    """
    function, force, moment = SHAPES[shape]
    state = tb.equilibrium(simple_beam(mesh, 4, tb.LineLoad(force=along(function))))
    reactions = torch.stack([state.reaction_of(k).force[2] for k in range(2)])
    want = Q * L * torch.tensor([force - moment, moment])
    assert_close(reactions, want, rtol=1e-12, atol=0)


@pytest.mark.parametrize("mesh", MESHES)
def test_reactions_of_moments_per_length(mesh):
    """A moment -Q along the right half, a couple -Q L/2 about y, and B at x = L, whose moment about
    y is -L B: B = -Q/2 = -A.
    """
    load = tb.LineLoad(moment=along(lambda x: x >= 0.5, axis=1))
    state = tb.equilibrium(simple_beam(mesh, 4, load))
    reactions = torch.stack([state.reaction_of(k).force[2] for k in range(2)])
    assert_close(reactions, Q / 2 * torch.tensor([1.0, -1.0]), rtol=1e-12, atol=0)


@pytest.mark.parametrize("by_element", [False, True])
@pytest.mark.parametrize("order", [1, 2])
def test_section_forces_under_a_jump(order, by_element):
    """Shear and moment by statics at all ends and middles of elements, of a load on the right half:
    A x - Q <x - L/2>^2/2 with A = Q L/8, so that the largest moment is 9/128 Q L^2, at 5/8 L.
    """
    jump = tb.PerElement([[0, 0, 0]] * 2 + [[0, 0, -Q]] * 2)
    load = tb.LineLoad(force=jump if by_element else along(lambda x: x >= 0.5))
    scene = simple_beam(f"order {order}", 4, load)
    forces = tb.sensors.SectionForces(scene)(tb.equilibrium(scene))
    x = torch.arange(4.0)[:, None] + torch.tensor([0, 0.5, 1.0])
    on = (x - L / 2).clamp(min=0)
    # the load of the part ahead on the part behind, z up
    assert_close(forces[..., 2], -(Q * L / 8 - Q * on), rtol=0, atol=1e-9 * Q * L)
    assert_close(forces[..., 4], -(Q * L / 8 * x - Q * on**2 / 2), rtol=0, atol=1e-9 * Q * L**2)
    assert_close(forces[..., 4].min(), torch.tensor(-9 / 128 * Q * L**2), rtol=1e-9, atol=0)


@pytest.mark.parametrize("order", [1, 2])
def test_a_bow_bears_the_integral_along_its_axis(order):
    """Clamp of a quarter of a circle, of order 1 a polygon, of order 2 through its midside nodes,
    under a load that is quadratic in s: force and moment of 1000 slices of each element, in which
    places are interpolated as they are in the element (midpoints of slices: 1e-6).
    """
    f, elements, radius = torch.tensor([30.0, -20.0, 50.0]), 4, 0.8
    beam = tb.Beam.arc(radius, torch.pi / 2, elements, SECTION, order=order)
    load = tb.LineLoad(force=tb.Along(lambda s, t: (s**2)[..., None] * f))
    root = tb.equilibrium(tb.Scene(beam, [load], small=True)).root
    ends, n = beam.length.cumsum(0)[order - 1 :: order], 1000
    h, places = ends.diff(prepend=ends.new_zeros(1)), beam.nodes.unfold(0, order + 1, order)
    xi = (torch.arange(n) + 0.5) * 2 / n - 1
    N = (1 - xi, 1 + xi) if order == 1 else (xi * (xi - 1), 2 - 2 * xi**2, xi * (xi + 1))
    x = places @ (torch.stack(N) / 2)  # (elements, 3, n)
    s = ends[:, None] + h[:, None] * (xi - 1) / 2
    push = (h[:, None] / n * s**2)[..., None] * f
    force, moment = push.sum((0, 1)), torch.linalg.cross(x.mT, push).sum((0, 1))
    assert_close(root.force, -force, rtol=2e-6, atol=0)
    assert_close(root.moment, -moment, rtol=2e-6, atol=2e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_a_frame_bears_a_load_on_one_of_its_beams(order):
    """A post of 3 m with a girder of 4 m welded on it, which bears a triangle: the clamp below has
    Q L/2 and Q L^2/3 of it, and nothing of it lies on the post. (All of it gives way by 1e-9.)
    """
    stiff = tb.Section.from_stiffness(EA=1e16, GA=1e16, GJ=1e16, EI=1e16, mass=20.0)
    post = tb.Beam.straight(3.0, 2, stiff, direction=(0, 0, 1.0), order=order)
    girder = tb.Beam.straight(L, 3, stiff, root=(0, 0, 3.0), order=order)
    frame = {"post": post, "girder": girder}
    load = tb.LineLoad(force=along(lambda x: x), on="girder")
    scene = tb.Scene(
        frame,
        [load],
        joints=[tb.Weld(("post", -1), ("girder", 0))],
        supports=[tb.Support(("post", 0))],
    )
    clamp = tb.equilibrium(scene).reaction_of(0)
    assert_close(clamp.force, torch.tensor([0, 0, Q * L / 2]), rtol=1e-11, atol=1e-6)
    assert_close(clamp.moment, torch.tensor([0, -Q * L**2 / 3, 0]), rtol=1e-8, atol=1e-6)


def test_linked_elements_keep_their_order_under_a_jump():
    """Tip of a cantilever with a load on its outer half (41/384 Q L^4/EI and shear 3/8 Q L^2/GA, by
    integration): fourth order in the length of elements.
    """
    want = -Q * (41 / 384 * L**4 / 1e8 + 3 / 8 * L**2 / 1e9)
    errors = []
    for elements in (4, 8, 16):
        beam = tb.Beam.straight(L, elements, SECTION).linked()
        scene = tb.Scene(beam, [tb.LineLoad(force=along(lambda x: x >= 0.5))], small=True)
        errors.append(abs(tb.equilibrium(scene).tip.position[2].item() / want - 1))
    assert errors[0] < 2e-3
    assert errors[0] > 15 * errors[1] > 220 * errors[2]
