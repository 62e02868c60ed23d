"""The gain of an instrument: found, carried into predictions, and told where nothing tells it."""

import functools
from dataclasses import replace

import pytest
import torch
from torch.distributions import Normal
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals

T = torch.linspace(0, 2, 200)
TRUE = {"w": torch.tensor([9.0]), "a": torch.tensor([1.0]), "g": torch.tensor([1.04])}


def wave(theta):
    shape = torch.exp(-0.3 * T) * torch.sin(theta["w"][:, None] * T)
    return shape * theta["a"][:, None] if "a" in theta else shape


def gauge(sigma=0.01, **changes):
    noise = sigma * torch.randn(200, generator=torch.Generator().manual_seed(0))
    clean = TRUE["g"][:, None] * wave(TRUE)
    return tb.Measurement(clean[0] + 0.2 + noise, sigma, T, gain="g", offset=True, name="gauge",
                          **changes)  # fmt: skip


@pytest.mark.parametrize("derivatives", ["difference", "forward", "adjoint"])
def test_it_is_a_column_of_the_closed_form(derivatives):
    """Deviations are those of linear least squares whose column of the gain is the motion."""
    fit = tb.identify(wave, gauge(), {"w": 8.9, "g": 1.0}, derivatives=derivatives)
    assert fit.status == 0 and not fit.doubts
    w, g = fit["w"], fit["g"]
    there = torch.exp(-0.3 * T)
    J = torch.stack((g * there * T * torch.cos(w * T), there * torch.sin(w * T), there**0), -1)
    expected = torch.linalg.inv(J.mT @ J).diagonal().sqrt() * 0.01
    assert_close(fit.deviation, expected, rtol=1e-4, atol=0)
    assert ((fit.theta[:2] - torch.cat((TRUE["w"], TRUE["g"]))).abs() < 3 * expected[:2]).all()


def test_where_an_amplitude_is_not_known_it_is_told_that_nothing_tells_it():
    """The data know the product alone; a prior as data sheets have it parts them, and says how far:
    the amplitude is then known as the gain is.
    """
    start = {"w": 8.9, "a": 1.0, "g": 1.0}
    fit = tb.identify(wave, gauge(), start)
    assert fit.status == 3
    (said,) = fit.unidentifiable
    assert said == "the misfit does not change where these change together: a +71 %, g -71 %"
    assert_close(fit["a"] * fit["g"], TRUE["g"][0], rtol=5e-3, atol=0)
    fit = tb.identify(wave, gauge(), {**start, "g": tb.Parameter(1.0, prior=Normal(1.0, 0.02))})
    assert fit.status == 0
    assert_close(fit.deviation[1:3], torch.tensor([0.0208, 0.02]), rtol=0.01, atol=0)


def test_of_a_linear_structure_the_force_and_all_gains_are_told_together():
    """Three lasers along a strip that a force bends, each with its gain: four numbers of which data
    tell three. That it bends no line for large forces parts them within no noise, and a hint says
    so; a small force, of a linear model, parts them not at all. One gain that is known does.
    """
    seen = [replace(m, gain=f"g{k}") for k, m in enumerate(lasers())]
    start = {"F": 0.02, "g0": 1.0, "g1": 1.0, "g2": 1.0}
    line = tb.identify(functools.partial(bent, small=True), seen, start, derivatives="difference")
    assert line.status == 3
    (said,) = line.unidentifiable
    assert all(name in said for name in start)
    fit = tb.identify(bent, seen, start, derivatives="difference")
    (said,) = (hint for hint in fit.hints if "hardly tell" in hint)
    assert "4 parameters apart" in said and all(f"{name} " in said for name in start)
    assert (fit.deviation > fit.theta).all()
    seen[0] = replace(seen[0], gain=1.1)
    del start["g0"]
    fit = tb.identify(bent, seen, start, derivatives="difference")
    assert fit.status == 0
    assert_close(fit.theta, torch.tensor([0.03, 0.9, 1.05]), rtol=2e-2, atol=0)


SECTION = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=1.0, EI=1.0, mass=0.2, inertia=1e-6)
STRIP = tb.Beam.straight(0.5, 4, SECTION)


