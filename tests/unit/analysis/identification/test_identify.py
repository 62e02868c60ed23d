"""identify: known parameters come back, with the covariance that theory gives; many starts;
refusals.
"""

import math
import re

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals

T = torch.linspace(0, 2, 40)


def decay(theta):
    """a exp(-b t) (N, T)."""
    return theta[:, :1] * torch.exp(-theta[:, 1:] * T)


TRUE = torch.tensor([2.0, 0.7])


@pytest.mark.parametrize("derivatives", ["forward", "difference", "adjoint"])
@pytest.mark.parametrize("log", [False, True])
def test_comes_back(derivatives, log):
    fit = tb.identify(
        decay, decay(TRUE[None])[0], (1.0, 2.0), derivatives=derivatives, log=log, names=("a", "b")
    )
    assert_close(fit.theta, TRUE, rtol=1e-6, atol=0)
    assert (
        fit.status == 0
        and fit.iterations < (30 if derivatives == "adjoint" else 15)
        and "a = 2" in repr(fit)
    )
    assert_close(fit.history[-1, 0], fit.theta) and fit.history.shape == (fit.iterations + 1, 1, 2)


def test_linear_least_squares():
    """A straight line through noise: theta and covariance are those of the normal equations, with
    sigma given (exactly sigma^2 (X^T X)^-1) or estimated; data that are NaN do not count.
    """
    torch.manual_seed(0)
    X = torch.stack((torch.ones_like(T), T), -1)
    y = X @ torch.tensor([1.0, -0.5]) + 0.1 * torch.randn(40)
    y[3] = math.nan
    keep = ~y.isnan()
    exact = torch.linalg.lstsq(X[keep], y[keep]).solution
    for sigma in (None, 0.1):
        fit = tb.identify(lambda theta: theta @ X.T, y, (0.0, 0.0), sigma=sigma)
        assert_close(fit.theta, exact, rtol=1e-6, atol=1e-9)
        left = (y - X @ exact)[keep]
        s2 = left.square().sum() / 37 if sigma is None else torch.tensor(0.01)
        assert_close(fit.covariance, s2 * torch.linalg.inv(X[keep].T @ X[keep]), rtol=1e-5, atol=0)
        assert_close(fit.misfit, left.square().mean().sqrt() / (sigma or 1.0), rtol=1e-6, atol=0)
    assert_close(fit.correlation.diagonal(), torch.ones(2))


def test_covariance_is_the_scatter():
    """Over 100 repeated measurements the found parameters scatter as the covariance says, within 15
    % (the deviation of a deviation from 100 samples is 7 %); in log theta too.
    """
    torch.manual_seed(1)
    clean = decay(TRUE[None])[0]
    fits = [
        tb.identify(decay, clean + 0.02 * torch.randn(40), TRUE, sigma=0.02, log=True)
        for _ in range(100)
    ]
    found = torch.stack([f.theta for f in fits])
    assert_close(found.std(0), fits[0].deviation, rtol=0.15, atol=0)


def test_the_best_of_many_starts():
    """cos(w t) has false minima: of eight starts, together, the best finds w; each ends where it
    would alone.
    """

    def wave(theta):
        return torch.cos(theta * 6 * T)

    data = wave(torch.tensor([[1.3]]))[0]
    starts = torch.linspace(0.3, 2.5, 8)[:, None]
    fit = tb.identify(wave, data, starts)
    assert_close(fit.theta, torch.tensor([1.3]), rtol=1e-6, atol=0)
    assert (fit.misfits > 0.1).any()
    alone = tb.identify(wave, data, starts[2])
    assert_close(fit.starts[2], alone.theta, rtol=1e-5, atol=0)


def test_bounds_hold():
    fit = tb.identify(decay, decay(TRUE[None])[0], (1.0, 0.2), bounds=((0.0, 0.0), (1.5, 5.0)))
    assert fit.theta[0] == 1.5 and (fit.history <= torch.tensor([1.5, 5.0])).all()


