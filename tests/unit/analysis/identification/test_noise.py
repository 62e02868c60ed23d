"""Noise found by channel: restricted likelihood, degrees of freedom, what is refused."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.wave_cases import CLEAN, NOISE, T, wave
from torchbeam.math.distributions import student_quantile


def drawn(sizes, sigma, seed=0):
    random = torch.Generator().manual_seed(seed)
    return [s * torch.randn(n, generator=random) for n, s in zip(sizes, sigma, strict=True)]


def restricted(X, y, groups, variances):
    """Minus the restricted log-likelihood of y = X theta + noise with a variance for each group."""
    V = torch.stack([v * (groups == g) for g, v in enumerate(variances)]).sum(0)
    A = X.T @ (X / V[:, None])
    r = y - X @ torch.linalg.solve(A, X.T @ (y / V))
    return (V.log().sum() + torch.logdet(A) + (r.square() / V).sum()) / 2


def test_restricted_maximum_likelihood():
    """Two straight lines through one point, in three channels with noise of three sizes: deviations
    are where the gradient of the restricted likelihood vanishes; theta and covariance are those of
    weighted normal equations; degrees of freedom those of the information matrix
    tr(P V_c P V_d) / 2 by dense matrices.
    """
    sizes, sigma = (7, 12, 5), (0.02, 0.3, 0.1)
    times = [torch.linspace(0, 1, n) for n in sizes]
    rows = [torch.stack((torch.ones_like(t), t, 0 * t), -1) for t in times[:2]]
    rows.append(torch.stack((torch.ones(5), torch.zeros(5), times[2]), -1))
    data = [
        x @ torch.tensor([1.0, -0.5, 2.0]) + e
        for x, e in zip(rows, drawn(sizes, sigma), strict=True)
    ]
    measured = [tb.Measurement(values, name=name) for values, name in zip(data, "abc", strict=True)]
    fit = tb.identify(
        lambda theta: [theta @ x.T for x in rows], measured, (0.5, 0.5, 0.5), noise="channel"
    )
    X, y = torch.cat(rows), torch.cat(data)
    groups = torch.arange(3).repeat_interleave(torch.tensor(sizes))
    found = torch.tensor([fit.noise[name] for name in "abc"])
    logs = (2 * found.log()).requires_grad_()
    (slope,) = torch.autograd.grad(restricted(X, y, groups, logs.exp()), logs)
    # of some 2 to 5 half degrees of freedom: sizes to 1e-3
    assert_close(slope, torch.zeros(3), rtol=0, atol=5e-3)
    W = torch.diag((1 / found.square())[groups])
    C = torch.linalg.inv(X.T @ W @ X)
    assert_close(fit.theta, C @ X.T @ W @ y, rtol=1e-4, atol=0)
    assert_close(fit.covariance, C, rtol=5e-3, atol=0)
    P = W - W @ X @ C @ X.T @ W
    # by the logarithms of the variances
    parts = [torch.diag(found[g].square() * (groups == g)) for g in range(3)]
    information = torch.tensor([[(P @ a @ P @ b).trace() / 2 for a in parts] for b in parts])
    share = torch.stack([(C @ X.T @ W @ a @ W @ X @ C).diagonal() / C.diagonal() for a in parts])
    wanted = 2 / torch.einsum("cj,cd,dj->j", share, torch.linalg.inv(information), share)
    assert_close(fit.freedom, wanted, rtol=1e-2, atol=0)
    t = torch.tensor([student_quantile(0.975, f) for f in fit.freedom.tolist()])
    assert_close(fit.interval()[:, 1] - fit.theta, t * fit.deviation, rtol=1e-6, atol=0)
    assert "noise found: a 0.0" in fit.summary() and fit.status == 0
    assert_close(fit.readings[1].sigma, found[1].expand(12), rtol=1e-6, atol=0)


def test_channels_beside_a_known_one():
    """Two channels of one record, times as a third of the readings are missing, beside a ruler that
    is known; a prior is weighed against the noise that is found; from several starts; deviations to
    3 of their own deviations.
    """
    e = drawn((40, 40), (0.02, 0.4), 1)
    values = torch.stack((CLEAN + e[0], 3 * CLEAN + e[1] + 0.5), -1)
    values[::3, 1] = math.nan

    def model(theta):
        return torch.stack((wave(theta), 3 * wave(theta)), -1)

    data = {
        "strike": tb.Measurement(values, times=T, offset=True, name="laser"),
        "ruler": tb.Measurement(2.01, 0.01),
    }
    start = {
        "a": tb.Parameter(1.0, "log"),
        "b": tb.Parameter(1.0, "log", prior=torch.distributions.LogNormal(0.0, 1.0)),
    }
    fit = tb.identify(
        {"strike": model, "ruler": lambda theta: theta["a"]}, data, start, noise="channel", starts=5
    )
    assert (
        fit.status == 0
        and list(fit.noise) == ["strike laser 0", "strike laser 1"]
        and (fit.statuses == 0).all()
    )
    for found, true, n in zip(fit.noise.values(), (0.02, 0.4), (40, 26), strict=True):
        assert abs(math.log(found / true)) < 3 / math.sqrt(2 * (n - 2))
    assert ((fit.theta - torch.tensor([2.0, 0.7, 0.0, 0.5])).abs() < 3 * fit.deviation).all()
    # the ruler's sigma is known; the second offset is seen by its 26
    assert fit.freedom[0] > 40 > fit.freedom[3] > 24
    assert fit.readings[1].sigma == 0.01
    known = {
        "strike": tb.Measurement(values, fit.readings[0].sigma, T, offset=True),
        "ruler": data["ruler"],
    }
    alone = tb.identify({"strike": model, "ruler": lambda theta: theta["a"]}, known, start)
    assert_close(fit.theta, alone.theta, rtol=1e-3, atol=1e-4)
    assert_close(fit.covariance, alone.covariance, rtol=1e-2, atol=1e-8)
    for method in ("profile", "bootstrap"):  # the bootstrap's noise is found anew: some 26 readings
        assert (
            (fit.interval(method=method) - fit.interval()).abs() < 0.5 * fit.deviation[:, None]
        ).all()


def test_one_channel_is_the_common_noise():
    common = tb.identify(wave, CLEAN + NOISE, {"a": 1.0, "b": 1.0})
    own = tb.identify(wave, CLEAN + NOISE, {"a": 1.0, "b": 1.0}, noise="channel")
    for name in ("theta", "freedom", "covariance"):
        assert_close(getattr(own, name), getattr(common, name), rtol=3e-3, atol=0)
    assert (
        own.noise["data"] == pytest.approx(common.scale, rel=2e-3)
        and own.scale == 1
        and not common.noise
    )
    assert_close(own.interval(), common.interval(), rtol=1e-3, atol=0)


@pytest.mark.parametrize("noise", ["common", "channel"])
def test_numbers_that_the_model_has_fitted(noise):
    """A factor of each of four rows, found by the model (as a mode shape's scale) or by the search:
    the same parameter, noise and degrees of freedom.
    """
    X = torch.exp(-0.4 * T[:8])
    random = torch.Generator().manual_seed(2)
    rows = torch.tensor([1.0, -2.0, 0.5, 3.0])[:, None] * X + 0.05 * torch.randn(
        4, 8, generator=random
    )

    def shape(theta):
        return torch.exp(-theta["b"][:, None] * T[:8])

    def scaled(theta):
        y = shape(theta)
        factor = (y @ rows.T) / y.square().sum(-1, keepdim=True)
        return (factor[..., None] * y[:, None]).flatten(1)

    start = {"b": 1.0}
    by_model = tb.identify(scaled, tb.Measurement(rows.flatten(), fitted=4), start, noise=noise)
    by_search = tb.identify(
        lambda theta: (theta["c"][..., None] * shape(theta)[:, None]).flatten(1),
        rows.flatten(),
        {**start, "c": torch.ones(4)},
        noise=noise,
    )
    assert_close(by_model["b"], by_search["b"], rtol=1e-3, atol=0)
    assert_close(by_model.freedom[0], by_search.freedom[0], rtol=1e-3, atol=0)
    assert_close(by_model.freedom[0], torch.tensor(27.0), rtol=1e-6, atol=0)
    assert_close(by_model.interval()[0], by_search.interval()[0], rtol=1e-3, atol=0)


def test_a_line_in_the_channels_costs_few_runs():
    """Two channels of a decaying oscillation, both with a line next to its frequency that the model
    misses: rounds in turn with the noise, which converge slowly, ask for no runs but where the
    tangent has settled (484 samples of the model where each round asked, 49 of a common noise).
    """
    t, samples = torch.linspace(0, 5, 161), [0]
    factors = torch.tensor([1.0, -2.0])

    def ringing(theta):
        samples[0] += len(theta["w"])
        phase = theta["w"][:, None] * t
        return (torch.exp(-theta["d"][:, None] * t) * torch.cos(phase))[..., None] * factors

    clean = ringing({"w": torch.tensor([10.0]), "d": torch.tensor([0.1])})[0]
    noise = 0.02 * torch.stack(drawn((161, 161), (1.0, 2.0), 4), -1)
    data = clean + noise + 0.05 * torch.sin(10.05 * t)[:, None] * factors.abs()
    runs = {}
    for kind in ("common", "channel"):
        samples[0] = 0
        start = {"w": tb.Parameter(10.3, "log"), "d": tb.Parameter(0.07, "log")}
        fit = tb.identify(ringing, tb.Measurement(data, times=t, name="a"), start, noise=kind)
        assert fit.status == 0
        runs[kind] = samples[0]
    assert runs["channel"] < 3 * runs["common"]


# fmt: off
REFUSED = {
    "one reading": (dict(data=[tb.Measurement(CLEAN), tb.Measurement(1.0, name="ruler")]),
                    "'ruler' of 1 readings; the sigma"),
    "as many parameters": (dict(data=[tb.Measurement(CLEAN),
                                      tb.Measurement([1.0, 3.0], offset=True, drift=True,
                                                     name="pair")]),
                           "'pair' of 2 readings, of which the parameters leave 0"),
    "relative sigma": (dict(data=tb.Measurement(CLEAN, 0.1), absolute_sigma=False),
                       "with absolute_sigma=False"),
    "fitted": (dict(data=tb.Measurement(CLEAN, fitted=39)), "'data' of 40 readings"),
    "another word": (dict(data=CLEAN, noise="row"), "noise = 'row'"),
}
# fmt: on


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    changed, sentence = REFUSED[name]

    def model(theta):
        parts = [wave(theta), theta["a"] if name == "one reading" else wave(theta)[:, :2]]
        return parts if isinstance(changed["data"], list) else parts[0]

    with pytest.raises(ValueError, match=sentence):
        tb.identify(model, start={"a": 1.0, "b": 1.0}, **{"noise": "channel", **changed})


@pytest.mark.long
def test_intervals_hold_the_truth():
    """A mean of six readings of a fine instrument and eight of a coarse one, a thousand times: 95 %
    intervals by Satterthwaite hold the truth in 93 to 97 % (one deviation of the count 0.7 %),
    those of the normal law in less.
    """
    held = normal = 0
    for k in range(1000):
        a, b = drawn((6, 8), (0.1, 0.3), 10 + k)
        fit = tb.identify(
            lambda theta: [theta[:, :1].expand(-1, 6), theta[:, :1].expand(-1, 8)],
            [tb.Measurement(a + 1), tb.Measurement(b + 1)],
            (0.5,),
            noise="channel",
            derivatives="forward",
        )
        low, high = fit.interval()[0]
        held += low <= 1 <= high
        normal += abs(fit.theta - 1) <= 1.96 * fit.deviation
    assert 930 <= held <= 970 and normal < held


def pendulum(theta):
    """A small swing of a stiff link on a spring: place and acceleration of its tip."""
    section = tb.Section.rectangle(0.03, 0.001, E=theta["E"], nu=0.3, rho=7850.0)
    beam = tb.Beam.straight(0.3, 2, section, order=2)
    pull = tb.TipLoad(force=lambda t: (0, 0, 0.5 * (t < 0.02)))
    scene = tb.Scene(beam, [pull, tb.Damping(4e-4)], plane="xz")
    return tb.simulate(scene, torch.linspace(0, 0.2, 101), step=2e-3, engine="compiled")


def two_instruments(sigma=(None, None), count=90):
    """A laser with noise of 0.05 mm and an accelerometer with 0.5 m/s^2."""
    t, true = torch.linspace(0.01, 0.19, count), pendulum({"E": torch.tensor([2.05e11])})
    z, v = tb.sensors.TipPosition()["z"], tb.sensors.NodeVelocity(2)["z"]
    noise = [torch.randn(n, generator=torch.Generator().manual_seed(n)) for n in (count, 90)]
    late = torch.linspace(0.01, 0.19, 90)
    near = tb.observe(true, z, t)[:, 0, 0] + 5e-5 * noise[0]
    fast = tb.observe(true, v, late, rate=True)[:, 0, 0] + 0.5 * noise[1]
    return [
        tb.Measurement(near, sigma[0], t, z, name="laser"),
        tb.Measurement(fast, sigma[1], late, v, rate=True, name="accelerometer"),
    ]


def test_units_do_not_share_a_deviation():
    """Metres and m/s^2 have noise of their own, found to a fifth, and the parameter is as well
    known as with these sigma.
    """
    start = {"E": tb.Parameter(1.95e11, "log")}
    known, free = (
        tb.identify(pendulum, two_instruments(sigma), start, derivatives="difference")
        for sigma in ((5e-5, 0.5), (None, None))
    )
    assert free.noise["m"] == pytest.approx(5e-5, rel=0.2)
    assert free.noise["m/s^2"] == pytest.approx(0.5, rel=0.2)
    assert free.deviation.item() == pytest.approx(known.deviation.item(), rel=0.2)
    assert abs(free["E"].item() - known["E"].item()) < 0.5 * known.deviation.item()


def test_units_with_too_few_readings_share_one_with_a_doubt():
    start = {"E": tb.Parameter(1.95e11, "log")}
    fit = tb.identify(pendulum, two_instruments(count=2), start, derivatives="difference")
    assert any("in m and m/s^2 share one deviation" in doubt for doubt in fit.doubts)
