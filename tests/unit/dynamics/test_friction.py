"""Newton's method where surfaces stick, slip and turn within a step, which is far longer than what
the slip speed asks for.
"""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.solvers.newton import CLOSE, PATIENCE, next_secant

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


def test_steps_converge_by_secants_in_both_engines():
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
    assert most > PATIENCE + 2
    before, native, iterations = hardest
    stepper = tb.Stepper(scene, 4e-3, engine="eager", halvings=0)
    eager = stepper(before)
    assert_close(iterations, stepper.iterations, rtol=0, atol=0)
    assert_close(native.position, eager.position, rtol=0, atol=1e-12)  # rounding, over 1 m
    assert_close(native.velocity, eager.velocity, rtol=0, atol=1e-9)  # which a step divides


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


def test_secants_are_for_what_does_not_fall():
    """Not at first; not where a tangent makes the residual fall; not close to the solution."""
    size = torch.tensor([0.5, 0.5, 0.1, 0.5 * CLOSE])
    before, secant = torch.tensor([0.6, 0.5, 0.5, 0.4 * CLOSE]), torch.tensor([0.0, 1.0, 0.0, 1.0])
    wanted = torch.tensor([1.0, 1.0, 0.0, 0.0])
    late, early = torch.tensor(float(PATIENCE)), torch.tensor(PATIENCE - 1.0)
    assert_close(next_secant(size, before, late, secant), wanted)
    assert not next_secant(size, before, early, secant).any()


def test_a_step_that_finds_no_end_says_what_to_change():
    scene, start = shaken()
    few = dict(step=4e-3, engine="eager", iterations=2, halvings=0)
    with pytest.warns(RuntimeWarning, match="a larger slip_speed, or a smaller step, may help"):
        tb.simulate(scene, [0.0, 0.04], initial=start, **few)
