"""Sobol indices: Ishigami's function, whose indices are known; fields, failures, folders; SALib
where it is installed.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.uncertainty.designs import Exchanged, Sobol
from torchbeam.uncertainty.joint_law import JointLaw

A, B = 7.0, 0.1
LAWS = {name: (-math.pi, math.pi) for name in "xyz"}
V = A * A / 8 + B * math.pi**4 / 5 + B * B * math.pi**8 / 18 + 0.5  # Ishigami and Homma 1990
FIRST = torch.tensor([0.5 * (1 + B * math.pi**4 / 5) ** 2, A * A / 8, 0.0]) / V
TOTAL = (
    torch.tensor(
        [FIRST[0] * V + 8 * B * B * math.pi**8 / 225, A * A / 8, 8 * B * B * math.pi**8 / 225]
    )
    / V
)


def ishigami(theta):
    x, y, z = theta.unbind(-1)
    return x.sin() + A * y.sin().square() + B * z**4 * x.sin()


def test_ishigami():
    """2^12 points: within 2e-2, a standard error; the true ones are in the intervals, but for a
    tenth of their width.
    """
    found = tb.sobol_indices(ishigami, LAWS, 4096, chunk=4096)
    assert_close(found.variance, torch.tensor(V), rtol=1e-2, atol=0)
    for value, low, high, wanted in (
        (found.first, found.low[0], found.high[0], FIRST),
        (found.total, found.low[1], found.high[1], TOTAL),
    ):
        assert_close(value, wanted, rtol=0, atol=2e-2)
        assert ((wanted - value).abs() < 0.6 * (high - low)).all() and (high - low < 0.1).all()
    assert found.evaluations == 5 * 4096 and found.failed == 0 and "y first" in repr(found)


def test_of_histories_and_constants_and_fields():
    """y = c k + sum of a field: shares by hand; a constant has none; a field counts as one."""
    field = tb.laws.RandomField([0.0, 0.5, 1.0], 0.0, 1.0, 1.0, marginal="normal", terms=2)
    laws = {"c": tb.laws.Normal(0.0, 2.0), "k": tb.laws.Constant(3.0), "f": field}

    def function(c, k, f):
        return torch.stack((c * k, c + f.sum(-1)), -1)

    found = tb.sobol_indices(function, laws, 1024, by_name=True)
    of_field = ((field.shape.sum(0) ** 2) * field.eigenvalue).sum()
    wanted = torch.tensor([[1.0, 4 / (4 + of_field)], [0.0, of_field / (4 + of_field)]])
    assert found.names == ("c", "f") and found.first.shape == (2, 2)
    assert_close(found.first, wanted, rtol=0, atol=4e-2)  # three standard errors
    assert_close(found.total, wanted, rtol=0, atol=4e-2)


def test_failed_groups_are_left_out(tmp_path):
    """One failed sample takes its group with it, and no more; a folder takes up what is there."""
    calls = []

    def function(theta):
        calls.append(len(theta))
        return torch.where(theta[:, 0] > 3.0, torch.nan, ishigami(theta))

    found = tb.sobol_indices(function, LAWS, 1024, chunk=640, out=tmp_path)
    assert (
        0 < found.failed < 1024 * 0.1
        and list(found.reasons) == ["y is not finite"]
        and torch.isfinite(found.first).all()
    )
    again = tb.sobol_indices(function, LAWS, 1024, chunk=640, out=tmp_path)
    assert sum(calls) == 5120 and (again.total == found.total).all()


def test_replicates_without_good_groups():
    """y = a + 2 b fails in whole replicates: those do not count for the interval, which is that of
    the others; of one that is left it is infinite.
    """

    def function(good):
        calls = []

        def failing(theta):
            calls.append(len(theta))
            return torch.where(
                torch.tensor(len(calls) in good), theta[:, 0] + 2 * theta[:, 1], torch.nan
            )

        return failing

    laws, run = {"a": (0.0, 1.0), "b": (0.0, 1.0)}, dict(n=64, replicates=4, chunk=64)
    half, one = (tb.sobol_indices(function(good), laws, **run) for good in ((1, 2), (3,)))
    y = tb.sobol_indices(function((1, 2, 3, 4)), laws, **{**run, "n": 32, "replicates": 2})
    for name in ("first", "total", "low", "high"):
        assert_close(getattr(half, name), getattr(y, name))
    assert half.failed == 32 and torch.isfinite(half.high).all()
    assert one.failed == 48 and torch.isfinite(one.first).all()
    assert (one.high == math.inf).all() and (one.low == -math.inf).all()


def test_salib():
    """The same estimators at the same samples: equal."""
    sobol = pytest.importorskip("SALib.analyze.sobol")
    n = 256
    plan = Exchanged(Sobol(6, 0, n), torch.eye(3, dtype=torch.bool))
    y = ishigami(plan.theta(JointLaw.of(LAWS), 0, 5 * n)).reshape(n, 5)
    order = y[:, [0, 2, 3, 4, 1]].flatten()  # SALib's: A, AB_i, B
    theirs = sobol.analyze(
        dict(num_vars=3, names=list("xyz"), bounds=[[-math.pi, math.pi]] * 3),
        order.numpy(),
        calc_second_order=False,
    )
    from torchbeam.uncertainty.sobol_indices import _indices

    ours = _indices(y)
    # its variance divides by n
    assert_close(ours[0], torch.from_numpy(theirs["S1"]), rtol=0, atol=5e-3)
    assert_close(ours[1], torch.from_numpy(theirs["ST"]), rtol=0, atol=5e-3)


REFUSED = {
    "replicates": (dict(n=100), "n = 100 was given for 16 replicates"),
    "one replicate": (dict(replicates=1), "replicates = 1 was given"),
    "constants": (dict(laws={"a": tb.laws.Constant(1.0)}), "laws that are all constant"),
    "interval": (dict(interval=2), "interval = 2 was given"),
    "all failed": (
        dict(function=lambda theta: theta[:, 0] / 0),
        "all 32 groups have samples that failed",
    ),
}


@refusals(REFUSED)
def test_refused(changed):
    tb.sobol_indices(**{**dict(function=ishigami, laws=LAWS, n=32), **changed})


def test_a_correlation_is_refused():
    with pytest.raises(
        ValueError,
        match=r"correlation was given to sobol_indices, .* laws of independent ones are wanted",
    ):
        tb.sobol_indices(
            lambda theta: theta.sum(-1),
            {"a": (0.0, 1.0), "b": (0.0, 1.0)},
            16,
            correlation={("a", "b"): 0.5},
        )