def test_a_model_that_fails_on_the_way():
    """Where the model is not finite the step is shortened."""

    def model(theta):
        y = decay(theta)
        return torch.where(theta[:, 1:] < 0.3, torch.nan, y)

    fit = tb.identify(model, decay(TRUE[None])[0], (1.0, 3.0))
    assert_close(fit.theta, TRUE, rtol=1e-5, atol=0)


def test_a_beam():
    """EI and the load of a static beam from its nodes, forward mode through the equilibrium: P
    alone decides nothing but P/EI, so EI and P are wholly correlated, while P/EI is sharp.
    """

    def nodes(theta):
        section = tb.Section.from_stiffness(
            EA=math.inf, GA=math.inf, GJ=1.0, EI=theta[:, 0], mass=1.0
        )
        load = tb.TipLoad(force=theta[:, 1:] * torch.tensor([0.0, 0, 1]))
        return tb.equilibrium(tb.Scene(tb.Beam.straight(1.0, 4, section), [load])).position[
            :, 1:, 2
        ]

    data = nodes(torch.tensor([[2.0, 1.0]]))[0]
    fit = tb.identify(
        nodes, data + 1e-4 * torch.tensor([1.0, -1, 1, -1]), (1.0, 1.5), log=True, sigma=1e-4,
        names=("EI", "P"),
    )  # fmt: skip
    assert_close(fit.theta[1] / fit.theta[0], torch.tensor(0.5), rtol=1e-3, atol=0)
    assert fit.correlation[0, 1] > 0.99
    assert fit.status == 3 and "EI +71 %, P +71 %" in fit.unidentifiable[0]


def test_the_adjoint_through_a_beam():
    """Bending stiffnesses of three stations from a beam's shape, by the adjoint gradient: what
    forward mode finds. L-BFGS stops at a step of 1e-6 of the largest of log theta, on its way to
    it: 1e-4 is what that leaves of the least seen one.
    """
    true = torch.tensor([2.0, 1.0, 1.5])

    def shapes(theta):
        sections = tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=1.0, EI=theta, mass=1.0)
        beam = tb.Beam.straight(1.0, 4, tb.Stations((0.0, 0.5, 1.0), sections))
        return tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=(0, 0, 0.2))])).position[..., 1:, 2]

    data = shapes(true[None])[0]
    fits = [
        tb.identify(shapes, data, torch.full((3,), 1.5), log=True, derivatives=d)
        for d in ("adjoint", "forward")
    ]
    assert_close(fits[1].theta, true, rtol=1e-6, atol=0)
    assert_close(fits[0].theta, true, rtol=1e-4, atol=0)


def test_the_adjoint_of_small_numbers():
    """A rate of 1e-6 beside an amplitude of 1: the search is in units of each start."""
    fit = tb.identify(
        lambda theta: decay(theta * torch.tensor([1.0, 1e6])),
        decay(TRUE[None])[0],
        (1.0, 1.3e-6),
        derivatives="adjoint",
    )
    assert fit.status == 0
    assert_close(fit.theta, TRUE * torch.tensor([1.0, 1e-6]), rtol=1e-4, atol=0)


METHODS = ("forward", "difference", "adjoint")
# model, data, start, log: the misfit falls, ever less, as the first parameter grows without end
AWAY = {
    "log": (lambda theta: T**2 / theta[:, :1], -(T**2), (1.0,), True),
    "as it is": (lambda theta: T**2 / theta[:, :1], -(T**2), (1.0,), False),
    "decay": (lambda theta: torch.exp(-theta * T), -0.1 + 0 * T, (1.0,), False),
    "beside another": (
        lambda theta: theta[:, 1:] * T + T**2 / theta[:, :1],
        2 * T - T**2,
        (1.0, 1.0),
        True,
    ),
}


@pytest.mark.parametrize("derivatives", METHODS)
@pytest.mark.parametrize("name", AWAY)
def test_what_runs_away_is_not_identified(name, derivatives):
    """No start ends as converged, the parameter is named, and it stays within 1e9 of its start."""
    model, data, start, log = AWAY[name]
    fit = tb.identify(
        model, data, start, log=log, derivatives=derivatives, names=("k", "c")[: len(start)]
    )
    assert fit.status == 3 == fit.statuses and fit.history.abs().max() <= 1.001e9
    assert (
        len(fit.unidentifiable) == 1
        and fit.unidentifiable[0] in fit.message
        and "not identifiable" in repr(fit)
    )
    assert (
        "k ran away, from 1 to" in fit.message
        or "the misfit does not change with k (here" in fit.message
    )


