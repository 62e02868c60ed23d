"""Derivatives of moments by the parameters of laws: closed forms, and a beam's by differences."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals


def lognormal_inverse(q):
    return {"EI": tb.laws.LogNormal(q[0], q[1])}


def test_inverse_of_a_lognormal():
    """1/EI is lognormal: mean = exp(s^2)/m = (1 + c^2)/m, c = d/m, deviation = mean c. Derivatives
    by m and d by hand.
    """
    q = torch.tensor([2.0, 0.4])
    found = tb.moment_derivatives(
        lambda theta: 1 / theta[:, 0], lognormal_inverse, q, 2**14, chunk=1024
    )
    m, d = q.clone().requires_grad_().unbind()
    mean = (1 + (d / m) ** 2) / m
    deviation = mean * d / m
    by = [torch.stack(torch.autograd.grad(y, (m, d), retain_graph=True)) for y in (mean, deviation)]
    pairs = (
        (found.mean, mean),
        (found.deviation, deviation),
        (found.mean_by, by[0]),
        (found.deviation_by, by[1]),
    )
    for estimate, wanted in pairs:
        assert_close(estimate.estimate, wanted.detach(), rtol=2e-3, atol=0)
        assert (estimate.low <= estimate.estimate).all() and (
            estimate.high - estimate.low < 0.02 * wanted.abs()
        ).all()
    assert found.mean.samples == 2**14 and "by 2 parameters" in repr(found)


def test_of_several_numbers_torchs_laws_and_correlation():
    """y = (a, a b), a and b normal with correlation rho: E(a b) = m_a m_b + rho d_a d_b."""

    def laws(q):
        return {
            "a": torch.distributions.Normal(q[0], q[1]),
            "b": torch.distributions.Normal(q[2], q[3]),
        }

    q = torch.tensor([1.0, 0.2, 3.0, 0.5])
    found = tb.moment_derivatives(
        lambda a, b: torch.stack((a, a * b), -1), laws, q, 4096, correlation={("a", "b"): 0.6},
        by_name=True,
    )  # fmt: skip
    wanted = torch.tensor([[1.0, 3.0], [0.0, 0.6 * 0.5], [0.0, 1.0], [0.0, 0.6 * 0.2]])
    assert_close(found.mean_by.estimate, wanted, rtol=0, atol=5e-3)
    assert_close(
        found.deviation_by.estimate[:, 0], torch.tensor([0.0, 1.0, 0.0, 0.0]), rtol=0, atol=5e-3
    )


def test_failed_samples_do_not_count():
    """Neither in values nor in derivatives."""
    found = tb.moment_derivatives(
        lambda theta: torch.where(theta[:, 0] > 1, torch.nan, theta[:, 0]),
        lambda q: {"x": lambda u: q[0] * u}, torch.tensor([2.0]), 1024, replicates=8,
    )  # fmt: skip
    assert found.mean.reasons == {"y is not finite": 512}
    assert_close(found.mean.estimate, torch.tensor(0.5), rtol=1e-3, atol=0)
    assert_close(found.mean_by.estimate, torch.tensor([0.25]), rtol=1e-3, atol=0)


def test_a_number_that_does_not_vary():
    """A history that begins at rest: there mean and deviation are 0, and so are their derivatives
    and intervals.
    """
    found = tb.moment_derivatives(
        lambda theta: theta * torch.tensor([0.0, 1.0]),
        lambda q: {"x": lambda u: q[0] * u},
        torch.tensor([2.0]),
        256,
    )
    for estimate in (found.mean, found.deviation, found.mean_by, found.deviation_by):
        assert all((x[..., 0] == 0).all() for x in estimate)
    assert_close(found.deviation_by.estimate[0, 1], torch.tensor(12**-0.5), rtol=1e-2, atol=0)


def test_beam():
    """Mean tip deflection of a strip by mean and deviation of its stiffness: by differences of the
    same samples.
    """

    def deflection(theta):
        section = tb.Section.from_stiffness(
            EA=math.inf, GA=math.inf, GJ=1.0, EI=theta[:, 0], mass=1.0
        )
        state = tb.equilibrium(
            tb.Scene(
                tb.Beam.straight(1.0, 4, section), [tb.TipLoad(force=(0, 0, 1.0))], plane="xz"
            ),
            throw=False,
        )
        return state.tip.position[:, 2], state.status

    q, options = torch.tensor([1.0, 0.2]), dict(n=64, replicates=4)
    found = tb.moment_derivatives(deflection, lognormal_inverse, q, **options)
    h = 1e-4
    for k in range(2):
        step = h * torch.eye(2)[k]
        up, down = (
            tb.monte_carlo(deflection, lognormal_inverse(q + s * step), 64, replicates=4)
            for s in (1, -1)
        )
        assert_close(found.mean_by.estimate[k], (up.mean - down.mean) / (2 * h), rtol=1e-5, atol=0)
        assert_close(
            found.deviation_by.estimate[k],
            (up.deviation - down.deviation) / (2 * h),
            rtol=1e-5,
            atol=0,
        )


def test_single_precision_far_from_zero():
    """y = 1000 + x, x normal with a deviation of 0.1: known to float32's last bit of y, 6e-5, not
    to that of y^2.
    """
    found = tb.moment_derivatives(
        lambda theta: 1000 + theta[:, 0],
        lambda q: {"x": tb.laws.Normal(q[0], q[1])},
        torch.tensor([0.0, 0.1], dtype=torch.float32),
        1024,
    )
    assert found.deviation.estimate.item() == pytest.approx(0.1, rel=0.02)
    assert_close(
        found.deviation_by.estimate, torch.tensor([0.0, 1.0]), rtol=0.02, atol=0.02,
        check_dtype=False,
    )  # fmt: skip


def test_double_precision_far_from_zero():
    """y = 1e8 + x in float64: squares of y, 1e16, end at 2."""
    found = tb.moment_derivatives(
        lambda theta: 1e8 + theta[:, 0],
        lambda q: {"x": tb.laws.Normal(q[0], q[1])},
        torch.tensor([0.0, 0.1]),
        1024,
    )
    assert found.mean.estimate.item() - 1e8 == pytest.approx(0.0, abs=1e-3)
    assert found.deviation.estimate.item() == pytest.approx(0.1, rel=0.02)
    assert_close(found.deviation_by.estimate, torch.tensor([0.0, 1.0]), rtol=0, atol=0.02)


def test_replicates_with_one_good_sample():
    """They count for the moments, though they have no deviation of their own."""
    found = tb.moment_derivatives(
        lambda theta: torch.where(theta[:, 0] > 0.6, torch.nan, theta[:, 0]),
        lambda q: {"x": lambda u: q[0] * u},
        torch.tensor([1.0]),
        32,
    )
    assert found.mean.samples + found.mean.failed == 32 and torch.isfinite(found.deviation.low)


REFUSED = {
    "laws as a dict": (
        dict(laws={"a": (0.0, 1.0)}),
        r"laws = \{'a': \(0.0, 1.0\)\} was given; a function",
    ),
    "no gradient": (dict(function=lambda theta: theta.detach()), "carries no gradient"),
    "a gradient by something else": (
        dict(function=lambda theta: theta.detach() * torch.ones(1, requires_grad=True)),
        "carries no gradient by q",
    ),
    "a law that carries a part": (
        dict(laws=lambda q: {"EI": tb.laws.LogNormal(q[0], q[1].item())}),
        r"gradient by q\[1\] is 0 where its values change by",
    ),
    "a function that carries a part": (
        dict(function=lambda theta: theta + 2 * theta.detach()),
        r"gradient by q\[0\] is",
    ),
    "q": (dict(q=torch.ones(2, 2)), r"q \(2, 2\) was given; \(m,\)"),
    "replicates": (dict(n=100), "n = 100 was given for 16 replicates"),
    "all failed": (dict(function=lambda theta: theta / 0), "nearly all 32 samples failed"),
}


@refusals(REFUSED)
def test_refused(changed):
    usual = dict(function=torch.sin, laws=lognormal_inverse, q=torch.tensor([1.0, 0.2]), n=32)
    tb.moment_derivatives(**{**usual, **changed})


def test_a_truncated_law():
    """Of a uniform law from 0 to q between 0.5 and 1, whose values q does not change; of an
    exponential one beyond 1, by its scale: the mean is 1 + q. Bounds have no derivatives.
    """
    for kind, by in (
        (lambda q: tb.laws.Truncated(tb.laws.Uniform(0.0, q[0]), 0.5, 1.0), 0.0),
        (lambda q: tb.laws.Truncated(tb.laws.Weibull(q[0]), 1.0), 1.0),
    ):
        found = tb.moment_derivatives(
            lambda theta: theta[:, 0], lambda q, kind=kind: {"x": kind(q)}, [1.5], 1024
        )
        assert found.mean_by.estimate.item() == pytest.approx(by, abs=5e-3)
    with pytest.raises(ValueError, match="Truncated's least that carries a gradient"):
        tb.moment_derivatives(
            torch.sin, lambda q: {"x": tb.laws.Truncated((0.0, 4.0), q[0])}, [1.5], 32
        )


def test_a_field_has_none():
    with pytest.raises(ValueError, match="RandomField's deviation that carries a gradient"):
        tb.laws.RandomField([0.0, 1.0], 1.0, torch.tensor(0.1, requires_grad=True), 1.0)
