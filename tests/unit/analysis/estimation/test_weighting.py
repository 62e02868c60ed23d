"""Readings that miss by much: left out by a gate, or of less weight by a loss."""

import math
import pickle

import pytest
import torch
from torch.distributions import LogNormal

import torchbeam as tb
from torchbeam.analysis.estimation import weighting
from torchbeam.analysis.identification.losses import HUBER, STUDENT

from .test_kalman_filter import DT, NAN, TIP, randn, strip, up

NOISE = 1e-3
WINDOWS = {tb.MovingHorizon: {"window": 4}}
ROOT = -math.log(2 * math.pi) / 2  # log density of a normal law at 0


def linear(estimator=tb.KalmanFilter, **options):
    """Of a linear strip under a white force."""
    given = dict(dt=DT, noise=NOISE, process={"u": up(0.3)})
    return estimator(strip(small=True, plane=None), TIP, **{**given, **options})


def stiff(estimator=tb.KalmanFilter, **options):
    """Of strips of an unknown stiffness, by two modes."""
    E = tb.Parameter(1.0, transform="log", prior=LogNormal(0.0, 0.1))
    model = tb.linearize(strip(), inputs={"u": (0.0, 0, 0)}).reduced(2)
    given = dict(dt=DT, noise=NOISE, parameters={"E": E}, model=model, bias=2e-3)
    return estimator(lambda p: strip(p["E"]), TIP, **{**given, **options})


@pytest.mark.steps
@pytest.mark.parametrize("estimator", [tb.KalmanFilter, tb.MovingHorizon])
@pytest.mark.parametrize("absurd", [10.0, 1e6, 1e200, math.inf, NAN])
def test_an_absurd_reading_is_none(estimator, absurd):
    """What is known after it, and later, is to rounding what is known without, and neighbours' is;
    it is told.
    """
    f = stiff(estimator, gate=1 - 1e-9, **WINDOWS.get(estimator, {}))
    y = NOISE * randn(6, 2, 1)
    lost = y.clone()
    y[3, 0], lost[3, 0] = absurd, NAN
    start = f.start(2, amplitude=0.01)
    found, best = f.run(start, y), f.run(start, lost)
    scale = best[-1].factor.norm(dim=-2).clamp(min=1e-9)
    assert ((found[-1].x - best[-1].x) / scale).abs().max() < 1e-9
    assert found[3].weight.tolist() == [[0.0], [1.0]] and found[3].readings.tolist() == [0, 1]
    assert found[-1].log_likelihood.isfinite().all() and found[-1].doubt is None
    assert (found[-1].log_likelihood - best[-1].log_likelihood).abs()[1] < 1e-9


@pytest.mark.steps
@pytest.mark.parametrize("estimator", [tb.KalmanFilter, tb.MovingHorizon])
def test_a_gate_finds_back(monkeypatch, estimator):
    """Of two strips, one is pushed by ten deviations of the force that is expected: a gate alone
    leaves out its readings to the end, and is 0.1 m off; with the readings that count again the
    estimate is within four deviations of noise. The other has single absurd readings, which are
    missing. Each is what it is alone.
    """
    model = tb.linearize(strip(), inputs={"u": up(0)}).reduced(2)
    given = dict(dt=DT, noise=NOISE, process={"u": (up(0.05), 0.5)}, gate=1 - 1e-9, model=model)
    f = estimator(strip(), TIP, **given, **WINDOWS.get(estimator, {}))
    step, true, tip = tb.Stepper(strip(), DT), f.start(2).state, []
    pushed = torch.tensor([up(0.5), up(0.0)])
    for k in range(36):
        true = step(true, inputs={"u": pushed * (k > 2)})
        tip.append(true.tip.position[..., 2:])
    y = torch.stack(tip) + NOISE * randn(36, 2, 1)
    y[[4, 14, 24], 1, 0] = torch.tensor([1e6, -math.inf, 10.0])
    lost = y.clone()
    lost[[4, 14, 24], 1] = NAN
    found = f.run(f.start(2), y)
    off = (found[-1].state.tip.position[..., 2:] - true.tip.position[..., 2:])[:, 0].abs()
    assert (off < 4 * NOISE).all() and (found[-1].weight == 1).all()
    left_out = [z.weight[0, 0].item() for z in found].count(0)
    assert left_out == weighting.AGAIN and [z.weight[1, 0] for z in found].count(0) == 3
    for k, each in enumerate((y[:, 0], lost[:, 1])):
        alone = f.run(f.start(), each)[-1]
        scale = alone.factor.norm(dim=-2)
        assert ((alone.x - found[-1].x[k]) / scale).abs().max() < 1e-9
    monkeypatch.setattr(weighting, "AGAIN", math.inf)
    z = f.run(f.start(), y[:, 0])[-1]
    assert z.weight == 0 and (z.state.tip.position - true.tip.position[0]).norm() > 0.1


