"""`Viscoelastic`: its forms, its fractional series, what is refused."""

import math
from dataclasses import replace

import pytest
import torch

import torchbeam as tb
from tests.cases.refusals import refusals

SECTION = tb.Section.from_stiffness(EA=200.0, GA=80.0, GJ=0.8, EI=1.0, mass=0.3, inertia=1e-3)
BEAM = tb.Beam.straight(1.0, 2, SECTION)
SIX = ((0.1, 0.2),) * 6


@refusals(
    ((0.5, 0.6), (1.0, 2.0), r"shares with the sum 1.1 were given; less than 1 is wanted"),
    ((0.5,), (1.0, 2.0), r"1 shares and 2 times were given; one time for each share"),
    ((-0.5,), (1.0,), r"shares = -0.5 was given; a non-negative"),
    ((0.5,), (0.0,), r"times = 0 was given; a positive"),
    (0.5, 1.0, r"shares of shape \(\) was given; \(..., m\) is wanted"),
    (((0.5,),) * 5, (1.0,), r"shares of shape \(5, 1\) was given; \(..., 6, m\) is wanted"),
    ((), (), r"\(\) was given; numbers or a tensor are wanted"),
    (torch.zeros(0), torch.zeros(0), r"shares of shape \(0,\) was given; \(..., m\)"),
)
def test_what_is_no_series_is_refused(shares, times):
    tb.Viscoelastic(shares, times)


def test_scenes_that_it_does_not_fit():
    """Two of one beam; a row for each strain of a coupled section; a state of other arms; methods
    that go back in time by more than what is remembered lasts.
    """
    arms = tb.Viscoelastic((0.5,), (0.1,))
    with pytest.raises(ValueError, match="2 Viscoelastic were given; at most one is wanted"):
        tb.Scene(BEAM, [arms, arms])
    coupled = tb.Beam.straight(1.0, 2, SECTION.shifted(y=0.1))
    with pytest.raises(ValueError, match="a row for each strain was given for a section whose"):
        tb.equilibrium(tb.Scene(coupled, [tb.Viscoelastic(SIX, (0.1, 1.0))]))
    two = tb.rest(tb.Scene(BEAM, [tb.Viscoelastic((0.1, 0.2), (0.1, 1.0))]))
    for rows in (1, 3):
        other = replace(two, inelastic=torch.zeros(rows, 12))
        with pytest.raises(ValueError, match=f"{rows} rows was given; the beam has 2 stations"):
            tb.Stepper(tb.Scene(BEAM, [tb.Viscoelastic((0.1, 0.2), (0.1, 1.0))]), 0.01)(other)
    with pytest.raises(ValueError, match="a state of 2 arms that relax was given"):
        tb.simulate(tb.Scene(BEAM, [arms]), (0.0, 0.1), initial=two)
    with pytest.raises(ValueError, match=r"Viscoelastic with a time of 0.1 s was given to steps"):
        tb.Stepper(tb.Scene(BEAM, [arms]), 0.4, method="midpoint4")(tb.rest(tb.Scene(BEAM, [arms])))


def test_six_equal_rows_are_one():
    """In space and in a plane; a state has three strains in a plane as six."""
    push = tb.TipLoad(force=(0.1, 0.0, 0.3))
    for plane in (None, "xz"):
        ends = []
        for shares in ((0.1, 0.2), SIX):
            scene = tb.Scene(BEAM, [tb.Viscoelastic(shares, (0.1, 1.0)), push], plane=plane)
            run = tb.simulate(scene, (0.0, 0.1, 0.2), step=0.05, engine="eager")
            ends.append(run.state[-1])
        assert (ends[0].position - ends[1].position).abs().max() < 1e-13
        assert ends[0].inelastic.shape == (2, 12)
        assert (ends[0].inelastic - ends[1].inelastic).abs().max() < 1e-13


def test_one_strain_alone_relaxes():
    """Twist by one arm, of which a torque and a force see: the long-time twist is 1/(1 - 0.4) of
    the instantaneous one, bending as it was, to rounding.
    """
    rows = ((0.0,),) * 3 + ((0.4,), (0.0,), (0.0,))
    load = tb.TipLoad(force=(0.0, 0.0, 1e-6), moment=(1e-6, 0.0, 0.0))
    soft, plain = (
        tb.equilibrium(tb.Scene(BEAM, [load, *arms], small=True))
        for arms in ([tb.Viscoelastic(rows, (0.1,))], [])
    )
    twist = [x.axes[-1, 2, 1].item() for x in (soft, plain)]
    assert twist[0] == pytest.approx(twist[1] / 0.6, rel=1e-9)
    assert (soft.tip.position - plain.tip.position).abs().max() < 1e-15


