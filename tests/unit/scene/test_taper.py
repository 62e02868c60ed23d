"""Elements whose section changes along them: flexibility and mass that their ends show, against the
force method and closed forms; see torchbeam.scene.taper.
"""

import math
import warnings

import pytest
import torch
from numpy.polynomial.legendre import leggauss

import torchbeam as tb
from torchbeam.scene.taper import additions, residual_bending

X, W = (torch.from_numpy(x) for x in leggauss(24))
P = 1e-9  # so small that displacements are linear


def height(kind, end):
    return lambda s: 0.02 * (1 - (1 - end) * (s**2 if kind == "parabola" else s))


def section(kind, end):
    h = height(kind, end)
    if kind == "cone":
        return lambda s: tb.Section.circle(h(s) / 2, 1e9, 0.3, 1e3)
    return lambda s: tb.Section.rectangle(0.02, h(s), 1e9, 0.3, 1e3)


def exact(along, load):
    """Tip displacement by unit load (N, or m/s^2), by the force method on a fine grid, graded."""
    ends = 1 - torch.logspace(0, -6, 40)
    ends = torch.cat((ends, ends.new_ones(1)))
    s = (ends[:-1, None] + ends.diff()[:, None] * (1 + X) / 2).flatten()
    w = (ends.diff()[:, None] * W / 2).flatten()
    S = along(s).compliance
    if load == "tip":
        M, Q = 1 - s, torch.ones_like(s)
    else:
        outer = s[:, None] + (1 - s[:, None]) * (1 + X) / 2
        q = along(outer.flatten()).mass[:, 0, 0].view_as(outer) * W / 2 * (1 - s[:, None])
        M, Q = (q * (outer - s[:, None])).sum(-1), q.sum(-1)
    return (w * (S[:, 4, 4] * M * (1 - s) + S[:, 2, 2] * Q)).sum().item()


def tip(along, elements, load, linked=False):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # sharp tapers are told
        beam = tb.Beam.straight(1.0, elements, along)
    beam = beam.linked() if linked else beam
    effect = tb.TipLoad(force=(0, 0, P)) if load == "tip" else tb.Gravity((0, 0, P))
    return tb.equilibrium(tb.Scene(beam, [effect])).tip.position[2].item() / P


@pytest.mark.parametrize("kind", ["wedge", "cone", "parabola"])
def test_force_at_the_tip_bends_linked_elements_exactly(kind):
    """Moments are linear and elements statically determinate: to a tenth of the height by the
    quadrature's error alone, 0.7 % of two elements, 0.2 % of four (before: 60 to 190 %).
    """
    along = section(kind, 0.1)
    errors = [abs(tip(along, N, "tip", linked=True) / exact(along, "tip") - 1) for N in (2, 4)]
    assert errors[0] < 8e-3 and errors[1] < 2.5e-3


@pytest.mark.parametrize(
    ("kind", "by_tip", "by_weight"),
    [("wedge", 0.0338, 0.0097), ("cone", 0.0702, 0.0268), ("parabola", 0.0314, 0.0064)],
)
def test_plain_elements(kind, by_tip, by_weight):
    """Eight of them, to a tenth of the height, within 2 % of what was measured; with the mean
    compliance and half of each element's mass at its ends 7 to 25 %, and 5 to 16 %. Second order:
    sixteen have less than 40 % of these errors.
    """
    along = section(kind, 0.1)
    for load, error in (("tip", by_tip), ("weight", by_weight)):
        eight, sixteen = (abs(tip(along, N, load) / exact(along, load) - 1) for N in (8, 16))
        assert eight == pytest.approx(error, rel=0.02)
        assert sixteen < 0.4 * eight


def test_weight_bends_linked_elements_to_fourth_order():
    """A wedge to half of its height: errors of 8 and 16 elements 1.5e-4 and 8e-6 (before: 1.4 and
    0.35 %, second order).
    """
    along = section("wedge", 0.5)
    eight, sixteen = (
        abs(tip(along, N, "weight", linked=True) / exact(along, "weight") - 1) for N in (8, 16)
    )
    assert eight < 1.6e-4 and sixteen < eight / 12


def test_masses_of_nodes_have_the_beams_first_moment():
    """rho A = 1 - 0.9 s: mass 0.55, first moment 1/2 - 0.3 = 0.2 exactly, of three elements."""
    along = lambda s: tb.Section.from_stiffness(1.0, 1.0, 1.0, 1.0, mass=1 - 0.9 * s)  # noqa: E731
    beam = tb.Beam.straight(1.0, 3, along)
    ends = beam.length[:, None, None] * torch.stack(
        (beam.mass / 2 - beam.mass_taper, beam.mass / 2 + beam.mass_taper)
    )
    m = ends[..., 0, 0]
    s = beam.nodes[..., 0]
    torch.testing.assert_close(m.sum(), torch.tensor(0.55), rtol=1e-13, atol=0)
    first = (m[0] * s[:-1] + m[1] * s[1:]).sum()
    torch.testing.assert_close(first, torch.tensor(0.2), rtol=1e-13, atol=0)
    clamp = (
        tb.equilibrium(tb.Scene(beam, [tb.Gravity((0, 0, P))]), engine="eager").root.moment[1] / P
    )
    torch.testing.assert_close(clamp.abs(), torch.tensor(0.2), rtol=1e-9, atol=0)


def moments(values, h):
    x = h / 2 * X
    return tuple(
        (W[:, None, None] / 2 * x[:, None, None] ** k * values).sum(0)[None] for k in range(3)
    )


