"""Linked interpolation: exact under loads at nodes, of fourth order in bending, and what it is not
for.
"""

import warnings
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import orders, section
from torchbeam.nodal.constitutive_law import law_of
from torchbeam.nodal.coordinates.selection import in_space

SOFT = dict(EA=200.0, GA=80.0, GJ=0.015, EI=0.02, mass=0.3)  # a rod of 0.5 m


def rod(N, *effects, inertia=1e-3, linked=True, **options):
    beam = tb.Beam.straight(0.5, N, tb.Section.from_stiffness(**SOFT, inertia=inertia))
    return tb.Scene(beam.linked() if linked else beam, effects, **options)


def test_tip_loads_small_rotations_coupled_section():
    """Forces and moments at the tip of a straight beam bend it linearly: one element is exact for
    any 6x6 section. Without the option four elements are off by 1/(4 N^2) in bending.
    """
    torch.manual_seed(1)
    of, load = section(), tb.TipLoad(force=torch.randn(3), moment=torch.randn(3))
    want, one = (
        tb.equilibrium(tb.Scene(tb.Beam.straight(1.0, N, of).linked(), [load], small=True)).tip
        for N in (7, 1)
    )
    assert_close(one.position, want.position, rtol=1e-10, atol=1e-12)
    assert_close(one.rotation, want.rotation, rtol=1e-10, atol=1e-12)
    tip = tb.equilibrium(rod(4, tb.TipLoad(force=(0, 0.01, 0)), small=True)).tip.position
    assert_close(tip[1], torch.tensor(0.01 * (0.5**3 / 0.06 + 0.5 / 80)), rtol=1e-9, atol=0)
    tip = tb.equilibrium(
        rod(4, tb.TipLoad(force=(0, 0.01, 0)), small=True, linked=False)
    ).tip.position
    assert_close(
        tip[1], torch.tensor(0.01 * (0.5**3 / 0.06 * (1 - 1 / 64) + 0.5 / 80)), rtol=1e-9, atol=0
    )


@pytest.mark.parametrize(
    "load", [tb.Gravity((0, 0.1, 0)), tb.LineLoad(force=(0, 0.03, 0))], ids=("weight", "line load")
)
@pytest.mark.parametrize("N", [2, 3, 5])
def test_uniform_loads_small_rotations(load, N):
    """The tip of a cantilever under a uniform load q goes q L^4/(8 EI) + q L^2/(2 GA): from two
    elements on to rounding, as Gregory's weights leave out the moment q h^2/12 that half an element
    too far out would make.
    """
    tip = tb.equilibrium(rod(N, load, small=True)).tip.position
    assert_close(tip[1], torch.tensor(0.03 * (0.5**4 / 0.16 + 0.5**2 / 160)), rtol=1e-9, atol=0)


def test_frequencies():
    """Slender cantilever (Euler and Bernoulli, rigid in shear, no rotary inertia): modes 1 to 3, of
    order 4. Errors at N = 16: 3.1e-6, 7.0e-5, 2.4e-4 (measured; bounds a tenth more); elements
    without the option have 2.8e-4, 4.3e-3, 1.5e-2.
    """
    want = torch.tensor([1.8751040687119611, 4.694091132974174, 7.854757438237613]) ** 2
    of = tb.Section.from_stiffness(
        EA=torch.inf, GA=torch.inf, GJ=torch.inf, EI=(1.0, torch.inf), mass=1.0, inertia=0.0
    )
    errors = torch.stack(
        [
            (
                tb.modes(tb.Scene(tb.Beam.straight(1.0, N, of).linked()), count=3).frequency / want
                - 1
            ).abs()
            for N in (16, 32, 64)
        ]
    )
    assert (errors[0] < 1.1 * torch.tensor([3.14e-6, 7.05e-5, 2.45e-4])).all()
    assert (orders(errors)[1] > 4).all()


def test_transient_of_a_soft_rod():
    """Sudden tip load, 0.3 s, steps of 10 ms: RMS distance of the tip from that of 24 elements,
    N = 6: below a third of what it is without the option, which is 1 to 5 % of the RMS
    displacement.
    """
    t = torch.linspace(0, 0.3, 16)
    tips = [
        tb.simulate(
            rod(N, tb.TipLoad(force=(0, 0.1, 0)), plane="xy", linked=linked), t, step=0.01
        ).tip.position
        for N, linked in ((24, True), (6, True), (6, False))
    ]
    one, other = ((tip - tips[0]).square().sum(-1).mean().sqrt() for tip in tips[1:])
    assert one < other / 3
    assert 0.01 < other / (tips[0] - tips[0][0]).square().sum(-1).mean().sqrt() < 0.05


