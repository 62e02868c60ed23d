"""Identification beyond a vector: parameters by name, priors, several experiments, measurements, uncertainty, files."""

import math

import pytest
import torch
from torch.distributions import Dirichlet, Gamma, HalfNormal, LogNormal, Normal, TransformedDistribution, Uniform
from torch.distributions.transforms import SigmoidTransform
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.analysis.identification import profile, student

T = torch.linspace(0, 2, 40)


def wave(theta):
    """a exp(-b t) (N, T), by name."""
    return theta["a"][:, None] * torch.exp(-theta["b"][:, None] * T)


CLEAN = 2.0 * torch.exp(-0.7 * T)
NOISE = 0.05 * torch.randn(40, generator=torch.Generator().manual_seed(3))


def test_parameters_by_name():
    """Numbers and tensors of any shape, each with its own coordinate; `fit[name]` has its shape."""
    def model(theta):
        assert theta["c"].shape[1:] == (2, 3) and theta["a"].ndim == 1
        return torch.cat((theta["c"].flatten(1), theta["a"][:, None] * theta["b"][:, None], theta["b"][:, None]), -1)

    data = torch.tensor([1.0, -2, 3, -4, 5, 6, 2.0, 0.25])
    start = {"a": tb.Parameter(1.0, "log"), "c": torch.zeros(2, 3), "b": tb.Parameter(0.5, "logit", bounds=(0, 1))}
    fit = tb.identify(model, data, start)
    assert fit.names == ("a", *(f"c[{i}]" for i in range(6)), "b") and fit.status == 0
    assert_close(fit["c"], data[:6].reshape(2, 3), rtol=1e-6, atol=1e-9)
    assert_close(torch.stack((fit["a"], fit["b"])), torch.tensor([8.0, 0.25]), rtol=1e-6, atol=0)
    assert fit["c[1]"] == fit["c"][0, 1]


def test_logit_stays_inside():
    """Data that pull a parameter to its bound: it ran away to it, and nothing on the way is beyond."""
    fit = tb.identify(wave, CLEAN, {"a": 1.0, "b": tb.Parameter(0.2, "logit", bounds=(0.0, 0.5))})
    assert (fit.history[..., 1] < 0.5).all() and fit["b"] > 0.499
    plain = tb.identify(wave, CLEAN, {"a": 1.0, "b": tb.Parameter(0.2, bounds=(0.0, 0.5))})
    logarithm = tb.identify(wave, CLEAN, {"a": 1.0, "b": tb.Parameter(0.2, "log", bounds=(0.01, 0.5))})
    for one in (plain, logarithm):
        assert_close(one["b"].item(), 0.5, rtol=1e-12, atol=0)
        assert "b is at its bound, 0.5" in one.message
    assert_close(plain["a"], fit["a"], rtol=1e-2, atol=0)


def test_a_bound_is_gone_along():
    """With b held at its bound, a is the best for that b: linear least squares."""
    fit = tb.identify(wave, CLEAN, {"a": 5.0, "b": tb.Parameter(0.2, bounds=(0.0, 0.5))})
    shape = torch.exp(-0.5 * T)
    assert_close(fit["a"], (shape @ CLEAN) / (shape @ shape), rtol=1e-6, atol=0)


@pytest.mark.parametrize("derivatives", ["difference", "forward", "adjoint"])
@pytest.mark.parametrize("prior", [Normal(1.0, 0.1), LogNormal(0.0, 0.05), Gamma(50.0, 40.0)], ids=lambda p: type(p).__name__)
def test_priors(prior, derivatives):
    """The mode of the posterior of a mean: the root of its derivative, found by bisection; and, of a normal prior, the known
    mean and deviation.
    """
    data, sigma = torch.tensor([1.5, 1.7, 1.3]), 0.2
    fit = tb.identify(lambda theta: theta["m"][:, None].expand(-1, 3), data, {"m": tb.Parameter(1.0, "log", prior=prior)},
                      sigma=sigma, derivatives=derivatives)

    def slope(m):
        m = torch.tensor(m, requires_grad=True)
        loss = ((m - data) / sigma).square().sum() / 2 - prior.log_prob(m)
        return torch.autograd.grad(loss, m)[0].item()

    low, high = 0.5, 3.0
    for _ in range(60):
        low, high = ((low + high) / 2, high) if slope((low + high) / 2) < 0 else (low, (low + high) / 2)
    assert fit.status == 0
    assert_close(fit["m"].item(), low, rtol=1e-4 if derivatives == "adjoint" else 1e-6, atol=0)
    if isinstance(prior, Normal):
        precision = 3 / sigma**2 + 1 / 0.1**2
        assert_close(fit["m"].item(), (data.sum().item() / sigma**2 + 1.0 / 0.1**2) / precision, rtol=1e-4, atol=0)
        assert_close(fit.deviation.item(), precision**-0.5, rtol=1e-4, atol=0)