@pytest.mark.parametrize("derivatives", METHODS)
def test_a_stiffness_that_runs_away(derivatives):
    """A beam that sags where the data say that it rises: EI grows without end. 1/EI is what the
    data see; they see none.
    """

    def tip(theta):
        section = tb.Section.from_stiffness(
            EA=math.inf, GA=math.inf, GJ=1.0, EI=theta[:, 0], mass=1.0
        )
        return tb.equilibrium(
            tb.Scene(tb.Beam.straight(1.0, 2, section), [tb.TipLoad(force=(0, 0, 0.1))])
        ).tip.position[:, 2]

    fit = tb.identify(
        tip, -0.1, (1.0,), log=True, names=("EI",), derivatives=derivatives, iterations=20
    )
    assert fit.status == 3 and "EI" in fit.unidentifiable[0]


OPEN = {
    "product": (lambda theta: theta[:, :1] * theta[:, 1:] * T, r"a \+\d+ %, b -\d+ %"),
    "ratio": (lambda theta: theta[:, :1] / theta[:, 1:] * T, r"a \+\d+ %, b \+\d+ %"),
    "not used": (lambda theta: theta[:, :1] * T + 0 * theta[:, 1:], r"with b \(here 1.5\)"),
}


@pytest.mark.parametrize("derivatives", METHODS)
@pytest.mark.parametrize("name", OPEN)
def test_what_the_data_do_not_tell_is_named(name, derivatives):
    """With data that fit to rounding and with data that do not."""
    model, wanted = OPEN[name]
    for data in (2 * T, 2 * T + 0.1 * torch.sin(9 * T)):
        for log in (True, False):
            fit = tb.identify(
                model, data, (1.0, 1.5), log=log, derivatives=derivatives, names=("a", "b")
            )
            assert fit.status == 3 and len(fit.unidentifiable) == 1
            assert re.search(f"the misfit does not change .*{wanted}", fit.message)


@pytest.mark.parametrize("derivatives", METHODS)
def test_what_is_told_is_not_called_open(derivatives):
    """A true value of zero, from zero and from elsewhere; a start at the truth; units far apart."""

    def line(theta):
        return theta[:, :1] * T + theta[:, 1:]

    for start in ((1.0, 1.0), (0.0, 0.0), (3.0, 0.0)):
        fit = tb.identify(line, 3 * T, start, derivatives=derivatives)
        assert fit.status == 0 and not fit.unidentifiable
    if derivatives != "adjoint":  # which scales by the start alone
        fit = tb.identify(
            lambda theta: theta[:, :1] * 1e-12 * T + theta[:, 1:] * 1e9 * T**2,
            3 * T + 2 * T**2,
            (1e11, 1e-10),
            derivatives=derivatives,
        )
        assert fit.status == 0
        assert_close(fit.theta, torch.tensor([3e12, 2e-9]), rtol=1e-4, atol=0)


def test_a_far_start_is_reached_by_limited_steps():
    """From 1e-4 and 1e-3 of the truth, where the first whole Gauss-Newton step goes beyond 1e4 and
    never comes back.
    """
    for log in (True, False):
        fit = tb.identify(decay, decay(TRUE[None])[0], (1e-4, 1e-3), log=log)
        assert fit.status == 0
        assert_close(fit.theta, TRUE, rtol=1e-6, atol=0)


