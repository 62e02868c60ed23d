"""Pairs that are not in a list are surely apart as long as their clearance says so, and a list goes
on for as long.
"""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.engine.chain.clearance import Clearance
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.touching_pairs import PairMotion

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
    """Nor any other list, however far it flies."""
    scene = rod()
    stepper, state = tb.Stepper(scene, 1e-3, engine="compiled"), tb.rest(scene)
    state = replace(state, velocity=torch.sin(30 * state.position[:, :1]) * torch.eye(3)[2])
    lists = set()
    for _ in range(5):
        state = stepper(state)
        lists.add(id(stepper.compiled._list))
    assert {near for _, near in stepper.compiled._steps} == {(((), ()),)}
    assert len(lists) == 1


def bodies():
    """Two beams, a ball, and a box, of which all may touch; numbers of a batch."""
    x = torch.tensor([1.0, 1.3])
    parts = {
        "a": tb.Beam.straight(0.15, 6, SECTION),
        "b": tb.Beam.straight(0.1, 5, SECTION, root=(0, 0, 0.05)),
        "ball": tb.Body(0.02, 2e-6, position=(0.0, 0.05, 0.0)),
        "box": tb.Body(
            0.02,
            2e-6,
            position=(0.05, -0.08, 0),
            surface=tb.Box((0, 0, 0), (0.02, 0.03, 0.01), rounding=0.002),
        ),
    }
    law = LAW | dict(radius=R * x)
    contacts = [
        tb.Contact("a", "b", **law),
        tb.Contact("b", "ball", other_radius=0.01, **law),
        tb.Contact("a", "box", **law),
        tb.SelfContact("a", **law, apart=8.0),
    ]
    return tb.Scene(parts, contacts, supports=[])


def nothing(touching):
    """No pair of each."""
    return [torch.zeros(len(points), len(pieces), dtype=torch.bool)
            for points, pieces in (one.nodes for one in touching.each)]  # fmt: skip


def tangled(scene, count, seed):
    """Positions (count, ..., nodes, 3), four times as far from each other as those at rest, from
    such on to some that are thrown about.
    """
    generator, rest = torch.Generator().manual_seed(seed), tb.rest(scene).position
    shape = (count, *scene.batch_shape, *rest.shape[-2:])
    size = torch.linspace(0, 0.1, count).view(-1, *[1] * (len(shape) - 1))
    return 4 * rest + size * torch.randn(shape, generator=generator)


def slack_of(touching, position):
    """The least (m) of all pairs, by themselves, of each position, see `PartContact.slack`."""
    slacks = []
    for x in position:
        motion = PairMotion(x)
        slacks.append(min(float(one.slack(motion).min()) for one in touching.each))
    return torch.tensor(slacks)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize(
    "scene", [rod(2.0), rod(2.0, radius=R * torch.tensor([1.0, 1.7])), bodies()]
)
def test_pairs_that_are_cleared_are_apart(scene, dtype):
    """Wherever nodes are on straight ways between two places: the balls about what may touch are
    told as in torch, and where `within` goes on no pair touches.
    """
    model = discretise(scene.to(dtype))
    touching, nodes = model.touching, model.node_count
    clearance, seen = Clearance(touching, nothing(touching), nodes), set()
    for x in tangled(scene, 60, 0).to(dtype):
        motion = PairMotion(x)
        least = min(
            float(torch.where(one.may_touch, one.ball_slack(motion), torch.inf).min())
            for one in touching.each
        )
        assert (clearance.within(x) == 0) == (least > 0)
        seen.add(least > 0)
    assert seen == {False, True}
    noise = 1e-3 * torch.randn(400, *x.shape, generator=torch.Generator().manual_seed(1)).cumsum(0)
    shrinking = torch.linspace(4, 0.4, 400).view(-1, *[1] * x.ndim)
    ways = (shrinking * tb.rest(scene).position + 0.1 * noise).to(dtype)
    steps = clearance.within(ways[0], ways[1:])
    assert 0 < steps < 399
    for share in torch.linspace(0, 1, 5).tolist():
        between = (1 - share) * ways[:steps] + share * ways[1 : steps + 1]
        assert (slack_of(touching, between[:: max(1, steps // 20)]) > 0).all()
    assert slack_of(touching, ways[steps + 1 :]).min() < 0


def test_what_is_near_is_left_out():
    """A list that holds all that is near is as long as the other pairs are apart."""
    scene = rod(5.6)
    model, x = discretise(scene), tb.rest(scene).position
    (one,) = model.touching.each
    motion = PairMotion(0.97 * x)
    near = one.ball_slack(motion) <= 0
    assert (near & one.may_touch).any()
    assert Clearance(model.touching, nothing(model.touching), 13).within(0.97 * x) == -1
    assert Clearance(model.touching, [near], 13).within(0.97 * x) == 0


def test_how_long_it_takes_to_meet():
    """Two balls, by the speed at which they come nearer, whatever they do across."""
    parts = {"a": tb.Body(1.0, 1e-4), "b": tb.Body(1.0, 1e-4, position=(1.0, 0, 0))}
    scene = tb.Scene(parts, [tb.Contact("a", "b", radius=0.1, thickness=0.01, force=1.0)])
    model, x = discretise(scene), tb.rest(scene).position
    clearance = Clearance(model.touching, nothing(model.touching), 2)
    velocity = torch.tensor([[0.5, 1.0, 0], [-0.5, 1.0, 0]])
    assert clearance.approach(x, velocity) == pytest.approx(1 - 0.21)
    assert clearance.approach(x, -velocity) == torch.inf


@pytest.mark.parametrize("scene", [rod(2.0, radius=R * torch.tensor([1.0, 1.7])), bodies()])
def test_places_of_all_samples_are_those_of_each(scene):
    model, x = discretise(scene), 4 * tb.rest(scene).position[0]
    whole = x.expand(*scene.batch_shape, *x.shape)
    answers = []
    for start in (x, x[None], whole):
        clearance = Clearance(model.touching, nothing(model.touching), model.node_count)
        ways = torch.stack([share * whole for share in (0.9, 0.6, 0.3, 0.1)])
        time = clearance.approach(start, -start)
        answers.append((clearance.within(start), clearance.within(start, ways), time))
    assert answers[0] == answers[1] == answers[2]
    assert answers[0][0] == 0 and answers[0][1] < 4


@pytest.mark.parametrize("lost", [slice(None), 1], ids=["all", "one"])
@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_of_places_that_are_no_numbers_nothing_is_kept(lost, value):
    """The calls behind one with such a sample are those of a stepper that has not seen it."""
    parts = {"a": tb.Body(1.0, 1e-4), "b": tb.Body(1.0, 1e-4, position=(0.3, 0, 0))}
    law = dict(radius=0.1, thickness=0.01, force=1.0)
    scene = tb.Scene(parts, [tb.Contact("a", "b", **law)], supports=[])
    start = tb.rest(scene, (2,))
    position, velocity = start.position.clone(), torch.zeros(2, 2, 3)
    position[0, 1, 2], velocity[1, 1, 0] = 5.0, -1.0
    wrong = position.clone()
    wrong[1, lost] = value
    ends = []
    for before in ([], [wrong]):
        stepper = tb.Stepper(scene, 0.01, engine="compiled")
        for x in before:
            stepper(replace(start, position=x))
        state = replace(start, position=position, velocity=velocity)
        for _ in range(20):
            state = stepper(state)
        ends.append(state)
    assert ends[0].velocity[1, 0, 0] < -0.1  # it was struck
    assert_close(ends[1].position, ends[0].position, rtol=0, atol=1e-12)
