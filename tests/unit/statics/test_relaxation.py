"""Relaxation to rest: what starts where Newton's method finds nothing."""

import importlib
import math
import warnings

import pytest
import torch
from scipy.optimize import brentq
from torch.testing import assert_close

import torchbeam as tb

G, MASS, N, SPAN = 9.81, 0.2, 6, 0.8
WEIGHT = tb.Gravity((0, 0, -G))
PINS = tb.Support(0, rotation=""), tb.Support(-1, rotation="")


def links():
    """Horizontal tension N and places (N+1, 2) m of a chain of N stiff links, 1 m in all, that
    hangs between points `SPAN` apart: H tan(slope) of a link is the weight of the links between it
    and the middle, its own half.
    """
    weight = MASS * G / N * (torch.arange(N, dtype=torch.float64) - (N - 1) / 2)
    tension = brentq(lambda H: float((H / (H**2 + weight**2).sqrt()).sum()) / N - SPAN, 1e-3, 1e3)
    way = (
        torch.stack((torch.full_like(weight, tension), weight), -1)
        / (tension**2 + weight**2).sqrt()[:, None]
        / N
    )
    return tension, torch.cat((torch.zeros(1, 2, dtype=torch.float64), way.cumsum(0)))


def inextensible(EI, shape):
    """Beam and supports of an inextensible cable: straight with its end moved nearer, or built from
    nodes on an arc below.
    """
    section = tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=EI, EI=EI, mass=MASS)
    if shape == "moved":
        near = tb.Support(-1, rotation="", displacement=torch.tensor([SPAN - 1, 0, 0]))
        return tb.Beam.straight(1.0, N, section), (PINS[0], near)
    # chords of 1/N each
    half = brentq(lambda b: math.sin(b) - SPAN * N * math.sin(b / N), 0.1, 3.0)
    angle = torch.linspace(-half, half, N + 1, dtype=torch.float64)
    arc = (
        torch.stack((angle.sin() + math.sin(half), 0 * angle, math.cos(half) - angle.cos()), -1)
        * SPAN
        / (2 * math.sin(half))
    )
    return tb.Beam.from_nodes(arc, section), PINS


@pytest.mark.parametrize("shape", ["moved", "nodes"])
def test_inextensible_cable(shape):
    """EA = GA = inf: without bending stiffness the places and the tension of a chain of stiff
    links; bending adds the order of sqrt(EI/H), 1.2e-3 m here. From straight, with the end moved
    nearer, there is no inextensible shape nearby.
    """
    tension, places = links()
    beam, supports = inextensible(1e-6, shape)
    state = tb.equilibrium(tb.Scene(beam, [WEIGHT], supports=supports, plane="xz"), relax=True)
    assert_close(state.nodes[:, [0, 2]], places, rtol=0, atol=1e-3)
    assert_close(-state.root.force[0], torch.tensor(tension), rtol=2e-3, atol=0)
    assert_close(
        state.nodes.diff(dim=0).norm(dim=-1).sum(),
        torch.tensor(float(beam.length.sum())),
        rtol=1e-8,
        atol=0,
    )


def test_a_cable_that_may_roll_about_itself():
    """In space a bent round cable with pinned ends rolls about its own axis without any work: that
    is neutral, and the shape is that in its plane.
    """
    beam, supports = inextensible(1e-3, "moved")
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)  # it is not unstable
        flat, state = (
            tb.equilibrium(tb.Scene(beam, [WEIGHT], supports=supports, plane=plane), relax=True)
            for plane in ("xz", None)
        )
    assert_close(state.position, flat.position, rtol=0, atol=1e-6)


def test_supports_too_far_apart():
    """A beam that cannot stretch between supports further apart than it is long: the reason by load
    steps.
    """
    beam, _ = inextensible(1.0, "moved")
    far = tb.Support(-1, rotation="", displacement=torch.tensor([[0.0, 0, 0.1], [0.5, 0, 0]]))
    scene = tb.Scene(beam, [WEIGHT], supports=(PINS[0], far), plane="xz")
    with pytest.raises(
        RuntimeError,
        match=r"nodes 0 and 6 1\.00499 m apart, and the beam between them, .* is 1 m long",
    ):
        tb.equilibrium(scene)


