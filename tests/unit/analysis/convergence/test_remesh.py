"""remesh: the same physics on another mesh, as if it had been made there."""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.analysis.convergence.remesh import least_elements

UNIFORM = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2)


def tapered(s):
    return tb.Section.from_stiffness(EA=1e4 + s, GA=4e3, GJ=0.8, EI=1.0 + s, mass=0.2 - 0.1 * s)


def bent(s):
    return torch.stack((s, 0 * s, 1 + s), -1)


STATIONS = tb.Stations((0.0, 0.35, 1.0), [UNIFORM, tapered(torch.tensor(0.5)), UNIFORM])
# fmt: off
BEAMS = {
    "straight": lambda n, order: tb.Beam.straight(1.0, n, UNIFORM, order=order),
    "twisted": lambda n, order: tb.Beam.straight(1.0, n, UNIFORM, twist=0.5, order=order),
    "tapered": lambda n, order: tb.Beam.straight(1.0, n, tapered, order=order),
    "table": lambda n, order: tb.Beam.straight(1.0, n, STATIONS, order=order),
    "curve": lambda n, order: tb.Beam.curve(1.0, n, UNIFORM, bent, order=order),
    "arc": lambda n, order: tb.Beam.arc(1.0, 1.0, n, tapered, order=order),
}
# fmt: on


def assert_same(one, other):
    for name in ("nodes", "frames", "elements", "length", "compliance", "mass"):
        assert_close(getattr(one, name), getattr(other, name), rtol=0, atol=1e-14)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("make", BEAMS.values(), ids=BEAMS)
def test_a_beam_is_made_again(make, order):
    """Of any elements to any others, coarser ones too: nothing is interpolated."""
    for n, given in ((4, 1), (3, 2)):
        assert_same(tb.remesh(tb.Scene(make(n, given)), 5, order=order).beam, make(5, order))


def test_places_stay():
    """What acts at half length and at three quarters acts there on a mesh of another order, and
    where it has no node there is a sentence with the number that has.
    """
    beam = tb.Beam.straight(1.0, 8, UNIFORM)
    effects = [
        tb.PointLoad(6, force=(0, 0, 1.0)),
        tb.PointMass(0.1, node=4),
        tb.TipLoad(force=(1.0, 0, 0)),
    ]
    supports = [tb.Support(0, "xyz", "xz"), tb.Support(-1, "z", "")]
    scene = tb.Scene(beam, effects, supports=supports)
    assert least_elements(scene) == 4
    fine = tb.remesh(scene, 12, order=2)
    assert [effect.node for effect in fine.effects] == [18, 12, -1]
    assert [support.node for support in fine.supports] == [0, 24]
    with pytest.raises(ValueError, match="at its node 6, where none of them ends; a multiple of 2"):
        tb.remesh(scene, 6)


def test_values_of_elements_are_those_of_their_parts():
    """Bent by its own curvature of some elements, loaded on single ones: the same equilibrium on
    twice as many, in the limit; what the loads add up to at once.
    """
    beam = tb.Beam.straight(1.0, 4, UNIFORM)
    each = torch.tensor([[0.0, 0, 1], [0, 0, 2], [0, 0, 0], [0, 1, 0]], dtype=beam.nodes.dtype)
    shape = torch.tensor([1.0, 2.0, 3.0, 4.0], dtype=beam.nodes.dtype)
    push = tb.Load(
        lambda x, R, v, w, t, k: (k[..., None] * k.new_tensor((0, 0, 0.1)), None),
        node=None, values={"k": shape}, of=(),
    )  # fmt: skip
    bent = tb.Actuation(curvature=(0, 0.3, 0), elements=range(1, 3))
    scene = tb.Scene(beam, [tb.LineLoad(force=tb.PerElement(each)), push, bent])
    assert least_elements(scene) == 4
    fine = tb.remesh(scene, 12)
    assert fine.effects[2].elements == (3, 4, 5, 6, 7, 8)
    forces = [tb.equilibrium(s, engine="eager").root.force for s in (scene, fine)]
    assert_close(*forces, rtol=0, atol=1e-6)  # equilibria balance to 1e-7 of the loads
    with pytest.raises(ValueError, match="a multiple of 4 is wanted"):
        tb.remesh(scene, 6)
    with pytest.raises(ValueError, match="Input of each element"):
        tb.remesh(tb.Scene(beam, [tb.LineLoad(force=tb.PerElement(tb.Input("u", 12)))]), 8)


@pytest.mark.parametrize("orders", [(1, 1), (1, 2), (2, 1)])
def test_values_of_nodes_lie_on_straight_lines(orders):
    """From one order to another too; 3 elements to 6."""
    given, wanted = orders
    line = 2.0 + 3.0 * torch.linspace(0, 1, 3 * given + 1)
    load = tb.Load(
        lambda x, R, v, w, t, q: (torch.stack((0 * q, 0 * q, q), -1), None),
        node=None,
        of=(),
        values={"q": line},
    )
    scene = tb.Scene(tb.Beam.straight(1.0, 3, UNIFORM, order=given), [load])
    fine = tb.remesh(scene, 6, order=wanted)
    assert_close(fine.loads[0].values["q"], 2.0 + 3.0 * torch.linspace(0, 1, 6 * wanted + 1))
    assert tb.equilibrium(fine).tip.position[2] > 0