def test_a_prior_tells_what_data_do_not():
    """A product of two: with a prior on one, both are determined, the other's deviation that of the prior."""
    def model(theta):
        return (theta["a"] * theta["b"])[:, None] * T

    start = {"a": tb.Parameter(1.0, "log"), "b": tb.Parameter(1.5, "log", prior=LogNormal(0.0, 0.1))}
    fit = tb.identify(model, 2 * T, start, sigma=1e-3)
    assert fit.status == 0 and not fit.unidentifiable
    assert_close(fit.deviation / fit.theta, torch.tensor([0.1, 0.1]), rtol=1e-2, atol=0)


def test_fewer_data_than_parameters_with_priors():
    """One reading of a sum: each number gives way as its prior is wide; mean and covariance of the conditional normal law."""
    prior = {"a": Normal(1.0, 0.3), "b": Normal(0.5, 0.4)}
    start = {name: tb.Parameter(0.7, prior=law) for name, law in prior.items()}
    fit = tb.identify(lambda theta: (theta["a"] + theta["b"])[:, None], torch.tensor([2.0]), start, sigma=0.1)
    variance, total = torch.tensor([0.09, 0.16]), 0.09 + 0.16 + 0.01
    assert fit.status == 0 and not fit.hints
    assert_close(fit.theta, torch.tensor([1.0, 0.5]) + variance / total * 0.5, rtol=1e-5, atol=0)
    assert_close(fit.covariance, variance.diag() - torch.outer(variance, variance) / total, rtol=1e-5, atol=0)
    with pytest.raises(ValueError, match="1 data were given for 2 parameters"):
        tb.identify(lambda theta: (theta["a"] + theta["b"])[:, None], torch.tensor([2.0]), {"a": 1.0, "b": 0.5}, sigma=0.1)


def test_priors_of_a_batch_are_each_sample_by_itself():
    """One sample outside of the support is infinitely unlikely, and the others are as likely as alone."""
    start = {"a": 1.0, "b": tb.Parameter(torch.tensor([0.2, 0.3]), prior=LogNormal(0.0, 0.5))}
    problem = tb.identify(lambda theta: wave({"a": theta["a"], "b": theta["b"].sum(-1)}), CLEAN, start, sigma=0.01).problem
    x = torch.tensor([[1.0, 0.4, 0.6], [1.0, -0.1, 0.6], [1.0, 2.0, 0.1]])
    value, gradient, curvature = problem.prior(x)
    for k in (0, 2):
        for batch, (alone,) in zip((value, gradient, curvature), problem.prior(x[k:k + 1]), strict=True):
            assert_close(batch[k], alone, rtol=1e-12, atol=0)
    assert_close(value[0], -LogNormal(0.0, 0.5).log_prob(x[0, 1:]).sum(), rtol=1e-6, atol=0)
    assert value[1] == torch.inf and gradient[0, 1] != 0
    assert_close(problem.objective_prior(x), value, rtol=1e-12, atol=0)


def test_a_prior_without_a_variance():
    """A transformed distribution has none: the size of a change is that of the start."""
    law = TransformedDistribution(Normal(0.0, 1.0), [SigmoidTransform()])
    assert tb.Parameter(0.3, prior=law).size == 0.3 and tb.Parameter(0.0, prior=Normal(0.0, 2.0)).size == 2


def test_outside_of_the_prior_is_not_gone():
    """A uniform prior is a wall: trials outside are not taken."""
    start = {"a": 1.0, "b": tb.Parameter(0.2, prior=Uniform(0.0, 0.5))}
    fit = tb.identify(wave, CLEAN, start, sigma=0.01)
    assert (fit.history[..., 1] <= 0.5).all() and fit["b"] > 0.4