def test_arch_falls_out_of_its_plane():
    """A standing arch of a round section, clamped at both ends, with a weight at which it would
    fall sideways: loads and shape are in its plane, the damped run leaves that and ends at a
    minimum of the energy.
    """
    section = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=0.01, EI=0.01, mass=MASS)
    angle = torch.linspace(-1.1, 1.1, N + 1, dtype=torch.float64)
    beam = tb.Beam.from_nodes(
        torch.stack((angle.sin(), 0 * angle, angle.cos()), -1) * 0.45, section
    )
    scene = tb.Scene(beam, [WEIGHT], supports=(tb.Support(0), tb.Support(-1)))
    with pytest.warns(RuntimeWarning, match="unstable"):
        assert tb.equilibrium(scene).nodes[:, 1].abs().max() < 1e-12
    fallen = tb.equilibrium(scene, relax=True)
    assert fallen.nodes[:, 1].abs().max() > 0.03 and not tb.modes(scene, fallen, count=1).unstable


def hanging(N, EI, near=0.0):
    """Beam clamped at both ends, of which one is `near` m nearer to the other."""
    section = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=EI, EI=EI, mass=MASS)
    ends = tb.Support(0), tb.Support(-1, displacement=(-near, 0, 0))
    return tb.Scene(tb.Beam.straight(1.0, N, section), [WEIGHT], supports=ends, plane="xz")


@pytest.mark.parametrize(
    "EI, near, lowest, meshes", [(1e-2, 0.8, -0.413, (4, 8, 16, 64)), (1e-3, 0.5, -0.392, (4, 8))]
)
def test_a_clamped_cable_hangs_alike_on_every_mesh(EI, near, lowest, meshes):
    """Ends 1 m apart, moved nearer: the cable hangs, symmetric, by its middle. Supports that moved
    while the weight grew made it buckle: with 8 elements it stood in an arch (0.83 J above) at EI =
    0.01, with 4 no end was found at EI = 0.001.
    """
    for N in meshes:
        middle = tb.equilibrium(hanging(N, EI, near), relax=True).nodes[N // 2]
        assert_close(middle[0], torch.tensor((1 - near) / 2), rtol=0, atol=1e-6)
        assert abs(middle[2] - lowest) < 2 / N**2 + 2e-3


def test_starts_from_the_shape_that_is_given():
    """The end of a cable moved a little, and the shape that it had as `initial`, with its supports
    elsewhere than the beam was drawn: relaxation goes on from there, and leads where Newton's
    method from it does. It went back to the drawn beam, and found no end.
    """
    given = tb.equilibrium(hanging(4, 1e-3, 0.5), relax=True)
    scene = hanging(4, 1e-3, 0.52)
    relaxed = tb.equilibrium(scene, initial=given, relax=True)
    found = tb.equilibrium(scene, initial=given)
    assert_close(relaxed.nodes, found.nodes, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    "turn, near, plane",
    [((1.5, 0, 0), 0.1, None), ((0, 1.2, 0), 0.1, None), ((0, 2.5, 0), 0.3, "xz")],
)
def test_supports_that_turn_only_go_where_they_lead(turn, near, plane):
    """A beam clamped at both ends, of which one turns and comes nearer: the shape that load steps
    find. Supports were led the other way first, and no end was found.
    """
    section = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=1.0, EI=1.0, mass=0.2)
    led = tb.Support(-1, turn=turn, displacement=(-near, 0, 0))
    beam = tb.Beam.straight(1.0, 6, section)
    gravity = tb.Gravity((0, 0, -9.81))
    scene = tb.Scene(beam, [gravity], supports=(tb.Support(0), led), plane=plane)
    relaxed, stepped = (tb.equilibrium(scene, relax=relax).nodes for relax in (True, False))
    assert_close(relaxed, stepped, rtol=0, atol=1e-6)


def test_what_comes_no_further_is_given_up(monkeypatch):
    """Steps of 1e-6, as where an element folds by half a turn, which took 500 of them, a third
    without an end each (25 CPU s), to be given up.
    """
    module, count = importlib.import_module("torchbeam.statics.relaxation"), []

    def little(fluid, x, going, tolerance):
        count.append(int(going))
        longer = torch.where(torch.tensor(len(count) == 1), 1.6e-5, 1.0)
        return x, going, torch.ones_like(longer), longer

    monkeypatch.setattr(module, "advance", little)
    beam = tb.Beam.straight(1.0, 4, tb.Section.circle(radius=0.01, E=1e9, nu=0.3, rho=1e3))
    scene = tb.Scene(beam, [tb.Gravity((0, 0, -9.81))])
    assert tb.equilibrium(scene, relax=True, throw=False).status == 1
    assert len(count) == 128
