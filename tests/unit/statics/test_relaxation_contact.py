"""Relaxation beside obstacles."""

import torch

import torchbeam as tb


def test_a_cable_that_falls_on_a_bar_hangs_over_it():
    """Its ends are held 10 mm above the bar, 0.7 m from each other, and it is 1 m long: what hangs
    between them lies on the bar, and goes not through it, however long the steps would be.
    """
    cable = tb.Section.circle(0.004, E=5e7, nu=0.4, rho=1200.0)
    beam = tb.Beam.straight(1.0, 12, cable, root=(-0.5, 0, 0.06))
    law = dict(radius=0.004, points=4, thickness=1e-3, force=100.0)
    bar = tb.Contact(tb.Cylinder((0, 0, 0), (0, 1, 0), 0.05), **law)
    ends = [tb.Support(0, rotation="xz"), tb.Support(-1, rotation="xz", displacement=(-0.3, 0, 0))]
    scene = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), bar], supports=ends, plane="xz")
    state = tb.equilibrium(scene, relax=True, engine="eager")
    over = state.position[state.position[:, 0].abs() < 0.04]
    assert len(over)
    assert (over[:, 2] > 0.03).all()
    gap = tb.sensors.ContactGap(scene)(state)
    assert 0 < gap.item() < 1e-3  # m: half of the weight on one point is 15 N/m
    weight = 1200.0 * torch.pi * 0.004**2 * 9.81
    held = (
        sum(state.reaction_of(k).force[2] for k in range(2))
        + tb.sensors.ContactForce(scene)(state)[..., 2].sum()
    )
    assert abs(held.item() / weight - 1) < 1e-6
