"""Section forces: of what statics alone tells, and of a beam on a bed by its closed form."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.math import quaternions as quat

SECTION = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=1.0, EI=1.0, mass=1.0, inertia=1e-3)


def places(beam):
    """(N, 3) m, of the start, the middle and the end of each element."""
    ends = torch.nn.functional.pad(beam.length.cumsum(-1), (1, 0))[:: beam.order]
    return torch.stack((ends[:-1], (ends[:-1] + ends[1:]) / 2, ends[1:]), -1)


@pytest.mark.parametrize("plane", [None, "xz"])
@pytest.mark.parametrize("order", [1, 2])
def test_an_even_load_bends_to_a_parabola(order, plane):
    """A cantilever of 2 m under 1 N/m: the shear force is linear, the moment quadratic, also
    between nodes.
    """
    beam = tb.Beam.straight(2.0, 5, SECTION, order=order)
    load = tb.LineLoad(force=tb.Input("snow", 3))
    scene = tb.Scene(beam, [load], small=plane is None, plane=plane)
    inputs = {"snow": torch.tensor([0, 0, -1e-6])}
    forces = tb.sensors.SectionForces(scene, inputs)(tb.equilibrium(scene, inputs=inputs))
    to_tip = 2.0 - places(beam)
    assert forces.shape == (5, 3, 6)
    assert_close(forces[..., 2], -1e-6 * to_tip, rtol=1e-6, atol=1e-14)
    assert_close(forces[..., 4], 1e-6 * to_tip**2 / 2, rtol=1e-6, atol=1e-14)


@pytest.mark.parametrize(("order", "close"), [(1, 1e-9), (2, 1e-9)])
def test_a_bent_and_twisted_beam_balances_what_pulls_its_tip(order, close):
    """Of a quarter of a ring that is bent far, in a batch: R F = P, R M = (x_tip - x) x P."""
    beam = tb.Beam.arc(1.0, 1.5, 8, SECTION, order=order)
    P = torch.tensor([[0.3, 1.0, 2.0], [-1.0, 0.5, 0.7]], dtype=torch.float64)
    scene = tb.Scene(beam, [tb.TipLoad(force=P)])
    state = tb.equilibrium(scene)
    forces = tb.sensors.SectionForces(scene)(state)
    x, q = (values[..., ::order, :] for values in (state.position, state.rotation))
    for at, nodes in ((0, slice(None, -1)), (2, slice(1, None))):
        F, M = (quat.rotate(q[..., nodes, :], part) for part in forces[..., at, :].split(3, -1))
        lever = state.tip.position[..., None, :] - x[..., nodes, :]
        assert_close(F, P[:, None].expand_as(F), rtol=0, atol=close)
        wanted = torch.linalg.cross(lever, P[:, None].expand_as(lever))
        assert_close(M, wanted, rtol=0, atol=close)


@pytest.mark.parametrize(("order", "errors"), [(1, (0.031, 0.008)), (2, (8e-4, 6e-5))])
def test_a_beam_on_a_bed_has_its_peak_under_the_load(order, errors):
    """P/(4 b) N m with b = (k/(4 EI))^(1/4) (Hetenyi, Beams on Elastic Foundation, 1946): the error
    falls with the order of the elements.
    """
    for N, error in zip((40, 80), errors, strict=True):
        beam = tb.Beam.straight(20.0, N, SECTION, order=order)
        bed = tb.Load(
            lambda x, *_: (x * x.new_tensor((0, 0, -4.0)), None), node=None, of=("position",)
        )
        push = tb.PointLoad(beam.node_count // 2, (0, 0, -1e-3))
        held = tb.Support(0, position="x", rotation="")
        scene = tb.Scene(beam, [bed, push], supports=[held], plane="xz")
        peak = tb.sensors.SectionForces(scene)(tb.equilibrium(scene))[..., 4].abs().max()
        assert abs(peak.item() / 0.25e-3 - 1) < error


def test_another_mesh_is_refused():
    scene = tb.Scene(tb.Beam.straight(1.0, 4, SECTION))
    other = tb.rest(tb.Scene(tb.Beam.straight(1.0, 5, SECTION)))
    with pytest.raises(ValueError, match=r"SectionForces: a state with 6 nodes was given"):
        tb.sensors.SectionForces(scene)(other)
