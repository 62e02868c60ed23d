"""Joint laws: correlation of scores and ranks, fields among scalars, names; refusals."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.uncertainty.designs import Sobol
from torchbeam.uncertainty.joint_law import JointLaw

LAWS = {
    "a": tb.laws.LogNormal(1.0, 0.3),
    "k": tb.laws.Constant(7.0),
    "b": tb.laws.Weibull(1.0, 1.5),
    "c": (0.0, 1.0),
}
C = torch.tensor([[1.0, 0, 0.6, -0.4], [0, 1, 0, 0], [0.6, 0, 1, 0.1], [-0.4, 0, 0.1, 1]])


def ranks(theta):
    return theta.argsort(0).argsort(0).double()


def test_correlation():
    """Spearman's rank correlation of 2^14 samples: 6/pi asin(rho/2), to 2e-3; the marginals are as
    without.
    """
    joint = JointLaw.of(LAWS, C)
    u = Sobol(joint.dimension, 0).uniform(0, 2**14)
    theta, alone = joint.of_uniform(u), JointLaw.of(LAWS).of_uniform(u)
    assert joint.dimension == 3 and (theta[:, 1] == 7).all()
    found = torch.corrcoef(ranks(theta[:, [0, 2, 3]]).mT)
    assert_close(found, 6 / math.pi * (C[[0, 2, 3]][:, [0, 2, 3]] / 2).asin(), rtol=0, atol=2e-3)
    assert_close(theta.mean(0), alone.mean(0), rtol=2e-3, atol=0)
    assert_close(theta.std(0)[[0, 2, 3]], alone.std(0)[[0, 2, 3]], rtol=1e-2, atol=0)
    by_pairs = JointLaw.of(LAWS, {("a", "b"): 0.6, ("c", "a"): -0.4, ("b", "c"): 0.1})
    assert_close(by_pairs.of_uniform(u), theta)


def test_fields_among_scalars():
    """Columns and variates each in their place; by name."""
    field = tb.laws.RandomField([0.1, 0.5, 0.9], 2.0, 0.2, correlation_length=0.5)
    joint = JointLaw.of(
        {"m": (0.0, 1.0), "EI": field, "P": tb.laws.Normal(1.0, 0.1)}, {("m", "P"): 0.9}
    )
    z = torch.randn(5, joint.dimension, generator=torch.Generator().manual_seed(0))
    theta = joint.of_score(z)
    assert (
        joint.names == ("m", "EI[0]", "EI[1]", "EI[2]", "P") and joint.dimension == 2 + field.terms
    )
    named = joint.named(theta)
    assert_close(named["EI"], field.of_scores(z[:, 1:-1]))
    assert_close(named["m"], torch.special.ndtr(z[:, 0]))
    assert_close(named["P"], 1 + 0.1 * (0.9 * z[:, 0] + math.sqrt(1 - 0.81) * z[:, -1]))


def test_by_name_and_in_a_folder(tmp_path):
    """The function gets its parameters by name; a folder is of one correlation."""

    def total(a, b, c, k):
        return a + 2 * b + c * k

    def of_columns(theta):
        return theta[:, 0] + 2 * theta[:, 2] + theta[:, 3] * theta[:, 1]

    options = dict(n=32, chunk=8, by_name=True, out=tmp_path)
    found = tb.monte_carlo(total, LAWS, correlation=C, **options)
    assert_close(found.y, of_columns(found.theta))
    assert (tb.monte_carlo(total, LAWS, correlation=C, **options).y == found.y).all()
    for other in (
        None,
        C @ C.mT * 0 + torch.eye(4),
        {("a", "b"): 0.60001, ("c", "a"): -0.4, ("b", "c"): 0.1},
    ):
        with pytest.raises(ValueError, match="another correlation was given"):
            tb.monte_carlo(total, LAWS, correlation=other, **options)


# fmt: off
REFUSED = {
    "of another size": (torch.eye(3), r"correlation \(3, 3\) was given for 4 laws; \(4, 4\)"),
    "not symmetric": (C + 0.1 * torch.ones(4, 4).triu(1), "not symmetric"),
    "a diagonal": (2 * torch.eye(4), "whose diagonal is not 1"),
    "indefinite": ({("a", "b"): 0.9, ("b", "c"): 0.9, ("a", "c"): -0.9},
                   "the eigenvalue -0.8 was given; a positive def"),
    "of a constant": ({("a", "k"): 0.5}, "of 'k' was given, which is a constant"),
    "twice": ({("a", "b"): 0.5, ("b", "a"): 0.3},
              r"of \('a', 'b'\) and one of \('b', 'a'\) were given"),
    "of an unknown": ({("a", "z"): 0.5},
                      r"a correlation of \('a', 'z'\) was given; two of a, k, b, c"),
}
# fmt: on


@refusals(REFUSED)
def test_refused(given):
    tb.monte_carlo(torch.sin, LAWS, 8, correlation=given)