def spread(jumps, seed=0):
    """Stiffnesses (24, 6, 6) along an element of 0.7 m, all coupled, that jump up to e^jumps."""
    draws = torch.Generator().manual_seed(seed)
    A = torch.randn(24, 6, 6, generator=draws) * 0.3 + torch.eye(6)
    return A @ A.mT * torch.exp(jumps * torch.randn(24, 1, 1, generator=draws))


@pytest.mark.parametrize("jumps", [0.0, 1.0, 4.0])
@pytest.mark.parametrize("soft", ["all", "middle", "end"])
def test_flexibility_is_positive_and_that_of_the_force_method(jumps, soft):
    """S_el by T^T S T summed; S_plain between the mean and S_el, positive whatever the stiffness
    does along the element.
    """
    h, K = torch.tensor([0.7]), spread(jumps)
    there = {"all": X > 2, "middle": X.abs() < 0.2, "end": X > 0.8}[soft]
    K = torch.where(there[:, None, None], 1e-3 * K, K)
    S = torch.linalg.inv(K)
    S = (S + S.mT) / 2
    plain, whole = additions(moments(S, 0.7), moments(K, 0.7), h)[0]
    T = torch.eye(6).repeat(24, 1, 1)
    T[:, 4, 2], T[:, 5, 1] = 0.35 * X, -0.35 * X  # 1 - x [[0, 0], [~e1, 0]]
    summed = (W[:, None, None] / 2 * T.mT @ S @ T).sum(0)
    mean = moments(S, 0.7)[0][0]
    torch.testing.assert_close(mean + whole, summed, rtol=1e-11, atol=1e-12 * summed.max().item())
    size = summed.diagonal().sqrt()
    for matrix in (mean + plain, whole - plain):
        scaled = matrix / (size[:, None] * size)
        assert torch.linalg.eigvalsh(scaled).min() > -1e-12


def test_uniform_elements_have_nothing_added():
    """None of plain ones; of linked ones the residual bending flexibility."""
    K = spread(0.0)[:1].expand(24, 6, 6)
    S, h = torch.linalg.inv(K), torch.tensor([0.7])
    plain, whole = additions(moments(S, 0.7), moments(K, 0.7), h)[0]
    known = residual_bending(S[:1], h)[0]
    torch.testing.assert_close(whole, known, rtol=1e-10, atol=1e-12)
    torch.testing.assert_close(plain, torch.zeros(6, 6), rtol=0, atol=1e-11 * known.max().item())


@pytest.mark.parametrize("linked", [False, True])
def test_derivatives_by_the_height_at_the_end(linked):
    """As differences say; natively the same displacement (a law is numbers to native code, so one
    kind of element stands for both).
    """

    def read(end, engine="eager"):
        beam = tb.Beam.straight(1.0, 4, section("wedge", end))
        scene = tb.Scene(beam.linked() if linked else beam, [tb.TipLoad(force=(0, 0, 0.01))])
        return tb.equilibrium(scene, engine=engine).tip.position[2]

    end = torch.tensor(0.4, requires_grad=True)
    eager = read(end)
    (slope,) = torch.autograd.grad(eager, end)
    step = 1e-4
    difference = (read(0.4 + step) - read(0.4 - step)) / (2 * step)
    torch.testing.assert_close(slope, difference.detach(), rtol=1e-5, atol=0)
    if linked:
        torch.testing.assert_close(read(0.4, "compiled"), eager.detach(), rtol=1e-9, atol=0)


@pytest.mark.parametrize("linked", [False, True])
def test_in_a_structure_beside_uniform_ones(linked):
    """A wedge and a uniform beam, both clamped, in one structure: as each alone."""
    wedge, even = (
        tb.Beam.straight(1.0, 4, x, root=(0, y, 0))
        for x, y in ((section("wedge", 0.3), 0.0), (section("wedge", 1.0)(torch.tensor(0.5)), 1.0))
    )
    if linked:
        wedge, even = wedge.linked(), even.linked()
    loads = [tb.Gravity((0, 0, -0.1))]
    both = tb.equilibrium(
        tb.Scene(
            {"wedge": wedge, "even": even},
            loads,
            supports=[tb.Support(("wedge", 0)), tb.Support(("even", 0))],
        )
    )
    for name, beam in (("wedge", wedge), ("even", even)):
        alone = tb.equilibrium(tb.Scene(beam, loads))
        torch.testing.assert_close(
            both[name].tip.position, alone.tip.position, rtol=1e-9, atol=1e-12
        )


def test_a_plane_takes_a_taper():
    """In the plane of bending as in space, to rounding."""
    beam = tb.Beam.straight(1.0, 4, section("wedge", 0.3))
    loads = [tb.TipLoad(force=(0, 0, 0.02))]
    plane, space = (
        tb.equilibrium(tb.Scene(beam, loads, plane=p)).tip.position for p in ("xz", None)
    )
    torch.testing.assert_close(plane, space, rtol=1e-9, atol=1e-12)


def test_strain_is_that_of_the_section_in_the_middle():
    """Mean over an element, of a moment that is linear: by the stress in its middle and the mean
    compliance.
    """
    beam = tb.Beam.straight(1.0, 4, section("wedge", 0.3))
    state = tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=(0, 0, P))]))
    shear = tb.sensors.Strain(beam=beam, element=1)(state) / P
    bending = tb.sensors.Curvature(beam=beam, element=1)(state) / P
    S, lever = beam.compliance[1], 0.625
    assert math.isclose(abs(bending[1].item()), S[4, 4].item() * lever, rel_tol=1e-6)
    assert math.isclose(abs(shear[2].item()), S[2, 2].item(), rel_tol=1e-5)