def test_experiments_share_parameters():
    """Two experiments, one decay rate, amplitudes of their own: what one fit of both together by hand gives."""
    data = {"one": 2 * torch.exp(-0.7 * T) + NOISE, "two": 5 * torch.exp(-0.7 * T[:30]) - NOISE[:30]}
    models = {"one": wave, "two": lambda theta: wave(theta)[:, :30]}
    fit = tb.identify(models, data, {"b": 1.0, "a": tb.Parameter(1.0, own=True)})
    assert fit.names == ("b", "one.a", "two.a") and set(fit.y) == {"one", "two"} and fit.y["two"].shape == (30,)

    def both(theta):
        return torch.cat([theta[:, k:k + 1] * torch.exp(-theta[:, :1] * t) for k, t in ((1, T), (2, T[:30]))], -1)

    known = tb.identify(both, torch.cat(tuple(data.values())), (1.0, 1.0, 1.0))
    assert_close(fit.theta, known.theta, rtol=1e-6, atol=0)
    assert_close(fit.covariance, known.covariance, rtol=1e-4, atol=0)


def test_offset_and_drift_are_parameters_of_the_instrument():
    """Each channel's constant and slope come back, with the covariance of linear least squares; trials cost no more."""
    asked = []

    def model(theta):
        asked.append(len(theta["a"]))
        return torch.stack((wave(theta), 2 * wave(theta)), -1)

    clean = torch.stack((CLEAN, 2 * CLEAN), -1)
    data = clean + torch.tensor([0.3, -1.0]) + T[:, None] * torch.tensor([0.0, 0.2])
    data[5:9, 1] = math.nan
    record = tb.Measurement(data, 0.01, T, offset=True, drift=True, name="laser")
    fit = tb.identify(model, record, {"a": 1.0, "b": 1.0})
    assert fit.names[2:] == ("offset of laser 0", "offset of laser 1", "drift of laser 0", "drift of laser 1")
    assert_close(fit.theta, torch.tensor([2.0, 0.7, 0.3, -1.0, 0.0, 0.2]), rtol=1e-6, atol=1e-6)
    assert max(asked) == 2 * 2 + 1
    X = torch.zeros(40, 2, 6)
    X[:, 0, 0], X[:, 1, 0] = CLEAN / 2, CLEAN
    X[:, 0, 1], X[:, 1, 1] = -T * CLEAN, -2 * T * CLEAN
    for k in (0, 1):
        X[:, k, 2 + k], X[:, k, 4 + k] = 1, T
    X = X.reshape(80, 6)[~data.flatten().isnan()]
    assert_close(fit.covariance, 1e-4 * torch.linalg.inv(X.mT @ X), rtol=1e-4, atol=1e-12)
    assert_close(fit.y[6, 1], clean[6, 1] - 1 + 0.2 * T[6], rtol=1e-6, atol=0)


def test_a_status_is_a_trial_that_failed():
    """(y, status): samples that failed do not count, whatever their numbers say, and the start counts as failed too."""
    def model(theta):
        bad = theta["b"] < 0.3
        return torch.where(bad[:, None], CLEAN, wave(theta)), bad.long()

    fit = tb.identify(model, CLEAN, {"a": 1.0, "b": 3.0})
    assert fit.status == 0 and (fit.history[..., 1] >= 0.3).all()
    assert_close(fit.theta, torch.tensor([2.0, 0.7]), rtol=1e-6, atol=0)
    vector = tb.identify(lambda x: model({"a": x[:, 0], "b": x[:, 1]}), CLEAN, torch.tensor([[1.0, 0.1], [1.0, 1.0]]))
    assert vector.statuses.tolist() == [4, 0] and "the model failed at 1 of 2 starts" in vector.message
    with pytest.raises(ValueError, match="a start"):
        tb.identify(model, CLEAN, {"a": 1.0, "b": 0.1})


def test_sigma_that_only_weighs():
    """absolute_sigma=False: any factor of sigma gives the same fit, covariance and intervals, those of the misfit."""
    sigma, start = 0.05 * (1 + T), {"a": 1.0, "b": 1.0}
    fits = [tb.identify(wave, CLEAN + NOISE, start, sigma=c * sigma, absolute_sigma=False) for c in (1.0, 7.0)]
    assert_close(fits[0].interval(), fits[1].interval(), rtol=1e-6, atol=0)
    absolute = tb.identify(wave, CLEAN + NOISE, start, sigma=sigma)
    assert_close(fits[0].theta, absolute.theta, rtol=1e-6, atol=0)
    factor = absolute.misfit.square() * 40 / 38
    assert_close(fits[0].covariance, factor * absolute.covariance, rtol=1e-5, atol=0)
    assert fits[0].freedom == 38 and absolute.freedom == math.inf