@pytest.mark.parametrize("linked", [False, True])
@pytest.mark.parametrize("coupled", [False, True])
def test_a_gradient_by_dampings_of_which_some_are_zero(coupled, linked):
    """c (1, 1, 1, 0, 0, 0), which damps stretching and shear alone: retardations are linear in c.
    So is that of a strain by itself, whose derivative is there at zero too, in uncoupled sections.
    """
    torch.manual_seed(2)
    beam = tb.Beam.straight(1.0, 2, section(coupled=coupled))
    beam, some = beam.linked() if linked else beam, torch.tensor([1.0, 1, 1, 0, 0, 0])

    def retardation(tau):
        scene = tb.Scene(beam, [tb.Damping(tau, six=True)])
        return law_of(scene, in_space(beam)).retardation_time

    value, slope = torch.func.jvp(
        lambda c: retardation(c * some), (torch.tensor(0.2),), (torch.tensor(1.0),)
    )
    assert_close(slope, value / 0.2)
    assert (value != 0).any()
    by_zero = torch.func.jacrev(retardation)(0.2 * some)[..., 3:]
    assert torch.isfinite(by_zero).all()
    if not coupled:
        assert_close(by_zero.sum(-1), retardation(1 - some).expand_as(by_zero[..., 0]))


def test_six_equal_dampings_are_one():
    """Six equal retardations are one, for coupled sections and for uncoupled ones; to rounding."""
    torch.manual_seed(2)
    t = torch.linspace(0, 0.2, 3)
    for of in (section(), section(coupled=False)):
        beam = tb.Beam.straight(1.0, 3, of).linked()
        scenes = (
            tb.Scene(beam, [tb.TipLoad(force=(0.1, 0.2, 0.1)), tb.Damping(tau)])
            for tau in (0.05, (0.05,) * 6)
        )
        one, six = (tb.simulate(scene, t, step=0.05, tolerance=1e-12) for scene in scenes)
        assert_close(one.tip.position, six.tip.position, rtol=1e-10, atol=1e-12)


def test_strains_are_those_of_the_section():
    """A sensor reads the shear F/GA of the section, not what its element shows besides, in one
    element and between them.
    """
    scene = rod(4, tb.TipLoad(force=(0, 1e-6, 0)))
    state = tb.equilibrium(scene)
    for where in (dict(element=1), dict(station=0.2)):
        shear = torch.tensor([0, 1e-6 / 80, 0])
        assert_close(
            tb.sensors.Strain(beam=scene.beam, **where)(state), shear, rtol=1e-6, atol=1e-10
        )
        curved = 1e-6 * (0.5 - where.get("station", 0.1875)) / 0.02
        assert_close(
            tb.sensors.Curvature(beam=scene.beam, **where)(state)[2],
            torch.tensor(curved),
            rtol=1e-6,
            atol=0,
        )


def test_gradients():
    """By the length, which weights and flexibility depend on, and by EI: equilibrium and three
    steps, against differences.
    """

    def of(length, EI):
        beam = tb.Beam.straight(
            length, 3, tb.Section.from_stiffness(**{**SOFT, "EI": EI}, inertia=1e-3)
        ).linked()
        scene = tb.Scene(beam, [tb.Gravity((0, 0, -1.0)), tb.TipLoad(force=(0, 0.05, 0))])
        return tb.equilibrium(scene).tip.position, tb.simulate(
            scene, [0.0, 0.15], step=0.05, tolerance=1e-12
        ).tip.position[-1]

    numbers = torch.tensor(0.5, requires_grad=True), torch.tensor(0.02, requires_grad=True)
    torch.autograd.gradcheck(of, numbers, eps=1e-6, atol=1e-6, rtol=1e-5)


def test_what_it_is_not_for():
    """The mixed forms, and elements of order 2: sentences."""
    with pytest.raises(ValueError, match="linked interpolation"):
        tb.simulate(rod(2), [0.0, 0.1], form="minimal")
    with pytest.raises(ValueError, match="order 1 is wanted"):
        tb.Beam.straight(0.5, 2, tb.Section.from_stiffness(**SOFT, inertia=1e-3), order=2).linked()
    assert "linked interpolation" in repr(rod(2).beam) and replace(rod(2).beam).linked_interpolation


@pytest.mark.parametrize(
    "lengths, uneven",
    [
        ([1.0, 1.5] * 6, False),
        ([1.0, 2.0] * 6, True),
        ([0.5] + [1.0] * 11, True),
        ([1.0] * 5 + [0.1] + [1.0] * 6, False),
    ],
)
def test_elements_that_are_too_uneven_are_named(lengths, uneven):
    """Where Gregory's weights are left, linked interpolation is worse than none (first bending by
    0.3 % and more, beside less than 0.1 %) and a warning says so; where they stay it is better, and
    none does.
    """
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=0.8, EI=1.0, mass=1.0)
    x = torch.tensor([0.0, *lengths]).cumsum(0) / sum(lengths)
    beam = tb.Beam.from_nodes(torch.stack((x, 0 * x, 0 * x), -1), section)

    def first(beam):
        return tb.modes(tb.Scene(beam, plane="xz"), count=1).frequency[0].item()

    fine = first(tb.Beam.straight(1.0, 64, section).linked())
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        linked = abs(first(beam.linked()) / fine - 1)
    plain = abs(first(beam) / fine - 1)
    assert any("lengths or masses jump" in str(one.message) for one in told) is uneven
    assert (linked > 3e-3 and plain < 1e-3) if uneven else linked < 3e-5 < plain
