"""Where motion of the mixed form starts by default."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.math import quaternions as quat

FRAME = tb.Frame(angular_velocity=(0, 0.5, 1.5))


@pytest.mark.parametrize("form", ["minimal", "block_rate"])
@pytest.mark.parametrize("frame", [None, FRAME])
def test_a_root_elsewhere_moves_its_own_node_alone(form, frame):
    """Displaced, turned and moving at the start: the nodes are those of the nodal form's start,
    whose other nodes are at rest in frame a (an element at rest would send a zigzag down the beam).
    """
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-4)
    root = tb.Support(
        0,
        displacement=lambda t: torch.stack((0 * t, 0.05 * torch.sin(t), 0.1 * torch.cos(t))),
        turn=lambda t: torch.stack((0 * t, 0.3 * torch.cos(2 * t), 0.2 + t)),
    )
    scene = tb.Scene(tb.Beam.straight(1.0, 3, section), supports=[root], frame=frame)
    found, start = tb.consistent_state(scene, t=0.3, form=form), tb.rest(scene, t=0.3)
    wanted = tb.simulate(scene, torch.tensor([0.3, 0.31]), step=0.01, initial=start).state[0]
    spin = quat.rotate(wanted.rotation, wanted.spin)
    nodes, axes = quat.matrix(wanted.rotation), found.rotation
    for x, y in (
        (found.position, wanted.position),
        (found.velocity, wanted.velocity),
        (found.spin, spin),
        (axes, nodes),
    ):
        assert_close(x, y, rtol=0, atol=1e-12)