def test_starts_are_drawn():
    """Within the factor, the first as given; of many, those that fit best are followed, and the others looked at once; finished
    starts are not evaluated again.
    """
    sizes = []

    def model(theta):
        sizes.append(len(theta["b"]))
        return wave(theta)

    start = {"a": tb.Parameter(1.0, "log"), "b": tb.Parameter(1.0, "log")}
    fit = tb.identify(model, CLEAN, start, starts=100, spread=5.0, follow=10)
    first = fit.history[0]
    assert first.shape == (100, 2) and (first[0] == 1).all() and first.min() >= 0.2 and first.max() <= 5.0
    assert first.log().std(0).min() > 0.8 * math.log(5) / math.sqrt(3)  # evenly spread, in logarithms
    assert (fit.statuses == 5).sum() == 90 and (fit.statuses == 0).sum() == 10
    assert sum(sizes) < 100 + 10 * 5 * 20 and fit.misfits[fit.statuses == 5].min() >= fit.misfits[fit.statuses == 0].max()
    assert_close(fit.starts[fit.statuses == 0], torch.tensor([2.0, 0.7]).expand(10, 2), rtol=1e-5, atol=0)


def test_automatic_derivatives():
    """Differences where they are good; forward mode where noise of the model, here 1e-5, spoils them."""
    def rough(theta):
        return wave(theta) + 1e-5 * torch.sin(1e9 * (theta["a"] + theta["b"])).detach()[:, None]

    start = {"a": 1.0, "b": 1.0}
    assert tb.identify(wave, CLEAN, start).derivatives == "difference"
    fit = tb.identify(rough, CLEAN, start, tolerance=1e-4)
    assert fit.derivatives == "forward"
    assert_close(fit.theta, torch.tensor([2.0, 0.7]), rtol=1e-4, atol=0)


@pytest.mark.parametrize("freedom, wanted", [(1, 12.7062047), (5, 2.57058184), (30, 2.04227246), (math.inf, 1.95996398)])
def test_quantiles_of_student(freedom, wanted):
    """Those of tables, to their last digit."""
    assert_close(student.quantile(0.975, freedom), wanted, rtol=1e-8, atol=0)
    assert_close(student.quantile(0.025, freedom), -wanted, rtol=1e-8, atol=0)


def test_intervals_of_a_linear_model():
    """All three are theta +- t deviation; the bootstrap's to what 4,000 repeats know (a quantile to 3 %)."""
    X = torch.stack((torch.ones_like(T[:8]), T[:8]), -1)
    data = X @ torch.tensor([1.0, -0.5]) + NOISE[:8]
    fit = tb.identify(lambda theta: theta @ X.T, data, (0.5, 0.5))
    t = student.quantile(0.95, 6)
    exact = torch.stack((fit.theta - t * fit.deviation, fit.theta + t * fit.deviation), -1)
    assert fit.freedom == 6
    assert_close(fit.interval(0.9), exact, rtol=1e-6, atol=0)
    assert_close(fit.interval(0.9, "profile"), exact, rtol=1e-3, atol=1e-4)
    off = (fit.interval(0.9, "bootstrap", repeats=4000) - exact).abs() / fit.deviation[:, None]
    assert off.max() < 0.15


def test_profile_of_a_nonlinear_model():
    """sigma known: the ends are where the least chi^2 rises by z^2, which a search by hand over b finds."""
    data = CLEAN + 10 * NOISE
    fit = tb.identify(wave, data, {"a": tb.Parameter(1.0, "log"), "b": tb.Parameter(1.0, "log")}, sigma=0.5)

    def least(b):
        shape = torch.exp(-b * T)
        return ((shape * (shape @ data) / (shape @ shape) - data) / 0.5).square().sum().item()

    bottom, ends = least(fit["b"]), []
    for side in (-1, 1):
        near, far = fit["b"].item(), fit["b"].item() * 4.0**side
        for _ in range(60):
            middle = (near + far) / 2
            near, far = (middle, far) if least(torch.tensor(middle)) - bottom < 1.959964**2 else (near, middle)
        ends.append(near)
    found = fit.interval(0.95, "profile")[1]
    assert_close(found, torch.tensor(ends), rtol=5e-3, atol=0)
    (one,) = fit.profile("b")
    assert_close(one.interval, found)
    middle = (one.values - fit["b"]).abs().argmin()
    assert one.rise[middle] == 0 and (one.rise[1:middle + 1] < one.rise[:middle]).all() and (one.values.diff() > 0).all()
    assert_close(one.rise, torch.tensor([least(b) - bottom for b in one.values]), rtol=1e-3, atol=1e-6)