def test_what_changed_since_is_refused():
    """A tensor that was written to, a number that a function of s reads."""
    length, size = torch.tensor(0.5), [1.0]
    written = tb.Scene(tb.Beam.straight(length, 2, UNIFORM))
    length.mul_(1.4)
    read = tb.Scene(tb.Beam.straight(1.0, 2, lambda s: tapered(size[0] * s)))
    assert tb.remesh(read, 4).beam.element_count == 4
    size[0] = 2.0
    for scene in (written, read):
        with pytest.raises(ValueError, match="have changed since it was made"):
            tb.remesh(scene, 4)


def test_given_nodes_are_divided():
    """A corner stays a corner; elements of order 2 would round it."""
    nodes = [[0.0, 0, 0], [1, 0, 0], [1, 1, 0]]
    scene = tb.Scene(tb.Beam.from_nodes(nodes, [UNIFORM] * 2))
    assert least_elements(scene) == 2
    fine = tb.remesh(scene, 6).beam
    third = fine.nodes.new_tensor((0, 1 / 3, 2 / 3, 1))
    assert_close(fine.nodes[:4, 0], third)
    assert_close(fine.nodes[3:, 1], third)
    with pytest.raises(ValueError, match="order 1 of one of order 1 is wanted"):
        tb.remesh(scene, 6, order=2)


def test_a_copy_of_a_beam_is_divided():
    """It does not know how it was made: a straight uniform one is known whole, of others elements
    are divided.
    """
    copied = tb.Scene(replace(BEAMS["straight"](4, 1)))
    assert_same(tb.remesh(copied, 3, order=2).beam, BEAMS["straight"](3, 2))
    copied = tb.Scene(replace(BEAMS["tapered"](4, 1)))
    fine = tb.remesh(copied, 8).beam
    assert_close(fine.compliance[::2], copied.beam.compliance)
    with pytest.raises(ValueError, match="a multiple of 4 is wanted"):
        tb.remesh(copied, 6)


def test_it_is_differentiable_and_linked():
    EI = torch.tensor(1.0, requires_grad=True)
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=EI, mass=0.2)
    scene = tb.remesh(tb.Scene(tb.Beam.straight(1.0, 4, section).linked()), 6)
    assert scene.beam.linked_interpolation and scene.beam.element_count == 6
    assert not tb.remesh(scene, 6, linked=False).beam.linked_interpolation
    (gradient,) = torch.autograd.grad(tb.remesh(scene, 5).beam.compliance.sum(), EI)
    assert_close(gradient, torch.tensor(-2.0))  # of 1/EI, about two axes


def test_a_structure_is_refused():
    structure = tb.Scene({"arm": BEAMS["straight"](4, 1)}, supports=[tb.Support(("arm", 0))])
    with pytest.raises(ValueError, match="a structure was given to be meshed anew"):
        tb.remesh(structure, 8)


def test_a_tendon_along_a_beam_goes_through_the_ends_of_the_new_elements():
    """A helix through 9 and 25 ends: the tip is 5e-3 of the change by the mesh from that of a
    tendon drawn on the new mesh, and five elements of order 2 are no hindrance. A tendon by numbers
    keeps its eyelets, and so does one through the first five of them.
    """

    def helix(s):
        return torch.stack((0 * s, 0.012 * torch.cos(6 * s), 0.012 * torch.sin(6 * s)), -1)

    def arm(elements):
        section = tb.Section.circle(0.006, E=2e6, nu=0.45, rho=1100.0)
        beam = tb.Beam.straight(0.25, elements, section)
        return tb.Scene(beam, [tb.Tendon.along(beam, helix, tension=0.3)])

    coarse = arm(8)
    tips = [
        tb.equilibrium(scene, engine="eager").tip.position
        for scene in (coarse, tb.remesh(coarse, 24), arm(24))
    ]
    off, moved = ((tip - tips[2]).norm() for tip in (tips[1], tips[0]))
    assert 0 < moved and off < 5e-3 * moved
    assert tb.remesh(coarse, 5, order=2).tendons[0].nodes == (0, 2, 4, 6, 8, 10)
    (rope,) = coarse.tendons
    numbered = tb.Tendon([(x.node, x.point) for x in rope.eyelets], tension=0.3)
    kept = tb.remesh(tb.Scene(coarse.beam, [numbered]), 16).tendons[0]
    assert kept.nodes == tuple(range(0, 17, 2))
    half = tb.Tendon(rope.eyelets[:5], tension=0.3)
    assert tb.remesh(tb.Scene(coarse.beam, [half]), 16).tendons[0].nodes == (0, 2, 4, 6, 8)
