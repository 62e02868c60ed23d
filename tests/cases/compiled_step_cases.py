"""A beam with everything on it, and states of scenes in motion."""

from dataclasses import replace

import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.state.supported_nodes import set_node

STIFFNESS = dict(EA=2e3, GA=(8e2, 6e2), GJ=2.0, EI=(3.0, 2.0), mass=0.5, inertia=(1e-3, 2e-3))


def section(**more):
    return tb.Section.from_stiffness(**{**STIFFNESS, **more})


def straight(N=3, of=None, **more):
    return tb.Beam.straight(1.0, N, section() if of is None else of, **more)


def pull(position, rotation, velocity, spin, t, **_):
    return -3.0 * position * torch.sin(t) - 0.2 * velocity, 0.01 * torch.linalg.cross(
        rotation[..., 0], spin
    )


def everything(plane=None):
    """A scene with all kinds of effects at once."""
    effects = [
        tb.Gravity((0, 0, -9.81)), tb.TipLoad(force=tb.Input("u", 3)),
        tb.PointMass(0.2, offset=(0.05, 0, 0.02)), tb.LineLoad(force=(0, 0, 0.3)),
        tb.PointLoad(node=1, force=lambda t: torch.stack((t, 0 * t, torch.sin(9 * t)))),
        tb.Spring(2, 50.0, (0.3, 0.0, 0.4), length=0.1, damping=0.3), tb.MassDamping(0.3),
        tb.Drag(1000.0, 0.02, tangential=0.01, added_mass=1.0), tb.Damping(0.01),
        tb.Actuation(curvature=(0, 0.2, 0)), tb.TipLoad(force=(0, 0, 0.4), follower=True),
        tb.Load(pull, node=3),
    ]  # fmt: skip
    return tb.Scene(straight(4), effects, plane=plane)


def moving(scene, batch=(), size=1.0, seed=3):
    """A state of a scene in motion: undeformed, with random velocities that its supports allow, in
    its plane.
    """
    torch.manual_seed(seed)
    stepper = tb.Stepper(scene, 0.01)
    space, constraints = stepper.model.space, stepper.model.constraints
    start = space.to_reduced(stepper.rest(batch))
    velocity, spin = (size * torch.randn_like(x) for x in (start.velocity, start.spin))
    for at, axis in constraints.hinges:
        spin = set_node(
            spin, at, space.of_nodes(at).about(start.rotation[..., at, :], spin[..., at, :], axis)
        )
    return space.to_public(
        replace(
            start,
            velocity=constraints.slide * velocity,
            spin=constraints.turn * spin,
            stress=0.1 * torch.randn_like(start.stress),
        )
    )


def inputs_of(scene, batch=()):
    torch.manual_seed(5)
    return {name: 0.3 * torch.randn(*batch, size) for name, size in scene.inputs.items()}


def same_fields(fields, found, wanted, tolerance=1e-12):
    """Each field to `tolerance` of its largest number."""
    for name in fields:
        x, y = getattr(found, name), getattr(wanted, name)
        if y is None:
            assert x is None, name
            continue
        assert_close(
            x,
            y,
            rtol=0,
            atol=tolerance * max(float(y.abs().nan_to_num().max()) if y.numel() else 0, 1e-3),
            equal_nan=True,
            msg=lambda text, name=name: f"{name}: {text}",
        )
    assert_close(found.status, wanted.status)
