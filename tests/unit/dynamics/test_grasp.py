"""Steps in which fingers close on a ball: contacts begin, stick and slip within one of them."""

import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.extend import quaternions as quat

X = torch.tensor([1.0, 0.0, 0.0])
RADIUS, BALL, LENGTH, HEIGHT = 0.005, 0.025, 0.11, 0.11  # m
LAW = dict(thickness=1e-3, damping=2e-3, friction=0.5, slip_speed=0.02)
STEP = 0.02


def grasp(mass):
    """Two fingers on a hub, with a tendon along the inside of each, about a ball on a table."""
    section = tb.Section.circle(RADIUS, 2e7, 0.4, 1100.0)
    parts = {"hub": tb.Body(0.3, 1e-4, position=(0, 0, HEIGHT))}
    joints, effects = [], [tb.Gravity((0, 0, -9.81)), tb.Damping(2e-3)]
    for name, out in (("left", -X), ("right", X)):
        root = (BALL + RADIUS + 0.004) * out + torch.tensor([0.0, 0, HEIGHT])
        parts[name] = beam = tb.Beam.straight(LENGTH, 4, section, (0, 0, -1), X, root=root)
        inside = quat.matrix(beam.frames[0]).mT @ (-0.007 * out)
        joints.append(tb.Weld("hub", (name, 0)))
        effects.append(tb.Tendon.along(beam, inside, name, tension=tb.Input("pull", 1)))
        effects.append(
            tb.Contact(name, "ball", radius=RADIUS, other_radius=BALL, force=20.0, **LAW)
        )
    inertia = 0.4 * mass[:, None, None] * BALL**2 * torch.eye(3)
    parts["ball"] = tb.Body(mass, inertia, position=(0, 0, BALL - 3e-4))
    table = tb.Plane((0, 0, 0), (0, 0, 1.0))
    effects.append(tb.Contact("ball", table, radius=BALL, force=5.0, **LAW))
    support = tb.Support("hub", position="xyz", rotation="xyz")
    return tb.Scene(parts, effects, joints=joints, supports=[support], plane="xz")


def test_whole_steps_close_the_hand():
    """20 ms each, as the tendons tighten, and none is made in parts: fifteen iterations a step in
    the mean. The step that takes most takes as many eagerly, to the same state.
    """
    scene = grasp(torch.linspace(0.04, 0.06, 4))
    stepper = tb.Stepper(scene, STEP, engine="compiled", halvings=0)
    state, counts, steps = stepper.rest(), [], []
    for k in range(20):
        inputs = {"pull": torch.full((4, 1), 12.0 * min(1.0, k * STEP / 0.2))}
        before, state = state, stepper(state, inputs=inputs)
        assert (state.status == 0).all()
        counts.append(stepper.iterations)
        steps.append((before, inputs, state))
    counts = torch.stack(counts)
    assert counts.max() < 50 and counts.double().mean() < 16
    hardest = int(counts.amax(1).argmax())
    before, inputs, native = steps[hardest]
    stepper = tb.Stepper(scene, STEP, engine="eager", halvings=0)
    eager = stepper(before, inputs=inputs)
    assert_close(counts[hardest], stepper.iterations, rtol=0, atol=0)
    assert_close(native.position, eager.position, rtol=0, atol=1e-10)
    assert_close(native.velocity, eager.velocity, rtol=0, atol=1e-7)  # which a step divides
