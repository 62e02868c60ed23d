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


@pytest.mark.parametrize("order", [1, 2])
def test_a_weight_at_a_node_is_not_spread_along_the_elements_beside_it(order):
    """Of 2 kg at the tip of a cantilever and 1 kg in its middle, in statics."""
    beam = tb.Beam.straight(1.0, 4, SECTION, order=order)
    masses = [tb.PointMass(2.0, node=-1), tb.PointMass(1.0, node=beam.node_count // 2)]
    scene = tb.Scene(beam, [tb.Gravity((0, 0, -1e-6)), *masses], small=True)
    forces = tb.sensors.SectionForces(scene)(tb.equilibrium(scene))
    s = places(beam)
    to_tip, within = 1.0 - s, (torch.arange(4)[:, None] < 2).double()
    shear = to_tip + 2.0 + within
    moment = to_tip**2 / 2 + 2.0 * to_tip + within * (0.5 - s)
    assert_close(forces[..., 2], -1e-6 * shear, rtol=1e-6, atol=1e-14)
    assert_close(forces[..., 4], 1e-6 * moment, rtol=1e-6, atol=1e-14)


def test_linked_interpolation_is_off_by_as_much_as_is_said():
    """Of a beam that is clamped at both ends: f h^2/8 next to these, f h^2/12 elsewhere."""
    beam = tb.Beam.straight(1.0, 8, SECTION).linked()
    ends = [tb.Support(0), tb.Support(-1)]
    scene = tb.Scene(beam, [tb.LineLoad(force=(0, 0, -1e-6))], small=True, supports=ends)
    forces = tb.sensors.SectionForces(scene)(tb.equilibrium(scene)) * 1e6
    s = places(beam)
    assert_close((forces[..., 2] - (s - 0.5)).abs().amax(), torch.tensor(1 / 8 / 24).double())
    off = (forces[..., 4] - (6 * s * s - 6 * s + 1) / 12).abs() * 64
    assert_close(off.amax(), torch.tensor(1 / 8).double())
    assert_close(off[3:5], torch.full((2, 3), 1 / 12).double())


def test_a_force_on_the_node_within_an_element_of_order_2():
    """The moment has its kink there, and none beyond."""
    beam = tb.Beam.straight(1.0, 4, SECTION, order=2)
    scene = tb.Scene(beam, [tb.PointLoad(5, (0, 0, -1e-6))], small=True)  # at 0.625 m
    forces = tb.sensors.SectionForces(scene)(tb.equilibrium(scene))
    moment = 1e-6 * (0.625 - places(beam)).clamp(min=0)
    assert_close(forces[..., 4], moment, rtol=1e-6, atol=1e-14)


@pytest.mark.parametrize(("plane", "out", "of"), [("xz", 1, [1, 3, 5]), ("xy", 2, [2, 3, 4])])
def test_what_acts_out_of_the_plane_is_not_seen(plane, out, of):
    """Loads by a function are cut to the plane there, and so are the forces."""
    force = torch.full((3,), -1e-3, dtype=torch.float64)
    force[out] = 5e-3
    scene = tb.Scene(
        tb.Beam.straight(1.0, 4, SECTION), [tb.LineLoad(force=lambda t: force)], plane=plane
    )
    forces = tb.sensors.SectionForces(scene)(tb.equilibrium(scene))
    assert not forces[..., of].any() and forces.abs().amax() > 4e-4


def test_gradient_beside_a_body_that_has_weight():
    """Of the moment at the clamp by g, -(m L^2/2 + 2 L): a body is no part of any element."""
    g = torch.tensor(-1e-6, dtype=torch.float64, requires_grad=True)
    parts = {"arm": tb.Beam.straight(1.0, 2, SECTION)}
    parts["load"] = tb.Body(mass=2.0, inertia=(1e-3,) * 3, position=(1.0, 0, 0))
    weight = tb.Gravity(torch.stack((0 * g, 0 * g, g)))
    joints, held = [tb.Weld(("arm", -1), "load")], [tb.Support(("arm", 0))]
    scene = tb.Scene(parts, [weight], joints=joints, supports=held)
    moment = tb.sensors.SectionForces(scene)(tb.equilibrium(scene))[0, 0, 4]
    (by,) = torch.autograd.grad(moment, g)
    assert_close(by, by.new_tensor(-2.5), rtol=1e-6, atol=0)


def test_another_mesh_is_refused():
    scene = tb.Scene(tb.Beam.straight(1.0, 4, SECTION))
    other = tb.rest(tb.Scene(tb.Beam.straight(1.0, 5, SECTION)))
    with pytest.raises(ValueError, match=r"SectionForces: a state with 6 nodes was given"):
        tb.sensors.SectionForces(scene)(other)
