"""Priors: modes and deviations of posteriors, batches, walls."""

import pytest
import torch
from torch.distributions import Gamma, LogNormal, Normal, TransformedDistribution, Uniform
from torch.distributions.transforms import SigmoidTransform
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.wave_cases import CLEAN, T, wave
from torchbeam.analysis.identification.observed_priors import with_priors_observed


@pytest.mark.parametrize("derivatives", ["difference", "forward", "adjoint"])
@pytest.mark.parametrize("transform", [None, "log", "logit"])
@pytest.mark.parametrize(
    "prior",
    [Normal(1.0, 0.1), LogNormal(0.0, 0.05), Gamma(50.0, 40.0)],
    ids=lambda p: type(p).__name__,
)
def test_priors(prior, transform, derivatives):
    """The mode of the posterior of a mean, in the coordinate of the search: the root of the
    derivative of its density, found by bisection; and, of a normal prior in the parameter itself,
    the known mean and deviation.
    """
    data, sigma = torch.tensor([1.5, 1.7, 1.3], dtype=torch.float64), 0.2
    start = torch.tensor(1.0, dtype=torch.float64)
    bounds = (0.2, 3.0) if transform == "logit" else None
    fit = tb.identify(
        lambda theta: theta["m"][:, None].expand(-1, 3),
        data,
        {"m": tb.Parameter(start, transform, bounds=bounds, prior=prior)},
        sigma=sigma,
        derivatives=derivatives,
    )

    def slope(m):
        m = torch.tensor(m, dtype=torch.float64, requires_grad=True)
        moves = {None: 1 + 0 * m, "log": m, "logit": (m - 0.2) * (3.0 - m) / 2.8}[transform]
        loss = ((m - data) / sigma).square().sum() / 2 - prior.log_prob(m) - moves.log()
        return torch.autograd.grad(loss, m)[0].item()

    low, high = 0.5, 2.9
    for _ in range(60):
        low, high = (
            ((low + high) / 2, high) if slope((low + high) / 2) < 0 else (low, (low + high) / 2)
        )
    assert fit.status == 0
    assert_close(fit["m"].item(), low, rtol=1e-4 if derivatives == "adjoint" else 1e-6, atol=0)
    if isinstance(prior, Normal) and transform is None:
        precision = 3 / sigma**2 + 1 / 0.1**2
        assert_close(
            fit["m"].item(),
            (data.sum().item() / sigma**2 + 1.0 / 0.1**2) / precision,
            rtol=1e-4,
            atol=0,
        )
        assert_close(fit.deviation.item(), precision**-0.5, rtol=1e-4, atol=0)


@pytest.mark.parametrize("method", ["laplace", "profile", "bootstrap"])
def test_a_log_normal_prior_of_what_is_searched_by_its_logarithm(method):
    """A power law of it is linear in the logarithm: the posterior is normal there, with the known
    mean and deviation, and its interval is exact (of 2000 repeats to 3 % of its width).
    """
    prior, sigma = LogNormal(0.1, 0.3), 0.4
    data = torch.tensor([0.9, 0.5], dtype=torch.float64)
    fit = tb.identify(
        lambda theta: theta["m"][:, None].log().expand(-1, 2),
        data,
        {"m": tb.Parameter(torch.tensor(1.0, dtype=torch.float64), "log", prior=prior)},
        sigma=sigma,
    )
    precision = 2 / sigma**2 + 1 / 0.3**2
    mean = (data.sum() / sigma**2 + 0.1 / 0.3**2) / precision
    half = 1.959964 * precision**-0.5
    assert_close(fit["m"].log(), mean, rtol=1e-6, atol=0)
    given = {"repeats": 2000} if method == "bootstrap" else {}
    found = fit.interval(0.95, method, **given)[0].log()
    wanted = torch.stack((mean - half, mean + half))
    off = {"laplace": 1e-6, "profile": 1e-3, "bootstrap": 0.06 * half}[method]
    assert_close(found, wanted, rtol=0, atol=off)