@pytest.mark.parametrize("linked", [False, True])
def test_a_beam_that_tapers_within_its_elements(linked):
    """One row scales the whole stiffness: the long-time tip is 1/(1 - 0.4) of the instantaneous
    one, to rounding. Six rows are refused.
    """
    cone = tb.Beam.straight(1.0, 2, lambda s: tb.Section.circle(0.1 - 0.05 * s, 100.0, 0.3, 1.0))
    beam, load = cone.linked() if linked else cone, tb.TipLoad(force=(0.0, 0.0, 1e-7))
    arms, six = (tb.Viscoelastic(shares, (0.1, 1.0)) for shares in ((0.1, 0.3), SIX))
    soft, plain = (
        tb.equilibrium(tb.Scene(beam, [load, *more], small=True)).tip.position[2]
        for more in ([arms], [])
    )
    assert beam.taper is not None
    assert soft.item() == pytest.approx(plain.item() / 0.6, rel=1e-12)
    with pytest.raises(ValueError, match="or that tapers; one row of shares and times is wanted"):
        tb.equilibrium(tb.Scene(beam, [load, six]))


@pytest.mark.parametrize("engine", ["compiled", "eager"])
def test_a_step_in_parts_remembers(engine):
    """Of two samples, one that few iterations solve in parts alone: it is after 8 steps of an
    eighth, the other one after a whole step, to rounding.
    """
    force = torch.tensor([[0.0, 0.0, 0.1], [0.0, 2.0, 6.0]])
    shares = torch.tensor([[0.3, 0.2], [0.1, 0.3]])
    scene = tb.Scene(BEAM, [tb.Viscoelastic(shares, (0.01, 1.0)), tb.TipLoad(force=force)])
    after = tb.Stepper(scene, 0.2, iterations=3, tolerance=1e-12, engine=engine)(tb.rest(scene))
    assert (after.status == 0).all()
    for sample, parts in ((0, 1), (1, 8)):
        stepper, state = tb.Stepper(scene, 0.2 / parts, tolerance=1e-12), tb.rest(scene)
        for _ in range(parts):
            state = stepper(state)
        assert (after.inelastic - state.inelastic)[sample].abs().max() < 1e-11
        assert (after.position - state.position)[sample].abs().max() < 1e-11


@pytest.mark.steps
def test_shares_and_times_are_identified():
    """Both, of two arms, from ten heights of a tip that creeps, read to 1e-5 m: to 1e-6."""
    weight = tb.TipLoad(force=(0.0, 0.0, 0.2))
    start = tb.equilibrium(tb.Scene(BEAM, [weight], plane="xz"))
    true = {"shares": torch.tensor([0.2, 0.3]), "times": torch.tensor([0.2, 1.0])}

    def creep(theta):
        arms = tb.Viscoelastic(theta["shares"], theta["times"])
        scene = tb.Scene(BEAM, [arms, tb.Damping(0.02), weight], plane="xz")
        tip = tb.simulate(scene, torch.linspace(0, 2, 11), initial=start, step=0.1).tip
        return tip.position[1:, ..., 2].movedim(0, -1)

    guess = {
        "shares": tb.Parameter((0.3, 0.3), bounds=(0.0, 0.45)),
        "times": tb.Parameter((0.1, 2.0), bounds=(0.01, 10.0)),
    }
    fit = tb.identify(creep, tb.Measurement(creep(true), 1e-5), guess)
    for name, value in true.items():
        assert (fit[name] / value - 1).abs().max() < 1e-6


def test_another_mesh_relaxes_likewise():
    """`remesh` keeps the effect: at last the fine mesh stands as one of the long-time stiffness. A
    state of the coarse mesh does not fit it.
    """
    load = tb.TipLoad(force=(0, 0, 0.3))
    scene = tb.Scene(BEAM, [tb.Viscoelastic((0.4,), (0.1,)), load])
    fine, soft = tb.remesh(scene, 4), tb.Section(SECTION.compliance / 0.6, SECTION.mass)
    assert tb.rest(fine).inelastic.shape == (4, 6)
    wanted = tb.equilibrium(tb.Scene(tb.Beam.straight(1.0, 4, soft), [load])).position
    assert (tb.equilibrium(fine).position - wanted).abs().max() < 1e-10
    with pytest.raises(ValueError, match="with 3 nodes was given; the beam has 5"):
        tb.simulate(fine, (0.0, 0.1), initial=tb.rest(scene))


