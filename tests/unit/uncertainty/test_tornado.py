"""Tornado: swings of a function whose answers are known, the largest first."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

LAWS = {
    "a": (0.0, 1.0), "k": tb.laws.Constant(2.0), "b": (0.0, 10.0), "c": tb.laws.Normal(0.0, 1.0),
}  # fmt: skip


def function(a, k, b, c):
    return a * k + b - 0.1 * c


def test_swings():
    found = tb.tornado(function, LAWS, level=0.8, by_name=True)
    assert found.names == ("b", "a", "c") and (found.status == 0).all()
    assert_close(found.base, torch.tensor(6.0))
    assert_close(found.low, torch.tensor([2.0, 5.2, 6.128155]), rtol=1e-6, atol=0)
    assert_close(found.high, torch.tensor([10.0, 6.8, 5.871845]), rtol=1e-6, atol=0)
    assert_close(found.at[:2], torch.tensor([[1.0, 9.0], [0.1, 0.9]]))
    assert found.rows()[0] == pytest.approx(
        ("b", 1.0, 9.0, 2.0, 10.0)
    ) and "largest swing that of b" in repr(found)


def test_of_histories_with_a_field_and_a_failure():
    """A field moves by its first term; a failed sample is NaN and comes first, to be seen."""
    laws = {"f": tb.laws.RandomField([0.0, 1.0], 1.0, 0.1, 1.0), "x": (0.0, 1.0)}

    def function(theta):
        return torch.stack(
            (theta[:, 2], torch.where(theta[:, 2] > 0.9, torch.nan, theta[:, 0])), -1
        )

    found = tb.tornado(function, laws)
    assert (
        found.names == ("x", "f")
        and found.base.shape == (2,)
        and found.high[0].isnan().all()
        and found.status.sum() == 1
    )
    assert found.at[1].isnan().all() and found.high[1, 1] > found.low[1, 1]
    with pytest.raises(ValueError, match="one number is wanted"):
        found.rows()


def test_refused():
    with pytest.raises(ValueError, match="all constant"):
        tb.tornado(torch.sin, {"a": tb.laws.Constant(1.0)})
    with pytest.raises(ValueError, match="function = 3 was given; a function"):
        tb.tornado(3, LAWS)
    with pytest.raises(ValueError, match="level = 1 was given"):
        tb.tornado(torch.sin, LAWS, level=1)