def test_a_reading_beyond_the_gate_counts_as_at_it():
    """In the likelihood, by which models are compared: what a reading at the gate would say."""
    level = 0.999
    f, free = linear(gate=level), linear()
    before = f.predict(f.start(amplitude=0.01))
    reach = torch.distributions.Normal(0.0, 1.0).icdf(torch.tensor((1 + level) / 2))
    at = free(free.start(amplitude=0.01), before.readings)
    spread = torch.exp(-at.log_likelihood) / math.sqrt(2 * math.pi)  # the density's peak
    inside, outside = (
        f.update(before, before.readings + side * reach * spread) for side in (0.999, 1.001)
    )
    assert inside.weight == 1 and outside.weight == 0
    assert abs(inside.log_likelihood - outside.log_likelihood) < 2e-3 * reach**2


def test_what_counts_at_the_gate_is_told_by_its_count():
    """Not by its error, which a reading may have by chance, and which rounding of the sources
    (4e-16 here) moves off the gate.
    """
    law = weighting.Weighting(None, 2.0, torch.tensor([NOISE]))
    sources, missed = torch.tensor([[2 * NOISE, NOISE]]), torch.tensor([0.0, weighting.AGAIN])
    gate = law.reach * law.deviation(sources)
    error, missed = law.clipped(sources, gate * torch.tensor([1.0, 1.5]), missed)
    assert torch.equal(error, gate) and missed.tolist() == [0, weighting.AGAIN + 1]
    near = sources * (1 - 2**-51)
    weight = law(near, error, missed).where(missed > 0, 1.0)
    assert weight.tolist() == [1, 1]
    squares = law.beyond(near, error, missed, weight).squares
    assert squares == law.beyond(near[:, 1:], error[1:], missed[1:], weight[1:]).squares
    assert law.beyond(near[:, :1], error[:1], missed[:1], weight[:1]).squares == 0 < squares
    nothing = torch.full_like(error, NAN)
    assert law(near, nothing, missed).tolist() == [0, 0]
    assert law.beyond(near, nothing, missed, weight).squares == 0


@pytest.mark.parametrize("loss", ["huber", "student"])
def test_a_loss_finds_the_most_likely_motion(loss):
    """Of one reading of a linear structure, whose error has the density of the loss: where the
    slope of half the squares of the motion's change is that of the loss, to 1e-3 of it. Huber's is
    its corner.
    """
    f, plain = linear(loss=loss), linear()
    start = f.start(amplitude=NOISE)
    expected = plain.predict(start).readings
    P = NOISE**2 * (1 / plain(start, expected + NOISE).nis - 1)  # nis = R / (P + R)
    for error in (0.5 * NOISE, 20 * NOISE, 1e3 * NOISE):
        z = f(start, expected + error)
        x = plain.interval.slope_of(TIP.flat, z.state)[0] - expected
        residual = (error - x) / NOISE
        slope = {
            "huber": residual.clamp(-HUBER, HUBER),
            "student": (STUDENT + 1) * residual / (STUDENT + residual**2),
        }[loss]
        assert abs(x * NOISE / P - slope) < 1e-3 * slope.abs() + 1e-6
        assert (z.weight < 0.1) == (error > NOISE)
    far = plain.interval.slope_of(TIP.flat, f(start, [1e9]).state)[0] - expected
    assert abs(far) < 1e-4 * NOISE if loss == "student" else abs(far - x) < 1e-3 * x


@pytest.mark.parametrize("loss", ["huber", "student"])
def test_a_likelihood_is_that_of_the_loss(loss):
    """Of one reading, whose noise has the density of the loss: near, to the 0.2 of Laplace's
    approximation, and far off to 0.05, what the trapezoidal rule has over the motion; least squares
    miss by 1e4. The likelihoods that an absurd reading gives to models of other deviations differ
    by what the rule has, to 1e-3.
    """
    law = {"huber": weighting.log_huber, "student": weighting.log_student}[loss]
    f, plain = linear(loss=loss), linear()

    def both(error, amplitude):
        before = plain.predict(plain.start(amplitude=amplitude))
        P = NOISE**2 * (1 / plain.update(before, before.readings + NOISE).nis - 1)
        x = torch.linspace(-40, 40, 400001) * P.sqrt()
        density = law((error - x) / NOISE) - x.square() / (2 * P)
        best = density.logsumexp(-1) + (x[1] - x[0]).log() + 2 * ROOT - (P.sqrt() * NOISE).log()
        return f(f.start(amplitude=amplitude), before.readings + error).log_likelihood, best

    for error, within in ((0.0, 0.2), (0.7, 0.2), (500.0, 0.05)):
        log_likelihood, best = both(error * NOISE, 3 * NOISE)
        assert abs(log_likelihood - best) < within
    (a, b), (c, d) = both(100.0, 3 * NOISE), both(100.0, 4.5 * NOISE)
    assert abs((c - a) - (d - b)) < 1e-3