def test_a_profile_of_fits_that_are_cut_short(monkeypatch):
    """Held fits of one iteration, from the ridge that the covariance says, are a little high; the interval stays to 10 %."""
    fit = tb.identify(wave, CLEAN + NOISE, {"a": 1.0, "b": tb.Parameter(1.0, "log")})
    whole = fit.interval(method="profile")
    monkeypatch.setattr(profile, "ITERATIONS", 1)
    width = (whole[:, 1] - whole[:, 0])[:, None]
    assert ((fit.interval(method="profile") - whole).abs() < 0.1 * width).all()


def test_what_is_not_told_has_no_interval():
    """The whole of what a parameter can be; others keep theirs."""
    def model(theta):
        return (theta["a"] * theta["b"])[:, None] * T + theta["c"][:, None]

    log = tb.Parameter(1.0, "log")
    start = {"a": log, "b": tb.Parameter(1.5, "log", bounds=(0.1, 9.0)), "c": 0.0}
    fit = tb.identify(model, 2 * T + 1 + 0.01 * NOISE, start)
    assert fit.status == 3 and fit.open.tolist() == [True, True, False]
    low, high = fit.interval().unbind(-1)
    assert low[0] == 0 and high[0] == math.inf
    assert_close(torch.stack((low[1], high[1])), torch.tensor([0.1, 9.0]))
    assert low[2] < 1 < high[2] and high[2] - low[2] < 0.01
    assert "not told by the data" in fit.summary()


def test_the_bootstrap_scatters_as_the_covariance():
    """One batch of repeats, few evaluations each; deviations those of the covariance to 10 %."""
    sizes = []

    def model(theta):
        sizes.append(len(theta["a"]))
        return wave(theta)

    fit = tb.identify(model, CLEAN + NOISE, {"a": 1.0, "b": 1.0}, sigma=0.05)
    sizes.clear()
    found = fit.bootstrap(800)
    assert (found.status == 0).all() and sum(sizes) < 800 * 15
    assert_close(found.theta.std(0), fit.deviation, rtol=0.1, atol=0)
    again = fit.bootstrap(800)
    assert_close(found.theta, again.theta)


def test_a_summary_and_a_file(tmp_path):
    fit = tb.identify({"one": wave}, {"one": tb.Measurement(CLEAN + NOISE, 0.05, T, offset=True)}, {"a": 1.0, "b": 1.0})
    text = fit.summary()
    for part in ("parameter", "95 % interval", "one.offset", "misfit (RMS)", "sigma of 40 data, 3 parameters", "converged in"):
        assert part in text
    fit.save(tmp_path / "fit.pt")
    back = tb.Fit.load(tmp_path / "fit.pt")
    assert back.summary() == text and repr(back) == repr(fit)
    assert_close(back.interval(0.8), fit.interval(0.8))
    assert_close(back["b"], fit["b"])
    assert_close(back.readings[0].y, fit.readings[0].y)
    with pytest.raises(ValueError, match="a profile of a fit from a file"):
        back.profile()
    (tmp_path / "other.pt").write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"other\.pt' was given, which is no saved fit"):
        tb.Fit.load(tmp_path / "other.pt")


def test_hints():
    """Units, a misfit above sigma, residuals that are alike; none of them where all is well."""
    start = {"a": 1.0, "b": 1.0}
    with pytest.warns(UserWarning, match="is a unit off by 1000") as told:
        fit = tb.identify(wave, 1000 * CLEAN, start)
    assert told[0].filename == __file__
    assert "times the model's at the start" in fit.hints[0] and "off by\n  1000 (mm" in fit.summary()
    with pytest.warns(UserWarning, match="is a unit off by 1000"):
        fit = tb.identify(wave, 1e-3 * CLEAN, start)
    assert "times the data's" in fit.hints[0]
    fit = tb.identify(wave, tb.Measurement(CLEAN + 0.3 * torch.sin(6 * T), 0.05, T), start)
    assert "times what sigma says" in fit.hints[0] and "residuals of neighbouring instants are alike" in fit.hints[1]
    assert tb.identify(wave, tb.Measurement(CLEAN + NOISE, 0.05, T), start).hints == ()


