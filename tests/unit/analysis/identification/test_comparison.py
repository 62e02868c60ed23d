"""Comparisons of models: closed forms of evidence and of what is left out, the true one wins."""

import math
from dataclasses import replace

import pytest
import torch
from torch.distributions import MultivariateNormal, Normal

import torchbeam as tb

T = torch.linspace(-1, 1, 30)


def powers(p):
    """Polynomials of p terms: theta (N, p) in "c"."""
    basis = T[:, None] ** torch.arange(p)
    return lambda theta: theta["c"] @ basis.mT


def fitted(p, values, sigma=0.1, prior=1.0, **options):
    law = Normal(torch.zeros(p), prior) if prior else None
    start = {"c": tb.Parameter(torch.zeros(p), prior=law, scale=1.0)}
    return tb.identify(powers(p), tb.Measurement(values, sigma, times=T, **options), start)


def noisy(seed, c=(1.0, 0.5, -0.8), sigma=0.1):
    noise = torch.randn(30, generator=torch.Generator().manual_seed(seed))
    return powers(len(c))({"c": torch.tensor([c])})[0] + sigma * noise


def test_evidence_of_a_linear_model_is_that_of_its_normal_law():
    """y ~ N(0, sigma^2 + B B^T) with B (30, p): to 1e-8; also with noise that remembers."""
    values, models = noisy(0), {}
    for p in (2, 3, 4):
        models[f"{p}"] = fitted(p, values)
    compared = tb.compare(models, by="evidence")
    for name, value in zip(compared.names, compared.value.tolist(), strict=True):
        B = T[:, None] ** torch.arange(int(name))
        law = MultivariateNormal(torch.zeros(30), 0.01 * torch.eye(30) + B @ B.mT)
        assert value == pytest.approx(law.log_prob(values).item(), rel=1e-8)
    assert compared.names[0] == "3"
    remembers = fitted(2, values, noise="ar1")
    (rho,) = remembers.memory.values()
    lag = (torch.arange(30)[:, None] - torch.arange(30)).abs()
    B = T[:, None] ** torch.arange(2)
    law = MultivariateNormal(torch.zeros(30), 0.01 * rho**lag + B @ B.mT)
    pair = tb.compare({"a": remembers, "b": remembers}, by="evidence")
    assert pair.value[0].item() == pytest.approx(law.log_prob(values).item(), rel=1e-8)
    assert pair.said == ("'a' is the best, but 'b' (0 less) cannot be told from it",)


def test_offsets_are_flat_and_a_logarithm_has_its_own_density():
    """A level that is an offset beside one with a wide prior: their evidence differs by the
    logarithm of the prior's height; a model that searches a logarithm is compared by it."""
    values = noisy(1, (1.0, 0.5))

    def slope(theta):
        return theta["b"][:, None] * T

    start = {"b": tb.Parameter(0.5, prior=Normal(0.0, 1.0))}
    data = tb.Measurement(values, 0.1, times=T, offset=True)
    one, two = (tb.identify(slope, data, start) for _ in range(2))
    flat = tb.compare({"one": one, "two": two}, by="evidence").value[0].item()
    B = torch.stack((torch.ones(30), T), -1) * torch.tensor([1e3, 1.0])
    law = MultivariateNormal(torch.zeros(30), 0.01 * torch.eye(30) + B @ B.mT)
    height = Normal(0.0, 1e3).log_prob(torch.tensor(0.0)).item()
    assert flat == pytest.approx(law.log_prob(values).item() - height, abs=1e-5)
    other = fitted(2, values)
    with pytest.raises(ValueError, match="other offsets, drifts or hum each"):
        tb.compare({"one": one, "other": other}, by="evidence")


def test_one_reading_left_out_is_press():
    """e_i = r_i/(1 - h_ii) (Allen 1974), the density of each normal with variance
    sigma^2/(1 - h_ii)."""
    values = noisy(2)
    models = {f"{p}": fitted(p, values, prior=None) for p in (2, 3)}
    compared = tb.compare(models, blocks=30, gap=0)
    for k, name in enumerate(compared.names):
        B = T[:, None] ** torch.arange(int(name))
        H = B @ torch.linalg.pinv(B)
        left = 1 - H.diagonal()
        errors = (values - H @ values) / left
        law = Normal(0.0, 0.1 / left.sqrt())
        torch.testing.assert_close(compared.each[k], law.log_prob(errors), rtol=1e-8, atol=1e-8)
        press = (errors / 0.1).square().mean().sqrt()
        torch.testing.assert_close(compared.rms[k], press, rtol=1e-8, atol=0)
    less = compared.each[0] - compared.each[1]
    assert compared.names == ("3", "2")
    assert compared.difference[1].item() == pytest.approx(less.sum().item())
    assert compared.error[1].item() == pytest.approx(30**0.5 * less.std().item())