def bent(theta, engine="eager", small=False):
    """At rest under F, three poses: (n, 3)."""
    force = theta["F"][:, None] * torch.tensor([0.5, 1.0, 2.0])
    load = tb.TipLoad(force=force[..., None] * torch.tensor([0, 0, 1.0]))
    scene = tb.Scene(STRIP, [load], small=small)
    return tb.equilibrium(scene, throw=False, engine=engine)


def lasers():
    """What three read, with gains of 1.1, 0.9 and 1.05."""
    state, seen = bent({"F": torch.tensor([0.03])}), []
    for k, (s, gain) in enumerate(((0.3, 1.1), (0.4, 0.9), (0.5, 1.05))):
        laser = tb.Measurement(torch.zeros(3, 1), 1e-6, sensor=tb.sensors.Position(s, STRIP)["z"])
        noise = 1e-6 * torch.randn(3, 1, generator=torch.Generator().manual_seed(k))
        seen.append(replace(laser, values=gain * laser.read(state)[0] + noise, name=f"laser{k}"))
    return seen


@pytest.mark.parametrize("engine", ["eager", "compiled"])
@pytest.mark.parametrize("gain", [1.3, [1.3, 0.8, 1.0], "one", "each"])
def test_both_engines_read_with_it(engine, gain):
    """Of a batch of two samples and three channels, at rest and moving; with the gradient of the
    gain, which is the reading.
    """
    known = {"one": torch.tensor([1.3, 0.9]),
             "each": torch.tensor([[1.3, 0.8, 1.0], [1, 2, 3.0]]).requires_grad_()}  # fmt: skip
    factor = known[gain] if isinstance(gain, str) else torch.tensor(gain).expand(2, 3)
    factor = factor.reshape(2, 1, -1)
    theta = {"F": torch.tensor([0.03, 0.05]), **known}
    at, t = tb.sensors.Position(0.4, STRIP), torch.linspace(0, 0.1, 5)
    plain = tb.Measurement(torch.zeros(3, 3), sensor=at)
    y, rest = replace(plain, gain=gain).read(bent(theta, engine), theta), bent(theta, engine)
    assert_close(y, factor * plain.read(rest))
    moving = tb.Measurement(torch.zeros(5, 3), times=t, sensor=at)
    push = tb.TipLoad(force=theta["F"][:, None] * torch.tensor([0, 0, 1.0]))
    motion = tb.simulate(tb.Scene(STRIP, [push]), t, step=0.01, engine=engine)
    there = moving.read(motion)
    y = replace(moving, gain=gain).read(motion, theta)
    assert_close(y, factor * there)
    if gain == "each":
        (by,) = torch.autograd.grad(y.sum(), known["each"])
        assert_close(by, there.sum(1))


def test_it_is_carried_into_a_prediction_with_its_share_of_the_band():
    """By the instrument: the gain's variance times the motion's square more than what is there,
    which a prediction without the instrument gives; of each channel, and at other times.
    """
    at, t = tb.sensors.Position(0.5, STRIP), torch.linspace(0.02, 0.2, 10)

    def motion(theta):
        section = tb.Section.from_stiffness(
            EA=1e5, GA=1e5, GJ=1.0, EI=theta["EI"], mass=0.2, inertia=1e-6)  # fmt: skip
        beam = tb.Beam.straight(0.5, 4, section)
        scene = tb.Scene(beam, [tb.TipLoad(force=(0, 0, 0.3)), tb.Damping(0.01)], plane="xz")
        return tb.simulate(scene, torch.linspace(0, 0.3, 16), step=0.02, engine="compiled")

    laser = tb.Measurement(torch.zeros(10, 1), 1e-4, t, at["z"], gain="g", name="laser")
    true = {"EI": torch.tensor([1.2]), "g": torch.tensor([0.95])}
    clean = laser.read(motion(true), true)[0]
    noise = 1e-4 * torch.randn(10, 1, generator=torch.Generator().manual_seed(0))
    start = {"EI": tb.Parameter(1.0, "log"), "g": 1.0}
    fit = tb.identify(motion, replace(laser, values=clean + noise), start, derivatives="difference")
    assert fit.status == 0
    assert ((fit.theta - torch.tensor([1.2, 0.95])).abs() < 3 * fit.deviation).all()
    later = torch.tensor([0.22, 0.25])
    read, there = fit.predict(measurement="laser", times=later), fit.predict(None, at["z"], later)
    assert_close(read.y, fit["g"] * there.y)
    # derivatives by ln EI, g of each
    by = there.deviation / fit.x_covariance[0, 0].sqrt()
    h = 1e-5
    ends = (tb.observe(motion({"EI": fit["EI"][None] * (1 + s * h)}), at["z"], later)[:, 0]
            for s in (1, -1))  # fmt: skip
    slope = (next(ends) - next(ends)) / (2 * h)
    assert_close(by, slope.abs(), rtol=1e-3, atol=0)
    G = torch.stack((fit["g"] * slope, there.y), -1)
    variance = ((G @ fit.x_covariance) * G).sum(-1)
    assert_close(read.deviation, variance.sqrt(), rtol=1e-3, atol=0)