def test_a_model_that_ignores_a_parameter():
    fit = tb.identify(wave, CLEAN, {"a": 1.0, "b": 1.0, "c": tb.Parameter(2.0, "log")})
    assert fit.status == 3 and fit.unidentifiable == ("the misfit does not change with c (here 2)",)


def test_a_line_of_progress(capsys):
    pytest.importorskip("tqdm")
    tb.identify(wave, CLEAN, {"a": 1.0, "b": 1.0}, progress=True)
    assert "identify: 100%" in capsys.readouterr().err


def parameter(**changed):
    return {"a": 1.0, "b": tb.Parameter(**{**dict(start=1.0), **changed})}


CASES = {
    "all NaN": (lambda: dict(data=T * math.nan), "data of 40 numbers, all NaN"),
    "infinite": (lambda: dict(data=T / 0), "data hold infinite"),
    "too few": (lambda: dict(data=CLEAN[:1], model=lambda t: wave(t)[:, :1]), "1 data were given for 2 parameters"),
    "another shape": (lambda: dict(model=lambda t: wave(t)[:, :3]), r"gave \(5, 3\) for 5 samples was given; \(5, 40\)"),
    "no batch": (lambda: dict(model=lambda t: wave(t)[0]), r"a model that gave \(40,\)"),
    "no tensor": (lambda: dict(model=lambda t: 3.0), "a model that gave a float"),
    "no function": (lambda: dict(model=3.0), "a model of type float"),
    "no status": (lambda: dict(model=lambda t: (wave(t), torch.ones(2, dtype=torch.long))), r"a status \(2,\)"),
    "no parameters": (lambda: dict(start={}), "no parameters were given"),
    "a name that is none": (lambda: dict(start={1: 2.0}), "a parameter named 1"),
    "names beside names": (lambda: dict(names=("a", "b")), "beside parameters by name"),
    "logit": (lambda: dict(start=parameter(transform="logit")), "'logit' was given without bounds"),
    "sqrt": (lambda: dict(start=parameter(transform="sqrt")), "transform = 'sqrt'"),
    "negative log": (lambda: dict(start=parameter(start=-1.0, transform="log")), "a start by its logarithm = -1"),
    "outside": (lambda: dict(start=parameter(bounds=(2.0, 3.0))), "bounds from 2 to 3 were given for a start of 1"),
    "prior of vectors": (lambda: dict(start=parameter(prior=Dirichlet(torch.ones(2)))), "of single numbers"),
    "outside the prior": (lambda: dict(start=parameter(prior=HalfNormal(1.0), start=-1.0)), "which the prior"),
    "a prior without sigma": (lambda: dict(start=parameter(prior=Normal(1.0, 0.1))), "priors were given with data without"),
    "a scale of three": (lambda: dict(start=parameter(scale=torch.ones(3))), r"scale of shape \(3,\)"),
    "bounds of three": (lambda: dict(start=parameter(bounds=(torch.zeros(3), 2.0))), r"bounds of shape \(3,\)"),
    "a prior of three": (lambda: dict(start=parameter(prior=Normal(torch.ones(3), 1.0))), "a prior of shape .3,"),
    "own of one": (lambda: dict(start=parameter(own=True)), "own to each experiment, was given with one"),
    "names of experiments": (lambda: dict(model={"x": wave}, data={"y": CLEAN}), "models of x and data of y"),
    "models without": (lambda: dict(model={"x": wave}), "data without names"),
    "sigma of no data": (lambda: dict(data={"x": CLEAN}, sigma={"y": 0.1}), "sigma of y was given; there are data of x"),
    "bounds of the adjoint": (lambda: dict(start=parameter(bounds=(0.0, 2.0)), derivatives="adjoint"), "but by .* 'logit'"),
    "sigma twice": (lambda: dict(data=tb.Measurement(CLEAN, 0.1), sigma=0.1), "beside a Measurement"),
    "sigma here and there": (lambda: dict(data={"x": tb.Measurement(CLEAN, 0.1), "y": CLEAN}), "all or none"),
    "follow": (lambda: dict(starts=3, follow=0), "follow = 0"),
    "starts": (lambda: dict(starts=0), "starts = 0"),
    "spread": (lambda: dict(starts=3, spread=0.5), "spread = 0.5"),
    "an unknown delay": (lambda: dict(data=tb.Measurement(CLEAN, 0.1, T, tb.sensors.Spin(-1)["y"], delay="late")), "'late'"),
}