@pytest.mark.parametrize("order", [0.3, 0.5, 0.7])
def test_a_fractional_series(order):
    """The complex stiffness 1 - share/(1 + (i w tau)^order) in the middle of the band, from shares
    and times, is within the error that the effect tells of; at rest it is that of the spring; half
    as many arms have five times the error.
    """
    share, tau = 0.8, 1e-2
    arms = tb.Viscoelastic.fractional(order, share, tau, (1.0, 1e4))
    g, times = (torch.as_tensor(x) for x in (arms.shares, arms.times))
    assert 1e-4 < arms.error < 1e-2 and (g >= 0).all()
    for w in (1.0, 3.0, 40.0, 700.0, 1e4):
        exact = 1 - share / (1 + (1j * w * tau) ** order)
        series = 1 - (g / (1 + 1j * w * times)).sum()
        assert abs(series - exact) < 1.1 * arms.error * abs(exact)
    assert g.sum().item() == pytest.approx(share, abs=1e-6)
    few = tb.Viscoelastic.fractional(order, share, tau, (1.0, 1e4), arms=6)
    assert few.shares.shape == (6,) and few.error > 5 * arms.error


def test_a_fractional_series_has_derivatives():
    """By order, share and time, against differences of 1e-6: 1e-7 of the largest."""
    at = torch.tensor([0.4, 0.8, 1e-2])

    def shares(x):
        return tb.Viscoelastic.fractional(*x, (1.0, 1e3)).shares

    slopes = torch.autograd.functional.jacobian(shares, at)
    steps = torch.diag(1e-6 * at)
    differences = [(shares(at + d) - shares(at - d)) / (2 * d.sum()) for d in steps]
    assert (slopes - torch.stack(differences, -1)).abs().max() < 1e-7 * slopes.abs().max()


@refusals(
    ((1.0, 0.5, 1.0, (1.0, 2.0)), "order = 1.0 was given; a positive number less than 1"),
    ((0.5, 1.2, 1.0, (1.0, 2.0)), "share = 1.2"),
    ((0.5, 0.5, -1.0, (1.0, 2.0)), "time = -1.0 was given; a positive number"),
    ((0.5, 0.5, 1.0, (2.0, 1.0)), r"frequencies = \(2, 1\) was given; \(lowest, highest\)"),
)
def test_what_is_no_fractional_solid_is_refused(numbers):
    tb.Viscoelastic.fractional(*numbers)


def test_a_strip_of_fractional_damping():
    """The first mode's damping ratio, of an order 0.3 over the band, is that of the root of s^2 +
    w^2 (1 - share/(1 + (s tau)^order)) = 0 to within the error of the series.
    """
    arms = tb.Viscoelastic.fractional(0.3, 0.6, 1e-2, (0.5, 500.0))
    w = tb.modes(tb.Scene(BEAM), count=1).frequency.item()
    s = 1j * w
    for _ in range(60):  # towards the root, by fixed point
        s = 1j * w * (1 - 0.6 / (1 + (s * 1e-2) ** 0.3)) ** 0.5
    mode = tb.modes(tb.Scene(BEAM, [arms]), count=1)
    assert mode.damping_ratio.item() == pytest.approx(-s.real / abs(s), rel=2 * arms.error)
    assert mode.frequency.item() == pytest.approx(abs(s), rel=arms.error)
    assert math.isfinite(arms.error)


def test_native_gradients_of_one_sample_that_conserves_energy():
    """A beam without batch axes, natively with conserve=True: the gradient is that of torch."""
    slopes = []
    for engine in ("compiled", "eager"):
        share = torch.tensor([0.3], requires_grad=True)
        scene = tb.Scene(BEAM, [tb.Viscoelastic(share, (0.1,)), tb.TipLoad(force=(0, 0, 0.3))])
        stepper = tb.Stepper(scene, 0.02, conserve=True, engine=engine)
        state = stepper(stepper(tb.rest(scene)))
        slopes += torch.autograd.grad(state.tip.velocity.sum() + state.inelastic.sum(), share)
    assert (slopes[0] - slopes[1]).abs() < 1e-10 * slopes[1].abs()