def test_blocks_and_gaps_are_fits_without_them():
    """Each density is that of a fit to the other blocks, refitted; the prior stays."""
    values = noisy(3)
    model = fitted(3, values)
    compared = tb.compare({"one": model, "two": model}, blocks=5, gap=2)
    for k in range(5):
        inside = torch.arange(6 * k, 6 * k + 6)
        out = (torch.arange(30) >= 6 * k - 2) & (torch.arange(30) < 6 * k + 8)
        fit = fitted(3, torch.where(out, torch.nan, values))
        B = T[:, None] ** torch.arange(3)
        law = MultivariateNormal(
            fit.y[inside] if not fit.y.isnan().any() else (B @ fit.theta)[inside],
            0.01 * torch.eye(6) + (B @ fit.covariance @ B.mT)[inside][:, inside],
        )
        expected = law.log_prob(values[inside]).item()
        assert compared.each[0, k].item() == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("draws", [10, pytest.param(50, marks=pytest.mark.long)])
def test_the_true_model_wins(draws):
    """Of a line, a parabola and an exponential, the parabola, in nine and more of ten draws of
    noise, by evidence and by prediction; where it does not it cannot be told from the best."""

    def bent(theta):
        return theta["c"][:, :1] + theta["c"][:, 1:] * torch.exp(-T)

    law = tb.Parameter(torch.zeros(2), prior=Normal(torch.zeros(2), 1.0), scale=1.0)
    won, told = dict.fromkeys(("evidence", "prediction"), 0), 0
    for seed in range(draws):
        values = noisy(100 + seed)
        data = tb.Measurement(values, 0.1, times=T)
        models = {"line": fitted(2, values), "parabola": fitted(3, values),
                  "bent": tb.identify(bent, data, {"c": law})}  # fmt: skip
        for by in won:
            compared = tb.compare(models, by=by)
            won[by] += compared.names[0] == "parabola"
            told += "'parabola'" in compared.said[0]
    assert min(won.values()) >= 0.9 * draws
    assert told >= 0.96 * 2 * draws


def test_experiments_are_blocks():
    """Four repeats of a line: each is predicted by the other three."""
    random = torch.Generator().manual_seed(0)
    data = {f"run {k}": tb.Measurement(0.5 * T + 0.1 * torch.randn(30, generator=random), times=T)
            for k in range(4)}  # fmt: skip
    line = tb.identify(lambda p: p["b"][:, None] * T, data, {"b": 1.0})
    level = tb.identify(lambda p: p["a"][:, None].expand(-1, 30), data, {"a": 1.0})
    compared = tb.compare({"level": level, "line": line})
    assert compared.each.shape == (2, 4)
    assert compared.names == ("line", "level")
    assert "ln density" in compared.summary() and "'line' is the best" in compared.summary()
    own = {"b": tb.Parameter(1.0, own=True)}
    each = tb.identify(lambda p: p["b"][:, None] * T, data, own)
    with pytest.raises(ValueError, match="one tells a parameter of the fit 'each' alone"):
        tb.compare({"line": line, "each": each})
    assert tb.compare({"line": line, "each": each}, blocks=5).each.shape == (2, 20)