def test_a_prediction_of_a_model_that_gives_tensors_has_it_too():
    fit = tb.identify(wave, gauge(), {"w": 8.9, "g": 1.0})
    assert_close(fit.predict(measurement="gauge").y, fit.y)
    there = fit.predict().y
    assert_close(fit.y, fit["g"] * there + fit["offset of gauge"])
    again = tb.identify(wave, gauge(), {"w": 8.9, "g": 1.0}, starts=4, spread=1.02)
    assert_close(again.theta, fit.theta, rtol=1e-5, atol=0)  # four starts in a batch


def test_a_design_pays_for_what_is_not_known_of_it():
    """Two lasers of the same place, one whose gain has a deviation of 10 %: the other is taken, and
    together they know the force as the better one does.
    """
    at = tb.sensors.Position(0.5, STRIP)["z"]
    both = {
        "known": tb.Measurement(None, 1e-4, sensor=at),
        "loose": tb.Measurement(None, 1e-5, sensor=at, gain="g"),
    }
    start = {"F": tb.Parameter(0.03, "log"), "g": tb.Parameter(1.0, prior=Normal(1.0, 0.1))}

    def one(theta):
        load = tb.TipLoad(force=theta["F"][:, None] * torch.tensor([0, 0, 1.0]))
        return tb.equilibrium(tb.Scene(STRIP, [load], plane="xz"), throw=False)

    plan = tb.design(one, both, start, sensors=1, of="F")
    assert plan.sensors == ("known",)
    start["g"] = tb.Parameter(1.0, prior=Normal(1.0, 1e-4))
    assert tb.design(one, both, start, sensors=1, of="F").sensors == ("loose",)


@refusals(
    (0.0, "a gain of 0"),
    (torch.nan, "gain"),
    ([1.0, 2.0], r"one for each channel \(3,\), is wanted"),
    (torch.ones(4, 3), r"one for each channel \(3,\), is wanted"),
)
def test_what_is_no_gain_is_refused(gain):
    tb.Measurement(torch.zeros(4, 3), times=torch.arange(4.0), gain=gain)


@pytest.mark.parametrize("by", [None, {"h": torch.ones(1)}])
@pytest.mark.parametrize("of", [{"gain": "g"}, {"place": {"station": "g"}}])
def test_reading_without_the_parameter_is_refused(of, by):
    beam = tb.Beam.straight(1.0, 2, tb.Section.rectangle(0.02, 0.001, E=70e9, nu=0.3, rho=2700.0))
    tip = tb.Measurement(torch.zeros(3), 1e-3, sensor=tb.sensors.Position(0.5, beam), **of)
    with pytest.raises(ValueError, match="with the parameter 'g' was asked for without it"):
        tip.read(tb.State.stack([tb.rest(tb.Scene(beam))]), by)


def test_a_parameter_that_is_no_gain_is_refused():
    with pytest.raises(ValueError, match="the gain 'w' of shape"):
        tb.identify(lambda p: wave({"w": p["w"][:, 0]}), replace(gauge(), gain="w"),
                    {"w": [9.0, 9.0]})  # fmt: skip
    with pytest.raises(ValueError, match="parameter 'h'"):
        tb.identify(wave, replace(gauge(), gain="h"), {"w": 9.0})