@pytest.mark.parametrize("transform", [None, "log", "logit"])
@pytest.mark.parametrize(
    "prior",
    [LogNormal(0.0, 0.2), Normal(1.0, 0.2), Gamma(25.0, 25.0)],
    ids=lambda p: type(p).__name__,
)
def test_intervals_with_a_prior_hold_what_it_draws(prior, transform, repeats=300):
    """`repeats` quantities drawn from the prior, each seen once with as much noise: of 95 %
    intervals at least 92 % hold (three deviations of their number below), in every coordinate.
    """
    draw = torch.Generator().manual_seed(0)
    with torch.random.fork_rng():
        torch.manual_seed(1)
        truth = prior.sample((repeats,)).double()
    data = truth.log() + 0.2 * torch.randn(repeats, generator=draw, dtype=torch.float64)
    bounds = (0.05, 4.0) if transform == "logit" else None
    held = 0
    for some in torch.arange(repeats).split(30):
        start = tb.Parameter(torch.ones_like(truth[some]), transform, bounds=bounds, prior=prior)
        fit = tb.identify(lambda theta: theta["m"].log(), data[some], {"m": start}, sigma=0.2)
        low, high = fit.interval_without_warning(0.95).unbind(-1)
        held += int(((low <= truth[some]) & (truth[some] <= high)).sum())
    assert held >= repeats * 0.95 - 3 * (repeats * 0.95 * 0.05) ** 0.5


@pytest.mark.parametrize(
    "transform, prior", [("log", Normal(1.0, 0.1)), ("logit", LogNormal(0.0, 0.1)), ("log", None)]
)
def test_repeats_of_a_prior_in_another_coordinate(transform, prior):
    """The bootstrap repeats the fit that was made: its problem has its minimum where that ended,
    whatever the coordinate of law and search.
    """
    prior = Uniform(0.5, 2.0) if prior is None else prior
    bounds = (0.2, 3.0) if transform == "logit" else None
    fit = tb.identify(
        lambda theta: theta["m"][:, None].expand(-1, 3),
        torch.tensor([1.5, 1.2, 1.3], dtype=torch.float64),
        {"m": tb.Parameter(torch.tensor(1.0).double(), transform, bounds=bounds, prior=prior)},
        sigma=0.1,
    )
    seen = with_priors_observed(fit.problem)
    r, J = seen.linearised(fit.x[None], torch.zeros(1, dtype=torch.long))
    pull = (J[0].mT @ r[0] + seen.prior(fit.x[None])[1][0]).abs().item()
    assert pull < 1e-4 * (J[0].mT @ J[0]).item()
    assert torch.isfinite(fit.bootstrap(60).x).all()


def test_a_prior_tells_what_data_do_not():
    """A product of two: with a prior on one, both are determined, the other's deviation that of the
    prior.
    """

    def model(theta):
        return (theta["a"] * theta["b"])[:, None] * T

    start = {
        "a": tb.Parameter(1.0, "log"),
        "b": tb.Parameter(1.5, "log", prior=LogNormal(0.0, 0.1)),
    }
    fit = tb.identify(model, 2 * T, start, sigma=1e-3)
    assert fit.status == 0 and not fit.unidentifiable
    assert_close(fit.deviation / fit.theta, torch.tensor([0.1, 0.1]), rtol=1e-2, atol=0)


def test_fewer_data_than_parameters_with_priors():
    """One reading of a sum: each number gives way as its prior is wide; mean and covariance of the
    conditional normal law.
    """
    prior = {"a": Normal(1.0, 0.3), "b": Normal(0.5, 0.4)}
    start = {name: tb.Parameter(0.7, prior=law) for name, law in prior.items()}
    fit = tb.identify(
        lambda theta: (theta["a"] + theta["b"])[:, None], torch.tensor([2.0]), start, sigma=0.1
    )
    variance, total = torch.tensor([0.09, 0.16]), 0.09 + 0.16 + 0.01
    assert fit.status == 0 and not fit.hints
    assert_close(fit.theta, torch.tensor([1.0, 0.5]) + variance / total * 0.5, rtol=1e-5, atol=0)
    assert_close(
        fit.covariance, variance.diag() - torch.outer(variance, variance) / total, rtol=1e-5, atol=0
    )
    with pytest.raises(ValueError, match="1 data were given for 2 parameters"):
        tb.identify(
            lambda theta: (theta["a"] + theta["b"])[:, None],
            torch.tensor([2.0]),
            {"a": 1.0, "b": 0.5},
            sigma=0.1,
        )


