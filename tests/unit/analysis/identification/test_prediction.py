"""Predictions of a fit: bands against closed forms, how often they hold the truth, readings of
motions.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.math.distributions import student_quantile

T = torch.linspace(0, 1, 8)
A = torch.stack((torch.ones_like(T), T), -1)
ELSEWHERE = torch.tensor([[1.0, -1.0], [1.0, 0.5], [1.0, 3.0]])  # the line at other places


def line(rows):
    return lambda theta: theta @ rows.mT


def data(sigma, seed=0):
    return A @ torch.tensor([0.3, 2.0]) + sigma * torch.randn(
        len(T), generator=torch.Generator().manual_seed(seed)
    )


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("derivatives", ["difference", "forward"])
def test_bands_of_a_straight_line(known, derivatives):
    """y = a + b t at other t: deviation sigma sqrt(g^T (A^T A)^-1 g), of a new measurement sigma
    sqrt(1 + ...); normal where sigma is known, and Student's t with T - 2 degrees where the misfit
    tells it (Draper and Smith 1998, section 1.4). Central differences of a linear model are exact
    to 1e-11/1e-4.
    """
    y = data(0.1)
    fit = tb.identify(
        line(A), y, torch.tensor([0.0, 1.0]), derivatives=derivatives,
        **({"sigma": 0.1} if known else {}),
    )  # fmt: skip
    sigma = 0.1 if known else fit.scale
    inverse = torch.linalg.inv(A.mT @ A)
    deviation = sigma * ((ELSEWHERE @ inverse) * ELSEWHERE).sum(-1).sqrt()
    factor = student_quantile(0.95, math.inf if known else len(T) - 2)
    found = fit.predict(line(ELSEWHERE), level=0.9)
    assert_close(found.y, ELSEWHERE @ fit.theta, rtol=1e-12, atol=0)
    assert_close(found.deviation, deviation, rtol=1e-6, atol=0)
    assert_close(found.high - found.y, factor * deviation, rtol=1e-6, atol=0)
    assert_close(found.y - found.low, factor * deviation, rtol=1e-6, atol=0)
    new = fit.predict(line(ELSEWHERE), level=0.9, sigma=sigma)
    assert_close(new.deviation, (deviation**2 + sigma**2).sqrt(), rtol=1e-6, atol=0)
    assert_close(fit.predict().y, fit.y, rtol=1e-12, atol=0)
    assert_close(fit.predict().deviation, fit.readings[0].deviation, rtol=1e-6, atol=0)


@pytest.mark.long  # the closed forms above are exact
def test_bands_hold_the_truth_as_often_as_they_say():
    """300 sets of data of a decay exp(-theta t), sigma unknown, its value later on and a new
    measurement there, at 90 %: within 3.5 deviations of a binomial law (6 %).
    """
    t, later, true = torch.linspace(0, 2, 12), torch.tensor([3.0]), torch.tensor([0.7])
    random, hits = torch.Generator().manual_seed(1), torch.zeros(2)

    def decay(at):
        return lambda theta: torch.exp(-theta["rate"][:, None] * at)

    for _ in range(300):
        y = decay(t)({"rate": true})[0] + 0.05 * torch.randn(12, generator=random)
        fit = tb.identify(decay(t), y, {"rate": tb.Parameter(0.5, "log")}, derivatives="difference")
        new = decay(later)({"rate": true})[0] + 0.05 * torch.randn(1, generator=random)
        for k, (sigma, truth) in enumerate(
            ((None, decay(later)({"rate": true})[0]), (fit.scale, new))
        ):
            _, low, high = fit.predict(decay(later), level=0.9, sigma=sigma)
            hits[k] += float(low <= truth <= high)
    assert ((hits / 300 - 0.9).abs() < 0.06).all()


def test_motions_are_read_by_any_sensor_at_any_time():
    """The bending stiffness from the tip's sag; then a motion under another load, read at the
    middle between its instants.
    """

    def scene(theta, force):
        section = tb.Section.from_stiffness(
            EA=4e4, GA=1.5e4, GJ=0.8, EI=theta["EI"], mass=0.2, inertia=5e-6
        )
        return tb.Scene(
            tb.Beam.straight(1.0, 2, section),
            [tb.TipLoad(force=force), tb.Damping(0.01)],
            plane="xz",
        )

    def sag(theta):
        return tb.equilibrium(scene(theta, (0, 0, -0.1))).tip.position[:, 2:]

    def kick(theta):
        return tb.simulate(
            scene(theta, lambda t: (0, 0, torch.sin(20 * t))), torch.linspace(0, 0.1, 6), step=0.02
        )

    fit = tb.identify(
        sag, torch.tensor([-0.033]), {"EI": tb.Parameter(0.8, "log")}, sigma=0.002,
        derivatives="difference",
    )  # fmt: skip
    middle, times = tb.sensors.NodePosition(1)["z"], torch.tensor([0.03, 0.05, 0.09])
    found = fit.predict(kick, middle, times)

    def read(EI):
        return tb.observe(kick({"EI": EI}), middle, times)

    EI, h = fit["EI"][None], 1e-4
    slope = (read(EI * (1 + h)) - read(EI * (1 - h)))[:, 0] / (2 * h)
    assert_close(found.y, read(EI)[:, 0], rtol=0, atol=1e-12)
    assert_close(found.deviation, slope.abs() * fit.x_covariance.sqrt()[0, 0], rtol=1e-3, atol=1e-9)
    with pytest.raises(ValueError, match=r"sensor= of tb\.sensors is wanted"):
        fit.predict(kick)
    with pytest.raises(ValueError, match="one that gives a Solution is wanted"):
        fit.predict(sag, middle)


def test_what_is_not_determined_or_held_or_another_experiments():
    """A parameter that no datum tells of leaves readings of it without bounds; one at its bound
    counts as known; of several experiments with parameters of their own one is named.
    """
    two = {"a": 1.0, "b": tb.Parameter(1.0, bounds=(-2.0, 2.0))}

    def straight(p):
        return p["a"][:, None] + p["b"][:, None] * T

    blind = tb.identify(
        lambda p: p["a"][:, None] + 0 * T, data(0.1) - 2 * T, two, sigma=0.1,
        derivatives="difference",
    )  # fmt: skip
    found = blind.predict(lambda p: torch.stack((p["a"], p["a"] + p["b"]), -1))
    assert found.deviation[0] < 0.1 and found.low[1] == -math.inf and found.high[1] == math.inf
    held = tb.identify(straight, 0.3 + 3 * T, two, sigma=1.0, derivatives="difference")
    assert held.held.tolist() == [False, True]
    assert_close(held.predict(lambda p: p["b"]).deviation, torch.tensor(0.0), rtol=0, atol=0)
    own = {"a": tb.Parameter(0.0, own=True), "b": 1.0}
    both = tb.identify(
        straight, {"x": data(0.1), "y": 1 + data(0.1, 1)}, own, sigma=0.1, derivatives="difference"
    )
    assert_close(
        both.predict(lambda p: p["a"], experiment="y").deviation,
        both.deviation[both.names.index("y.a")],
        rtol=1e-6,
        atol=0,
    )
    with pytest.raises(ValueError, match="experiment= one of x, y is wanted"):
        both.predict(lambda p: p["a"])
