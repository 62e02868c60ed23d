"""The number of samples says nothing about what they are: batches of two to seven, as many as
vectors, pairs of vectors, elements and nodes have entries, are each made of what their samples are
alone.
"""

import torch
from torch.testing import assert_close

import torchbeam as tb

N = 4


def scene(x):
    """A beam that has a number of each kind from x (B,), or one sample of it ()."""
    vector = torch.stack((0 * x, 0 * x, x), -1)
    section = tb.Section.from_stiffness(
        4e3 * x, (2e3 * x, 3e3), 0.8 * x, x, 0.2 * x, inertia=(1e-3 * x, 2e-3 * x)
    )
    effects = [
        tb.TipLoad(force=vector, moment=lambda t: 0.01 * vector[..., [0, 2, 1]]),
        tb.PointLoad(1, force=(0, 0, 0.1)),
        tb.LineLoad(force=lambda t: (0.0, 0.0, 0.1 * x)),
        tb.Gravity(-9.81 * vector),
        tb.Damping(0.01 * x),
        tb.MassDamping(0.1 * x),
        tb.Drag(x, 0.1 * x, x, 0.1 * x, flow=vector, added_mass=x),
        tb.PointMass(0.1 * x, inertia=(1e-3 * x, 2e-3 * x, 2e-3 * x), offset=0.01 * vector),
        tb.RootSpring((100 * x[..., None], 20 * x[..., None]), (0.1 * x[..., None], 0.2)),
        tb.Spring(-1, x, (1.0, 0.0, 0.3), 0.1 * x, 0.1 * x),
        tb.Actuation(curvature=0.01 * vector[..., [0, 2, 1]]),
    ]
    return tb.Scene(tb.Beam.straight(1 + 0.1 * x, N, section), effects, plane="xz")


def test_a_batch_of_any_size_is_its_samples():
    x = torch.linspace(0.8, 1.2, 7)

    def tip(some):
        stepper = tb.Stepper(scene(some), 0.05, engine="eager")
        return stepper(stepper.rest()).tip.velocity

    alone = torch.stack([tip(one) for one in x])
    for size in range(2, 8):
        assert_close(tip(x[:size]), alone[:size], rtol=1e-9, atol=1e-12)
