"""identify_fields: Tikhonov regularisation against closed forms, its weights, and what is
refused.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.analysis.identification.regularization import Linearised, weigh

N, P = 40, 12
PLACES = torch.linspace(0, 1, P)
# ill-conditioned: singular values fall by 1e5
BLUR = torch.exp(-(((torch.linspace(0, 1, N)[:, None] - PLACES) / 0.15) ** 2))
TRUE = torch.sin(2 * math.pi * PLACES) + PLACES


def blurred(theta):
    return theta["x"] @ BLUR.T


def noisy(sigma, seed=0):
    return BLUR @ TRUE + sigma * torch.randn(N, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_normal_equations(order):
    """A given weight: theta and covariance of (A^T A / sigma^2 + w L^T L), and the trace of the
    resolution matrix.
    """
    data, w, sigma = noisy(0.02), 0.3, 0.02
    L = tb.Smoothness(order).rows(PLACES)
    inverse = torch.linalg.inv(BLUR.T @ BLUR / sigma**2 + w * L.T @ L)
    start = torch.full((P,), 0.5)
    at = L @ start if order == 0 else 0 * L[:, 0]
    found = tb.identify_fields(
        blurred, tb.Measurement(data, sigma), {"x": start}, {"x": tb.Smoothness(order)},
        weight={"x": w},
    )  # fmt: skip
    assert_close(
        found["x"], inverse @ (BLUR.T @ data / sigma**2 + w * L.T @ at), rtol=1e-5, atol=1e-6
    )
    assert_close(found.deviation("x"), inverse.diagonal().sqrt(), rtol=1e-4, atol=0)
    assert found.effective == pytest.approx(
        (inverse @ BLUR.T @ BLUR).trace().item() / sigma**2, rel=1e-4
    )
    assert_close(
        found.fit.misfit, ((found.fit.y - data) / sigma).square().mean().sqrt(), rtol=1e-6, atol=0
    )
    assert (
        found.rounds == 1
        and found.settled
        and found.fit.y.shape == (N,)
        and len(found.fit.readings) == 1
    )


def test_rows_are_derivatives():
    """Zero for polynomials below their order at uneven places; the integral of the square of s^2's:
    4/3 and 4.
    """
    s = torch.linspace(0, 1, 201) ** 1.3
    for order, whole in ((1, 4 / 3), (2, 4.0)):
        rows = tb.Smoothness(order, at=5 * s).rows(s)
        assert_close(
            rows @ torch.stack((torch.ones(201), s)[:order]).T,
            torch.zeros(201 - order, order),
            rtol=0,
            atol=1e-9,
        )
        # midpoints: 1/200 of either end
        assert (rows @ s**2).square().sum().item() == pytest.approx(whole, rel=0.02)
    rows = tb.Smoothness(1, at=(0.0, 0.1, 0.9, 1.0)).rows(s[:4])
    # of straight pieces
    assert_close(
        (rows @ torch.tensor([0.0, 1.0, 2.0, 3.0])).square(), torch.tensor([10.0, 1.25, 10.0])
    )


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("criterion", ["evidence", "gcv"])
def test_weights_from_the_data(criterion, known):
    """Noise of 0.02 at singular values that fall by 1e5: the criteria come within twice the error
    of the best weight that there is, and unknown noise is found within 30 % (40 data less some 7:
    12 % and what the criterion errs).
    """
    data = noisy(0.02)
    found = tb.identify_fields(
        blurred, tb.Measurement(data, 0.02 if known else None), {"x": torch.zeros(P)},
        {"x": tb.Smoothness(2)}, criterion=criterion,
    )  # fmt: skip
    L = tb.Smoothness(2).rows(PLACES)
    errors = [
        (torch.linalg.solve(BLUR.T @ BLUR + w * L.T @ L, BLUR.T @ data) - TRUE).norm()
        for w in torch.logspace(-10, 2, 60)
    ]
    assert found.settled and (found["x"] - TRUE).norm() < 2 * min(errors)
    assert found.sigma == 1.0 if known else 0.7 * 0.02 < found.sigma < 1.3 * 0.02
    assert 3 < found.effective < P and "12 numbers" in repr(found)


def test_noise_beside_a_weight():
    """A weight that is given, and no sigma: the noise is found (0.02, to 30 % as above), and the
    fit is that of such noise.
    """
    data, smooth = noisy(0.02), {"x": tb.Smoothness(2)}
    found = tb.identify_fields(blurred, data, {"x": torch.zeros(P)}, smooth, weight={"x": 0.01})
    assert (
        found.settled
        and found.weight == {"x": pytest.approx(0.01)}
        and 0.7 * 0.02 < found.sigma < 1.3 * 0.02
    )
    known = tb.identify_fields(
        blurred, tb.Measurement(data, found.sigma), {"x": torch.zeros(P)}, smooth,
        weight={"x": 0.01},
    )  # fmt: skip
    assert_close(found["x"], known["x"], rtol=1e-5, atol=1e-6)


def test_data_without_noise():
    """The field is what the data are made of, to 1e-3 (singular values fall by 1e5, the prior of
    the second derivative is not gone), with a sigma far below the data.
    """
    found = tb.identify_fields(blurred, BLUR @ TRUE, {"x": torch.zeros(P)}, {"x": tb.Smoothness(2)})
    assert 0 < found.sigma < 1e-4 and found.fit.misfit < 1e-4
    assert_close(found["x"], TRUE, rtol=0, atol=1e-3)


def test_single_precision():
    """Data and a model in single precision are fitted in double."""
    blur = BLUR.float()
    for options in ({"weight": {"x": 0.01}}, {}):
        found = tb.identify_fields(
            lambda theta: theta["x"].float() @ blur.T, noisy(0.02).float(), {"x": [0.0] * P},
            {"x": tb.Smoothness(2)}, **options,
        )  # fmt: skip
        assert found["x"].dtype == torch.float64 and (found["x"] - TRUE).abs().max() < 0.3


def test_the_corner_of_the_l_curve():
    """Two decades of weights about the corner: the L-curve's weight is no more than that from the
    evidence's.
    """
    options = dict(start={"x": torch.zeros(P)}, smoothness={"x": tb.Smoothness(2)})
    data = tb.Measurement(noisy(0.02), 0.02)
    evidence, corner = (
        tb.identify_fields(blurred, data, **options, criterion=c).weight["x"]
        for c in ("evidence", "lcurve")
    )
    assert abs(math.log10(corner / evidence)) < 2


def test_evidence_is_the_integral():
    """The criterion is minus the logarithm of the data's density, of a proper prior: x normal by w
    and the noise.
    """
    L = tb.Smoothness(0).rows(PLACES)
    data = noisy(0.1)
    law, noise = torch.distributions.MultivariateNormal, 0.01 * torch.eye(N)
    zero, mean, deviation = torch.zeros(P + 1), 0.4, 0.3  # and a level, with a prior of its own
    alone = Linearised(zero[:P], -data / 0.1, BLUR / 0.1, (L,), (zero[:P],), zero[:P], zero[:P])
    level = torch.nn.functional.one_hot(torch.tensor(P), P + 1) / deviation**2
    both = Linearised(
        zero, -data / 0.1, torch.cat((BLUR, torch.ones(N, 1)), 1) / 0.1,
        (torch.nn.functional.pad(L, (0, 1)),), (zero[:P],), -mean * level, level,
    )  # fmt: skip
    for linear, at, known in ((alone, 0.0, 0.0), (both, mean, deviation)):
        found = weigh(linear, "evidence", True)
        densities = torch.stack(
            [
                law(
                    torch.full((N,), at),
                    BLUR @ torch.linalg.inv(w * L.T @ L) @ BLUR.T + noise + known**2,
                ).log_prob(data)
                for w in found.weights[0, 80:110:10]
            ]
        )
        assert_close(-found.value[0, 80:110:10].diff(), densities.diff(), rtol=1e-6, atol=1e-6)


def test_sharp_keeps_a_step():
    """A step of one among differences that are zero: Student's prior comes within 1.5 times the
    error of two means, which know where the step is; a normal prior does not.
    """
    step = torch.where(PLACES > 0.5, 2.0, 1.0)
    data = tb.Measurement(
        step + 0.05 * torch.randn(P, generator=torch.Generator().manual_seed(1)), 0.05
    )
    smooth, sharp = (
        tb.identify_fields(
            lambda theta: theta["x"], data, {"x": torch.ones(P)}, {"x": tb.Smoothness(1, sharp=s)}
        )
        for s in (False, True)
    )
    means = torch.cat([half.mean().expand(P // 2) for half in data.values.split(P // 2)])
    assert (sharp["x"] - step).norm() < 1.5 * (means - step).norm() < (smooth["x"] - step).norm()
    assert sharp.effective < 4 < smooth.effective


def test_two_fields_have_two_weights():
    """A smooth field and a rough one, each seen by itself in two experiments; the rough one's
    weight is the smaller.
    """
    random = torch.Generator().manual_seed(2)
    rough = torch.randn(P, generator=random)
    data = {
        "a": tb.Measurement(1 + PLACES + 0.1 * torch.randn(P, generator=random), 0.1),
        "b": tb.Measurement((0.4 * rough).exp() + 0.01 * torch.randn(P, generator=random), 0.01),
    }
    found = tb.identify_fields(
        {"a": lambda theta: theta["x"], "b": lambda theta: theta["z"] * theta["level"][:, None]},
        data,
        {
            "x": torch.ones(P),
            "z": tb.Parameter(torch.ones(P), "log"),
            "level": tb.Parameter(1.0, prior=torch.distributions.Normal(1.0, 1e-3)),
        },
        {"x": tb.Smoothness(), "z": tb.Smoothness()},
    )
    assert found.settled and found.weight["z"] < 0.1 * found.weight["x"]
    assert_close(found["z"], (0.4 * rough).exp(), rtol=0, atol=0.05)
    assert set(found.fit.y) == {"a", "b"} and 15 < found.effective < 22  # all 12 of z, some of x
    with pytest.raises(ValueError, match="with 2 fields; it is of one"):
        tb.identify_fields(
            lambda theta: theta["x"] + theta["z"],
            2 + PLACES,
            {"x": torch.ones(P), "z": torch.ones(P)},
            {"x": tb.Smoothness(2), "z": tb.Smoothness(1)},
            criterion="lcurve",
        )


def test_refined():
    """A fit carried over to a finer model is that which a search with the finer model finds, but
    that derivatives are those at hand: 5 % larger, they weigh the prior by as much less. Smoothness
    stays what it is, and is no reading of either.
    """
    data = {"a": tb.Measurement(noisy(0.02), 0.02), "b": tb.Measurement(noisy(0.02, 1), 0.02)}
    smooth = {"x": tb.Smoothness(2)}
    start = {"x": torch.zeros(P), "level": tb.Parameter(0.0, scale=0.1, own=True)}

    def finer(theta):
        return blurred(theta) + theta["level"][:, None] * torch.linspace(-1, 1, N)

    def coarse(theta):
        return 1.05 * finer(theta)

    found = tb.identify_fields(coarse, data, start, smooth)
    assert found.fit.names[P:] == ("a.level", "b.level") and found.fit.status == 0
    exact = tb.identify_fields(finer, data, start, smooth, weight=found.weight)
    for model in (finer, {"a": finer, "b": finer}):
        other = found.refined(model)
        assert ((other.fit.theta - exact.fit.theta).abs() < 0.05 * exact.fit.deviation).all()
        assert set(other.fit.y) == {"a", "b"} and len(other.fit.readings) == 2
    assert ((found.fit.theta - exact.fit.theta).abs() > 0.5 * exact.fit.deviation).any()
    alone = tb.identify_fields(
        coarse, data["a"], {"x": start["x"], "level": 0.0}, smooth, weight=found.weight
    )
    assert alone.fit.refined(finer).y.shape == (N,) and alone.fit.readings[0].experiment is None
    with pytest.raises(ValueError, match=r"models of a were given; those of a, b are wanted"):
        found.fit.refined({"a": finer})


def test_refusals():
    data, start = noisy(0.02), {"x": torch.zeros(P)}
    for wrong, said in (
        ({"y": tb.Smoothness()}, "there are x"),
        ({}, "by name are wanted"),
        ({"x": 1}, "Smoothness is wanted"),
        ({"x": tb.Smoothness(at=PLACES[:5])}, r"\(12,\) are wanted"),
    ):
        with pytest.raises(ValueError, match=said):
            tb.identify_fields(blurred, data, start, wrong)
    for field in (torch.tensor(1.0), tb.Parameter(torch.full((P,), 0.5), "logit", bounds=(0, 1))):
        with pytest.raises(ValueError, match=r"one field \(n,\)"):
            tb.identify_fields(blurred, data, {"x": field}, {"x": tb.Smoothness()})
    for weight, said in (
        ({"y": 1.0}, "of x are wanted"),
        ({"x": -1.0}, "positive ones are wanted"),
    ):
        with pytest.raises(ValueError, match=said):
            tb.identify_fields(blurred, data, start, {"x": tb.Smoothness()}, weight=weight)
    with pytest.raises(ValueError, match="absolute_sigma=False was given to identify_fields"):
        tb.identify_fields(blurred, data, start, {"x": tb.Smoothness()}, absolute_sigma=False)
    with pytest.raises(ValueError, match="noise='channel' was given to identify_fields"):
        tb.identify_fields(blurred, data, start, {"x": tb.Smoothness()}, noise="channel")
    for none, said in (
        ({}, "data of no experiment"),
        (0 * data, "data that are all zero"),
        ({"one": 0 * data}, "data that are all zero"),
    ):
        with pytest.raises(ValueError, match=said):
            tb.identify_fields(blurred, none, start, {"x": tb.Smoothness()})
    with pytest.raises(ValueError, match="0, 1 or 2 is wanted"):
        tb.Smoothness(3)
    with pytest.raises(ValueError, match="4 or more"):
        tb.Smoothness(2).rows(torch.zeros(3))


@pytest.mark.parametrize("named", [False, True])
def test_sigma_beside_bare_data(named):
    """It is that of a measurement; by the names of experiments too."""
    data, options = noisy(0.02), dict(weight={"x": 0.3})
    field = {"x": torch.full((P,), 0.5)}, {"x": tb.Smoothness()}
    of = [tb.identify_fields(blurred, tb.Measurement(data, 0.02), *field, **options)]
    given = ({"a": data}, {"a": 0.02}) if named else (data, 0.02)
    of.append(tb.identify_fields(blurred, given[0], *field, sigma=given[1], **options))
    assert_close(of[1]["x"], of[0]["x"], rtol=1e-9, atol=1e-12)
    assert of[1].sigma == of[0].sigma == 1.0


def test_noise_that_remembers_is_weighed_by_its_long_run():
    """A field of 12 numbers through 120 readings whose noise is alike from one to the next (0.8):
    with sigma over sqrt((1 - 0.8)/(1 + 0.8)) = 3 times, as the refusal of "blocks" says, 95 %
    intervals hold the truth, with sigma as it is in half of the cases."""
    true, held = torch.sin(torch.linspace(0, 3, 12)), {0.1: 0.0, 0.3: 0.0}

    def wide(f):
        stretched = torch.nn.functional.interpolate(
            f[:, None], 120, mode="linear", align_corners=True
        )
        return stretched[:, 0]

    def found(y, sigma, noise="white"):
        data = tb.Measurement(y, sigma, times=torch.linspace(0, 3, 120), noise=noise)
        start, smooth = {"f": torch.zeros(12)}, {"f": tb.Smoothness(2)}
        return tb.identify_fields(lambda p: wide(p["f"]), data, start, smooth)

    for seed in range(5):
        e = torch.randn(120, generator=torch.Generator().manual_seed(seed))
        for k in range(1, 120):
            e[k] = 0.8 * e[k - 1] + 0.6 * e[k]
        y = wide(true[None])[0] + 0.1 * e
        for sigma in held:
            low, high = found(y, sigma).interval("f").unbind(-1)
            held[sigma] += ((low < true) & (true < high)).double().mean().item() / 5
    assert held[0.3] > 0.9
    assert held[0.1] < 0.7
    with pytest.raises(ValueError, match="noise='blocks' was given to identify_fields"):
        found(y, 0.1, "blocks")
