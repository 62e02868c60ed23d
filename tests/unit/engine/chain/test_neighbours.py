"""Places that are near each other along a beam are left out of the list of pairs as long as its
bending keeps them apart, and no longer.
"""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.engine.chain.neighbours import neighbours
from torchbeam.nodal.discretise import discretise

R = 0.005
SECTION = tb.Section.circle(R, E=1e6, nu=0.35, rho=1200.0)
LAW = dict(radius=R, thickness=2e-3, force=50.0)
STEP = dict(step=1e-3, tolerance=1e-11)


def rod(curled=0.0, elements=12, **given):
    """Straight, or as an arc of so many radians, of 1 over the rod's length."""
    beam = tb.Beam.straight(0.15, elements, SECTION)
    if curled:
        s = torch.linspace(0, 0.15, elements + 1)
        r = 0.15 / curled
        nodes = (r * torch.sin(s / r), 0 * s, r * (1 - torch.cos(s / r)))
        beam = tb.Beam.from_nodes(torch.stack(nodes, -1), SECTION)
    return tb.Scene(beam, [tb.SelfContact(**LAW | given)], supports=[])


def closing(curled, speed):
    """Of an arc, whose ends come together."""
    scene = rod(curled)
    start = tb.rest(scene)
    x = start.position
    return scene, replace(start, velocity=speed * (x.mean(0) - x) * torch.tensor([1.0, 0, 0]) / R)


def test_a_rod_that_closes_touches_itself_as_by_eager_steps():
    """Its list holds no pair before, and some as it does; steps in which it does are not lost."""
    scene, start = closing(5.6, 0.05)
    runs = {}
    for engine in ("eager", "compiled"):
        runs[engine] = tb.simulate(
            scene, torch.linspace(0, 0.02, 5), initial=start, engine=engine, **STEP
        )
    eager, native = runs.values()
    assert (eager.status == 0).all()
    gap = tb.sensors.ContactGap(scene)(native.state)
    assert gap[0] > LAW["thickness"]
    assert (gap < LAW["thickness"]).any()
    assert_close(native.nodes, eager.nodes, rtol=0, atol=1e-10)
    assert_close(native.state.velocity, eager.state.velocity, rtol=0, atol=1e-8)
    assert torch.equal(native.stats.iterations, eager.stats.iterations)


def test_what_bends_by_little_has_no_pairs():
    scene = rod()
    stepper, state = tb.Stepper(scene, 1e-3, engine="compiled"), tb.rest(scene)
    state = replace(state, velocity=torch.sin(30 * state.position[:, :1]) * torch.eye(3)[2])
    for _ in range(5):
        state = stepper(state)
    assert {near for _, near in stepper.compiled._steps} == {(((), ()),)}


@pytest.mark.parametrize("curled", [1.0, 4.0])
def test_no_two_neighbours_are_nearer_than_it_is_said(curled):
    """However a rod is bent: where `nearer` is false, no allowed pair that was left out has a gap
    where forces begin.
    """
    scene = rod(curled)
    touching = discretise(scene).touching.each[0]
    position = tb.rest(scene).position
    along, far = neighbours(touching, position)
    assert far.any()
    assert not along.nearer(position.expand(2, -1, -1))
    torch.manual_seed(0)
    bends = torch.rand(300, 13, 1).sub(0.5).cumsum(1) * 3
    bends = bends + torch.linspace(-1, 1, 300)[:, None, None] * torch.linspace(0, 12, 13)[:, None]
    turns = (bends[:, 1:] + bends[:, :-1]) / 2
    steps = torch.cat((torch.cos(turns), 0 * turns, torch.sin(turns)), -1) * 0.15 / 12
    bent = torch.cat((torch.zeros(300, 1, 3), steps.cumsum(1)), 1)
    nearer = torch.stack([along.nearer(x.expand(2, -1, -1))[0] for x in bent])
    assert nearer.any()
    assert not nearer.all()
    pairs = touching.chosen(far & (touching.allowed > 0))
    motion = tb.nodal.touching_motion.TouchingMotion(bent, None, None, None, None, dict)
    gaps = touching._between(motion, pairs)
    assert (gaps[~nearer] > 0).all()
    assert (gaps[nearer] < 0).any()