def test_priors_of_a_batch_are_each_sample_by_itself():
    """One sample outside of the support is infinitely unlikely, and the others are as likely as
    alone.
    """
    start = {"a": 1.0, "b": tb.Parameter(torch.tensor([0.2, 0.3]), prior=LogNormal(0.0, 0.5))}
    problem = tb.identify(
        lambda theta: wave({"a": theta["a"], "b": theta["b"].sum(-1)}), CLEAN, start, sigma=0.01
    ).problem
    x = torch.tensor([[1.0, 0.4, 0.6], [1.0, -0.1, 0.6], [1.0, 2.0, 0.1]])
    value, gradient, curvature = problem.prior(x)
    for k in (0, 2):
        for batch, (alone,) in zip(
            (value, gradient, curvature), problem.prior(x[k : k + 1]), strict=True
        ):
            assert_close(batch[k], alone, rtol=1e-12, atol=0)
    assert_close(value[0], -LogNormal(0.0, 0.5).log_prob(x[0, 1:]).sum(), rtol=1e-6, atol=0)
    assert value[1] == torch.inf and gradient[0, 1] != 0
    assert_close(problem.objective_prior(x), value, rtol=1e-12, atol=0)


def test_a_prior_without_a_variance():
    """A transformed distribution has none: the size of a change is that of the start."""
    law = TransformedDistribution(Normal(0.0, 1.0), [SigmoidTransform()])
    assert (
        tb.Parameter(0.3, prior=law).size == 0.3
        and tb.Parameter(0.0, prior=Normal(0.0, 2.0)).size == 2
    )


def test_outside_of_the_prior_is_not_gone():
    """The end of a uniform prior is a bound: the search goes along it, to the best amplitude for
    that rate.
    """
    shape = torch.exp(-0.5 * T)
    for transform in (None, "log"):
        fit = tb.identify(
            wave,
            CLEAN,
            {"a": 1.0, "b": tb.Parameter(0.2, transform, prior=Uniform(0.0, 0.5))},
            sigma=0.01,
        )
        assert (
            (fit.history[..., 1] < 0.5).all()
            and fit.status == 0
            and fit.held.tolist() == [False, True]
        )
        assert_close(
            fit.theta,
            torch.stack((shape @ CLEAN / (shape @ shape), torch.tensor(0.5))),
            rtol=1e-6,
            atol=0,
        )
        assert fit.interval()[1, 1] < 0.5


def test_inputs_that_were_measured_have_noise_of_their_own():
    """A line through readings whose abscissae have noise too: these are parameters with what was
    read as their prior, and the slope is that of total least squares (Deming 1943, Statistical
    Adjustment of Data), not the flatter one of least squares.
    """
    random = torch.Generator().manual_seed(0)
    true = torch.linspace(0, 1, 20)
    x = true + 0.1 * torch.randn(20, generator=random)
    y = 0.5 + 2 * true + 0.1 * torch.randn(20, generator=random)

    def line(theta):
        return theta["a"][:, None] + theta["b"][:, None] * theta["x"]

    start = {"a": 0.0, "b": 1.0, "x": tb.Parameter(x, prior=Normal(x, 0.1))}
    fit = tb.identify(line, y, start, sigma=0.1, tolerance=1e-8)
    dx, dy = x - x.mean(), y - y.mean()
    xx, xy, yy = dx @ dx, dx @ dy, dy @ dy
    slope = (yy - xx + ((yy - xx).square() + 4 * xy.square()).sqrt()) / (2 * xy)
    assert fit.status == 0
    torch.testing.assert_close(fit["b"], slope, rtol=1e-5, atol=0)
    assert slope > 1.03 * xy / xx
    (low, high) = fit.interval(0.95)[1]
    assert low < 2 < high