@pytest.mark.parametrize("derivatives", METHODS)
def test_a_trial_that_raises_is_not_taken(derivatives):
    """The model raises for the whole batch where one of it is out of reach: each start ends where
    it does alone.
    """

    def model(theta):
        if (theta[:, 1] < 0.3).any():
            raise RuntimeError("the solver failed")
        return decay(theta)

    starts = torch.tensor([[1.0, 3.0], [1.0, 1.0], [2.0, 0.7]])
    fit = tb.identify(model, decay(TRUE[None])[0], starts, derivatives=derivatives)
    assert (fit.statuses == 0).all() and (fit.history[..., 1] >= 0.3).all()
    assert_close(fit.starts, TRUE.expand(3, 2), rtol=1e-5, atol=0)
    assert "the model raised, last 'the solver failed'" in fit.message
    alone = tb.identify(model, decay(TRUE[None])[0], starts[0], derivatives=derivatives)
    assert_close(fit.starts[0], alone.theta, rtol=1e-6, atol=0)


@pytest.mark.parametrize("derivatives", METHODS)
def test_a_trial_that_is_not_finite_is_not_taken(derivatives):
    fit = tb.identify(
        lambda theta: torch.where(theta[:, 1:] < 0.3, math.nan, decay(theta)),
        decay(TRUE[None])[0],
        (1.0, 3.0),
        derivatives=derivatives,
    )
    assert fit.status == 0 and (fit.history[..., 1] >= 0.3).all()
    assert_close(fit.theta, TRUE, rtol=1e-5, atol=0)


@pytest.mark.parametrize("derivatives", METHODS)
def test_a_start_that_raises_goes_through(derivatives):
    def model(theta):
        raise ArithmeticError("no such beam")

    with pytest.raises(ArithmeticError, match="no such beam"):
        tb.identify(model, T, (1.0, 2.0), derivatives=derivatives)


def test_a_model_that_fails_everywhere_else():
    """Every trial raises: the start is what is left, and it is not called converged."""
    for derivatives in METHODS:

        def model(theta):
            if not torch.allclose(theta, torch.tensor([1.0, 3.0]), rtol=2e-4, atol=0):
                raise ValueError("only there")
            return decay(theta)

        fit = tb.identify(model, decay(TRUE[None])[0], (1.0, 3.0), derivatives=derivatives)
        assert fit.status == 2
        assert_close(fit.theta, torch.tensor([1.0, 3.0]), rtol=2e-4, atol=0)


GOOD = dict(model=decay, data=decay(TRUE[None])[0], start=(1.0, 2.0))
# fmt: off
CASES = {
    "start as a number": (dict(start=1.0), r"a start of shape \(\)"),
    "NaN start": (dict(start=(math.nan, 1.0)), "start holds nan"),
    "negative for log": (dict(start=(-1.0, 1.0), log=True), "start = -1"),
    "derivatives": (dict(derivatives="reverse"), "derivatives = 'reverse'"),
    "names": (dict(names=("a",)), "1 names were given for 2 parameters"),
    "too few data": (dict(data=torch.where(T > 0, torch.nan, T)), "1 data were given for 2"),
    "data of another shape": (dict(data=T[:3]), r"a model that gave \(5, 40\)"),
    "sigma": (dict(sigma=0.0), "sigma = 0 was given"),
    "a model of nothing, adjoint": (dict(model=lambda theta: decay(theta) * math.nan,
                                         derivatives="adjoint"), "a start .0 of"),
    "a model of nothing": (dict(model=lambda theta: decay(theta) * math.nan),
                           r"a start \(0 of 1\) at which the model"),
    "bounds of the adjoint": (dict(bounds=((0.0, 0.0), (1.0, 2.0)), derivatives="adjoint"),
                              "which takes none"),
    "names twice": (dict(names=("a", "a")), "names a, a were given; each once"),
    "a start outside of bounds": (dict(bounds=(0.0, 1.5)), "for a start outside of them"),
    "bounds of three": (dict(bounds=(0.0, 1.0, 2.0)), r"\(least, largest\) is wanted"),
    "bounds of others": (dict(bounds=((0.0, 0.0, 0.0), 9.0)),
                         "for 2 parameters; the least and the largest"),
    "bounds the wrong way round": (dict(bounds=(9.0, 0.0)),
                                   "for 2 parameters; the least and the largest"),
    "no iterations": (dict(iterations=0), "iterations = 0"),
}
# fmt: on


@refusals(CASES)
def test_refused(changed):
    tb.identify(**{**GOOD, **changed})