def test_a_beam_by_both_engines():
    """A cantilever's swing: with damping or without, the same by each engine."""
    t, values = torch.linspace(0, 0.12, 7), {}

    def swing(theta, engine):
        EI = theta["EI"]
        section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=1.0, EI=EI, mass=0.2, inertia=1e-6)
        push = tb.TipLoad(force=lambda t: (0, 0, 0.1 * torch.sin(30 * t)))
        scene = tb.Scene(tb.Beam.straight(0.5, 1, section), [push, tb.Damping(theta["tau"])],
                         plane="xz")  # fmt: skip
        return tb.simulate(scene, t, step=0.02, engine=engine)

    tip = tb.sensors.TipPosition()["z"]
    true = {"EI": torch.ones(1), "tau": torch.full((1,), 0.02)}
    y = tb.observe(swing(true, "eager"), tip, t)[:, 0]
    y = y + 1e-4 * torch.randn(y.shape, generator=torch.Generator().manual_seed(0))
    data = tb.Measurement(y, 1e-4, times=t, sensor=tip)
    start = {"EI": tb.Parameter(1.1, "log", prior=Normal(1.0, 0.5))}
    damped = {**start, "tau": tb.Parameter(0.01, prior=Normal(0.02, 0.02))}
    for engine in ("compiled", "eager"):
        fits = {
            "damped": tb.identify(lambda p, e=engine: swing(p, e), data, damped,
                                  derivatives="difference"),
            "free": tb.identify(lambda p, e=engine: swing({**p, "tau": 0.0 * p["EI"]}, e), data,
                                start, derivatives="difference"),
        }  # fmt: skip
        for by in ("evidence", "prediction"):
            values[engine, by] = tb.compare(fits, by=by)
            assert values[engine, by].names[0] == "damped"
    for by in ("evidence", "prediction"):
        one, two = (values[engine, by].value for engine in ("compiled", "eager"))
        torch.testing.assert_close(one, two, rtol=1e-5, atol=1e-3)


VALUES = noisy(5)
REFUSED = {
    "no fits": (lambda: dict(fits={"a": 3.0}), "two or more, name -> tb.Fit"),
    "other data": (lambda: dict(fits={"a": fitted(2, VALUES), "b": fitted(2, VALUES + 1)}),
                   "'b' was given, whose data are others than those of 'a'"),
    "no prior": (lambda: dict(fits=dict.fromkeys("ab", fitted(2, VALUES, prior=None)),
                              by="evidence"), "whose parameter 'c' has no prior"),
    "blocks": (lambda: dict(fits=dict.fromkeys("ab", fitted(2, VALUES, noise="blocks")),
                            by="evidence"), "no normal one of a known size"),
    "loss": (lambda: dict(fits=dict.fromkeys("ab", fitted(2, VALUES, loss="huber"))),
             "with a loss that is no square"),
    "a kind": (lambda: dict(fits=dict.fromkeys("ab", fitted(2, VALUES)), by="odds"),
               "by = 'odds' was given"),
    "one block": (lambda: dict(fits=dict.fromkeys("ab", fitted(2, VALUES)), blocks=1),
                  "blocks = 1"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_refusals(what):
    make, words = REFUSED[what]
    with pytest.raises(ValueError, match=words) as refusal:
        tb.compare(**make())
    assert "\n" not in str(refusal.value)


def test_a_parameter_at_its_bound_has_no_evidence():
    start = {"c": tb.Parameter(torch.full((2,), 0.2), bounds=(0.1, 0.3), scale=1.0,
                               prior=Normal(torch.zeros(2), 1.0))}  # fmt: skip
    fit = tb.identify(powers(2), tb.Measurement(VALUES, 0.1), start)
    with pytest.raises(ValueError, match="at its bound"):
        tb.compare({"a": fit, "b": fit}, by="evidence")
    assert tb.compare({"a": fit, "b": fit}, gap=0).value.isfinite().all()
    with pytest.raises(ValueError, match="from a file, which has no model"):
        tb.compare({"a": fit, "b": replace(fit, problem=None)})


def test_noise_that_was_found_by_channel_is_integrated():
    """Evidence with a deviation that was found is that over its logarithm, by quadrature, to
    Laplace's error (2 %)."""
    law = {"c": tb.Parameter(torch.zeros(2), prior=Normal(torch.zeros(2), 1.0), scale=1.0)}
    fit = tb.identify(powers(2), tb.Measurement(VALUES, times=T), law, noise="channel")
    found = tb.compare({"a": fit, "b": fit}, by="evidence").value[0].item()
    B = T[:, None] ** torch.arange(2)
    logs = torch.linspace(math.log(0.05), math.log(2.0), 400)
    terms = [MultivariateNormal(torch.zeros(30), s.exp() ** 2 * torch.eye(30) + B @ B.mT)
             .log_prob(VALUES) for s in logs]  # fmt: skip
    exact = (torch.stack(terms).logsumexp(0) + (logs[1] - logs[0]).log()).item()
    assert found == pytest.approx(exact, abs=0.02)
