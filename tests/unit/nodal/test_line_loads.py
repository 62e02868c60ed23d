"""Integrals of loads along the beam: conservation, derivatives, batches, sentences."""

import math
import warnings

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.nodal.conditions import conditions
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.loads import Nodes, external
from torchbeam.nodal.mass import gregory

SECTION = tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=1.0, mass=0.2, inertia=5e-6)
F = torch.tensor([0.1, -0.2, 0.3])


def beam(order=1, elements=4, length=1.0):
    return tb.Beam.straight(length, elements, SECTION, order=order)


def along(function):
    return tb.LineLoad(force=tb.Along(lambda s, t: function(s)[..., None] * F))


def nodal(of, *loads, **options):
    """Force and moment (..., nodes, 6) of nodes, the beam at rest."""
    model = discretise(tb.Scene(of, loads, **options))
    now = conditions(model, torch.tensor(0.0), {})
    return external(model, Nodes(of.nodes, of.frames), now)


UNEVEN = torch.tensor([0, 0.19, 0.4, 0.57, 0.7, 0.9, 1.1])


@pytest.mark.parametrize("order, linked", [(1, False), (2, False), (1, True)])
def test_force_and_moment_of_powers_of_s(order, linked):
    """Of s^k, k up to 4, along lengths that differ: sum of forces L^(k+1)/(k+1), of their moments
    L^(k+2)/(k+2), to rounding; beside midside nodes off the middle from k = 3 on to 1e-7, for s is
    then itself quadratic in an element. One of k = 0 is the load that is the same everywhere.
    """
    x = torch.stack((UNEVEN, 0 * UNEVEN, 0 * UNEVEN), -1)
    of = tb.Beam.from_nodes(x, SECTION, order=order)
    of = of.linked() if linked else of
    for k in range(5):
        exact = 1e-12 if order == 1 or k < 3 else 1e-7
        force = nodal(of, along(lambda s, k=k: s**k))[:, :3]
        assert_close(force.sum(0), 1.1 ** (k + 1) / (k + 1) * F, rtol=exact, atol=0)
        moment = (UNEVEN[:, None] * force).sum(0)
        assert_close(moment, 1.1 ** (k + 2) / (k + 2) * F, rtol=exact, atol=0)
    same = nodal(of, tb.LineLoad(force=F))
    assert_close(nodal(of, along(torch.ones_like)), same, rtol=1e-12, atol=1e-16)
    each = tb.LineLoad(force=tb.PerElement(F.expand(6 // order, 3)))
    assert_close(nodal(of, each), same, rtol=1e-12, atol=1e-16)


def test_linked_elements_share_an_even_load_by_gregorys_rule():
    """Weights of the function that shares out mass."""
    of = beam(elements=8).linked()
    weights = gregory(of.length)[:, None]
    assert_close(nodal(of, along(torch.ones_like))[:, :3], weights * F, rtol=1e-12, atol=0)


@pytest.mark.parametrize("follower", [False, True])
def test_a_sample_alone_and_in_a_batch(follower):
    """Amplitudes of a batch, in equilibrium and after steps, natively: what each has alone."""
    amplitude = torch.tensor([0.5, 1.0, 2.0])

    def scene(a):
        force = tb.Along(lambda s, t: a[..., None, None] * (s >= 0.5)[..., None] * F)
        return tb.Scene(beam(), [tb.LineLoad(force=force, follower=follower)])

    whole = tb.simulate(scene(amplitude), [0.0, 0.1], step=0.02, engine="compiled")
    for k, a in enumerate(amplitude):
        alone = tb.equilibrium(scene(a)).tip.position
        assert_close(tb.equilibrium(scene(amplitude)).tip.position[k], alone, rtol=1e-9, atol=1e-12)
        alone = tb.simulate(scene(a), [0.0, 0.1], step=0.02).tip.position
        assert_close(whole.tip.position[:, k], alone, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("linked", [False, True])
def test_gradients(linked):
    """By the length, on which points and weights depend, and by a number in the function."""

    def tip(length, a):
        of = beam(length=length)
        of = of.linked() if linked else of
        return tb.equilibrium(tb.Scene(of, [along(lambda s: torch.sin(a * s))])).tip.position

    numbers = torch.tensor(1.1, requires_grad=True), torch.tensor(2.0, requires_grad=True)
    torch.autograd.gradcheck(tip, numbers, eps=1e-6, atol=1e-7, rtol=1e-5)


def warned(function, elements=4):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        tb.equilibrium(tb.Scene(beam(elements=elements), [along(function)]))
    return [str(one.message) for one in told if "jumps inside" in str(one.message)]


def test_a_jump_inside_an_element_gives_a_warning():
    """A jump at a node, a kink anywhere and a wave of one length in two elements give none; a wave
    in less than one does.
    """
    for elements in (4, 64):
        told = warned(lambda s: (s > 0.603).to(s), elements)
        assert "a node at the jump, or more elements, are wanted" in told[0]
    assert warned(lambda s: torch.sin(10 * math.pi * s)) and not warned(
        lambda s: torch.sin(10 * math.pi * s), 16
    )
    smooth = (
        lambda s: (s > 0.5).to(s),
        lambda s: (s - 0.6).abs(),
        lambda s: torch.sin(4 * math.pi * s),
        lambda s: 0 * s,
    )
    assert not any(map(warned, smooth))


def test_a_batch_without_an_axis_for_s_is_refused():
    """Factors (points,) of a `critical_load`, and rows for another mesh; with the axis it works:
    the factor is that of one load.
    """

    def column(P):
        push = tb.Along(lambda s, t: (-P * s, 0.0, 0.0))
        return tb.Scene(beam(), [tb.LineLoad(force=push)], plane="xz")

    with pytest.raises(ValueError, match="an axis for s is wanted in what is of a batch"):
        tb.critical_load(column, 50.0)
    found = tb.critical_load(lambda P: column(P[..., None]), 50.0)
    held = tb.modes(column(found.factor), count=1).frequency
    assert held < 1e-2 * tb.modes(column(torch.tensor(0.0)), count=1).frequency
    with pytest.raises(ValueError, match=r"shape \(5, 3\) was given; \(..., 16, 3\), of each of s"):
        tb.equilibrium(tb.Scene(beam(), [along(lambda s: torch.ones(5))]))


def test_numbers_of_a_function_along_the_beam_are_of_places():
    """Python's own functions and decisions want a number: the sentence says what s is."""
    for function in (lambda s: -math.sin(s), lambda s: -1.0 if s > 0.5 else 0.0):
        with pytest.raises(
            ValueError, match=r"s is a tensor of places .* torch\.sin, torch\.where"
        ):
            tb.equilibrium(tb.Scene(beam(), [along(function)]))
