"""Newton's method where surfaces stick, slip and turn within a step, which is far longer than what
the slip speed asks for.
"""

import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.scene.effects.contact_law import foretold, rubbing, telling

G, MASS = 9.81, 0.2
LAW = dict(thickness=1e-3, force=4 * MASS * G, radius=0.01, friction=0.6, damping=1e-3)
SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=MASS, inertia=1e-5)
SLOW = torch.logspace(-4, -2, 5)  # m/s, slip speeds


def on_floor(slip_speed, *effects, **options):
    """A rod on a floor."""
    law = LAW | dict(slip_speed=slip_speed)
    floor, weight = tb.Plane((0.0, 0, 0), (0.0, 0, 1.0)), tb.Gravity((0.0, 0, -G))
    beam = tb.Beam.straight(0.5, 2, SECTION, root=(0.0, 0, 0.0105))
    return tb.Scene(beam, [weight, tb.Contact(floor, **law), *effects], supports=[], **options)


def thrown(scene, velocity):
    start = tb.rest(scene)
    return replace(start, velocity=(start.velocity + velocity).expand(*start.velocity.shape))


def shaken():
    """A rod that is pushed and pulled across the floor by its tip, and thrown along it."""

    def force(t):
        push = (2 * torch.sin(60 * t), 1.5 * torch.cos(43 * t), torch.tensor(-2.0))
        return torch.stack(torch.broadcast_tensors(*push), -1)

    scene = on_floor(SLOW, tb.PointLoad(-1, force=force))
    speed = torch.linspace(-1, 1, len(SLOW))
    velocity = torch.stack((speed, 0.5 + 0 * speed, 0 * speed), -1)[:, None]
    return scene, thrown(scene, velocity)


def test_steps_converge_in_both_engines():
    """Down to a ten-thousandth of the speed, and whole: none is made in parts. The step that takes
    most iterations takes as many eagerly, to the same state.
    """
    scene, state = shaken()
    stepper = tb.Stepper(scene, 4e-3, engine="compiled", halvings=0)
    most, hardest = 0, None
    for _ in range(25):
        before, state = state, stepper(state)
        assert (state.status == 0).all()
        if (count := int(stepper.iterations.max())) > most:
            most, hardest = count, (before, state, stepper.iterations)
    assert 8 < most <= 25
    before, native, iterations = hardest
    stepper = tb.Stepper(scene, 4e-3, engine="eager", halvings=0)
    eager = stepper(before)
    assert_close(iterations, stepper.iterations, rtol=0, atol=0)
    assert_close(native.position, eager.position, rtol=0, atol=1e-12)  # rounding, over 1 m
    assert_close(native.velocity, eager.velocity, rtol=0, atol=1e-9)  # which a step divides


def on_a_peg():
    """A rope over half a turn of a peg, held at one end and pulled at the other by its weight."""
    n, radius, hang, thickness = 24, 0.1, torch.tensor(0.19), 2e-4
    s = torch.linspace(0, float(2 * hang + math.pi * radius), n + 1)
    turn = ((s - hang) / radius).clamp(0, math.pi)
    below = (hang - s).clamp(min=0) + (s - hang - math.pi * radius).clamp(min=0)
    axis = radius + 0.7 * thickness
    nodes = torch.stack((-axis * turn.cos(), 0 * s, axis * turn.sin() - below), -1)
    section = tb.Section.from_stiffness(EA=2e3, GA=2e3, GJ=1e-3, EI=4e-5, mass=0.05, inertia=1e-7)
    law = dict(thickness=thickness, force=50.0, friction=0.5, slip_speed=1e-2)
    effects = [
        tb.Contact(tb.Cylinder((0.0, 0, 0), (0.0, 1, 0), radius), **law),
        *(tb.Gravity((0, 0, -G)), tb.Damping(2e-4), tb.MassDamping(5.0)),
        tb.PointLoad(-1, force=(0.0, 0, -1.0)),
    ]
    held = [tb.Support(0, "xyz", "")]
    return tb.Scene(tb.Beam.from_nodes(nodes, section), effects, supports=held, plane="xz")


def test_a_rope_that_sticks_on_a_peg_takes_few_iterations():
    """Where it hops off and is pressed back: with tangents of friction alone, or with each step of
    Newton's method shortened that raises the merit, steps took up to 261. As many eagerly.
    """
    scene, states, counts = on_a_peg(), [], []
    engines = (tb.Stepper(scene, 1e-2, engine=name, halvings=0) for name in ("compiled", "eager"))
    native, eager = engines
    state = native.rest()
    for _ in range(10):
        states.append(state)
        state = native(state)
        assert state.status == 0
        counts.append(int(native.iterations))
    assert max(counts) <= 15
    for k in (4, 5):
        after = eager(states[k])
        assert int(eager.iterations) == counts[k]
        assert_close(after.position, states[k + 1].position, rtol=0, atol=1e-12)


@pytest.mark.parametrize("speed", (0.0, 0.4, 3.0))
def test_the_foretold_sense_is_that_of_the_slip_at_the_solution(speed):
    """There, where a sense and slip are told that belong to each other, the derivative of friction
    is its tangent; so it is where nothing is told. No sense is longer than 1.
    """
    v = torch.tensor([1.0])
    slip = speed * torch.tensor([0.6, 0.8, 0.0])
    sense = rubbing(slip, v)
    for told in (telling(slip, v, None), torch.zeros(6)):
        assert_close(foretold(slip, v, told), sense)
        by = torch.autograd.functional.jacobian(lambda x, told=told: rubbing(x, v, told), slip)
        assert_close(by, torch.autograd.functional.jacobian(lambda x: rubbing(x, v), slip))
    back = foretold(-7 * slip, v, telling(slip, v, None))
    assert torch.linalg.vector_norm(back) <= 1 + 1e-12


@pytest.mark.steps
def test_what_is_thrown_comes_to_rest_where_it_must():
    """v^2/(2 mu g) ahead, with v/(mu g) of 25 steps: the last of them, in which it stops, is not
    resolved, which leaves friction's way of one step, mu g dt^2, and the creep of what slips
    slower than the slip speed.
    """
    scene, v, dt = on_floor(slip_speed := torch.tensor([1e-5, 1e-2]), plane="xz"), 0.6, 4e-3
    start = thrown(scene, torch.tensor([v, 0.0, 0.0]))
    gap = 1e-3 * (1 - 0.25**0.5)  # of its weight at rest
    start = replace(start, position=start.position - torch.tensor([0.0, 0.0, 5e-4 - gap]))
    run = tb.simulate(scene, torch.tensor([0.0, 0.2]), step=dt, initial=start)
    mu_g = LAW["friction"] * G
    way = (run.nodes[-1] - run.nodes[0])[..., 0]
    assert ((way.T - v * v / (2 * mu_g)).abs() < mu_g * dt * dt + slip_speed * 0.2).all()


def test_a_step_that_finds_no_end_says_what_to_change():
    scene, start = shaken()
    few = dict(step=4e-3, engine="eager", iterations=2, halvings=0)
    with pytest.warns(RuntimeWarning, match="a larger slip_speed, or a smaller step, may help"):
        tb.simulate(scene, [0.0, 0.04], initial=start, **few)