def test_densities_of_losses_have_an_integral_of_one():
    """By the trapezoidal rule, to what is left beyond: Student's falls by the fourth power."""
    u = torch.linspace(-1e3, 1e3, 2000001)
    for law in weighting.LOG_DENSITIES.values():
        assert abs(torch.trapezoid((law(u) + ROOT).exp(), u) - 1) < 1e-9


@pytest.mark.steps
def test_a_loss_weighs_each_sample_alone():
    """A batch, and its samples by themselves: readings of two sensors that lie off by more and
    more.
    """
    f = tb.KalmanFilter(
        strip(small=True, plane=None),
        [TIP, tb.sensors.NodeVelocity(1)["z"]],
        dt=DT,
        noise=(1e-3, 1e-2),
        process={"u": up(0.3)},
        loss="student",
    )
    y = torch.tensor([[0.0, 0.0], [5e-3, 0.1], [0.1, 0.0], [1e6, 1e6], [NAN, 1e-2]])
    both = f(f.start(5, amplitude=0.01), y)
    for k in range(5):
        alone = f(f.start(amplitude=0.01), y[k])
        assert (alone.weight - both.weight[k]).abs().max() < 1e-12
    assert both.weight[4, 0] == 0 and (both.weight[3] < 1e-6).all()


@pytest.mark.parametrize("loss", ["huber", "student"])
def test_a_window_weighs_each_sample_alone(loss):
    """A batch, and its samples by themselves, to rounding: weights of one sample may take more
    rounds than its neighbours'.
    """
    f = stiff(tb.MovingHorizon, window=3, loss=loss)
    y = NOISE * randn(4, 2, 1)
    y[2, 0], y[3, 1] = 0.05, -3.0
    both = f.run(f.start(2, amplitude=0.01), y)[-1]
    for k in range(2):
        alone = f.run(f.start(amplitude=0.01), y[:, k])[-1]
        scale = alone.factor.norm(dim=-2).clamp(min=1e-9)
        assert ((alone.x - both.x[k]) / scale).abs().max() < 1e-9


@pytest.mark.parametrize("gate", [0.8, 0.95])
def test_a_narrow_gate_is_no_doubt(gate):
    """Of a model that is right: errors that are judged have the mean square of a normal law, of
    20000 readings to four of its deviations; readings far off are a doubt.
    """
    f, B = linear(gate=gate), 20000
    before = f.predict(f.start(amplitude=0.01))
    spread = NOISE / f.update(before, before.readings + NOISE).nis.sqrt()
    z = f.update(before, before.readings + spread * randn(B, 1))
    assert abs(1 - z.weight.mean() - (1 - gate)) < 4 * (gate * (1 - gate) / B) ** 0.5
    squares = z.lately[..., 0].mean()
    assert abs(squares - 1) < 4 * (2 / B) ** 0.5
    z = f.start(amplitude=0.01)
    for k in range(20):
        z = f(z, [0.1 * (-1) ** k])
    assert z.doubt is not None


@pytest.mark.parametrize("loss", ["huber", "student"])
@pytest.mark.parametrize("estimator", [tb.KalmanFilter, tb.MovingHorizon])
def test_the_largest_number_is_a_reading_that_says_little(estimator, loss):
    """What files have in place of a number that is missing, whose square is infinite: no doubt, if
    it is not the first.
    """
    f = stiff(estimator, loss=loss, **WINDOWS.get(estimator, {}))
    y = NOISE * randn(6, 1)
    y[3] = torch.finfo(y.dtype).max
    z = f.run(f.start(amplitude=0.01), y)[-1]
    assert z.x.isfinite().all() and z.log_likelihood.isfinite() and z.doubt is None


def test_a_filter_with_a_loss_is_saved():
    f = linear(loss="huber", gate=0.999)
    again, y = pickle.loads(pickle.dumps(f)), [0.02]
    assert torch.equal(again(again.start(amplitude=0.01), y).x, f(f.start(amplitude=0.01), y).x)


def test_a_gate_next_to_one_is_wide():
    """8.2 deviations: of the largest number below 1."""
    assert 8.2 < linear(gate=math.nextafter(1.0, 0.0)).weighting.reach < 8.4


@pytest.mark.parametrize(
    ("given", "sentence"), [(dict(gate=1.0), "gate"), (dict(loss="cauchy"), "loss")]
)
def test_what_is_refused(given, sentence):
    with pytest.raises(ValueError, match=sentence):
        linear(**given)