@pytest.mark.parametrize("name", CASES)
def test_refused(name):
    given = dict(model=wave, data=CLEAN, start={"a": 1.0, "b": 1.0})
    changed, sentence = CASES[name]
    with pytest.raises(ValueError, match=sentence):
        tb.identify(**{**given, **changed()})


MEASUREMENTS = {
    "times": (dict(times=T[:3]), r"times of shape \(3,\) were given for data of shape \(40,\)"),
    "sensor": (dict(sensor=tb.sensors.TipPosition()), "without times"),
    "sigma": (dict(sigma=torch.ones(3)), r"sigma of shape \(3,\)"),
    "offset": (dict(offset=1.0), "offset = 1.0"),
    "a delay of readings": (dict(times=T, delay=0.1), "delay was given to a Measurement without a sensor"),
    "a clock of readings": (dict(times=T, clock="c", rate=True), "clock and rate was given"),
}


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_a_measurement_is_refused(name):
    changed, sentence = MEASUREMENTS[name]
    with pytest.raises(ValueError, match=sentence):
        tb.Measurement(CLEAN, **changed)


def test_a_fit_refined_by_a_finer_model():
    """The fit of one model carried over to another: where a search with that ends, to a hundredth of a deviation, at one sample
    an evaluation; a model that has little to do with it is refused.
    """
    asked = []

    def finer(theta):
        asked.append(len(theta["a"]))
        return wave(theta) * (1 + 0.02 * T)

    start = {"a": tb.Parameter(1.0, "log"), "b": tb.Parameter(1.0, "log")}
    data = tb.Measurement(CLEAN + NOISE, 0.05, T, offset=True)
    fit = tb.identify(wave, data, start).refined(finer)
    assert set(asked) == {1} and len(asked) < 12 and fit.status == 0
    direct = tb.identify(finer, data, start)
    assert ((fit.theta - direct.theta).abs() < 0.02 * direct.deviation).all()
    assert_close(fit.y, direct.y, rtol=0, atol=1e-3)
    assert_close(fit.deviation, direct.deviation, rtol=0.1, atol=0)
    with pytest.raises(ValueError, match="differs too much"):
        fit.refined(lambda theta: -3 * wave(theta))
    with pytest.raises(ValueError, match="models of x were given; those of None are wanted"):
        fit.refined({"x": finer})


def test_a_fit_at_a_bound_is_refined_along_it():
    """b is held where the coarse fit left it; a goes to the finer model's best for that b, linear least squares."""
    start = {"a": 1.0, "b": tb.Parameter(0.2, bounds=(0.0, 0.5))}
    fit = tb.identify(wave, CLEAN + NOISE, start, sigma=0.05).refined(lambda theta: 0.98 * wave(theta))
    shape = 0.98 * torch.exp(-0.5 * T)
    assert fit.status == 0 and fit["b"] == 0.5
    assert_close(fit["a"], shape @ (CLEAN + NOISE) / (shape @ shape), rtol=1e-3, atol=0)  # a hundredth of a deviation


def test_as_many_parameters_as_data():
    """No sigma, and nothing left to know it by: a hint says so, and profile and bootstrap are refused."""
    fit = tb.identify(lambda theta: wave(theta)[:, :2], CLEAN[:2], {"a": 1.0, "b": 1.0})
    assert any("as many parameters as data" in hint for hint in fit.hints)
    assert not tb.identify(lambda theta: wave(theta)[:, :2], CLEAN[:2], {"a": 1.0, "b": 1.0}, sigma=0.1).hints
    for method in ("profile", "bootstrap"):
        with pytest.raises(ValueError, match=f"a {method} of as many parameters as data"):
            fit.interval(method=method)


def test_bootstraps_that_are_refused():
    """Of priors, whose spread repeated data would lack; levels that are none."""
    with pytest.raises(ValueError, match="of a fit with priors"):
        tb.identify(wave, CLEAN, {"a": 1.0, "b": tb.Parameter(1.0, prior=Normal(1.0, 0.1))}, sigma=0.1).bootstrap(50)
    found = tb.identify(wave, CLEAN + NOISE, {"a": 1.0, "b": 1.0}).bootstrap(50)
    for level in (0.0, 1.0):
        with pytest.raises(ValueError, match="between 0 and 1 is wanted"):
            found.interval(level)
