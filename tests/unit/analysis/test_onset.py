"""Ends of unstable ranges by a straight line."""

import math

import pytest
import torch

from torchbeam.analysis.onset import unstable_between
from torchbeam.linear.whirl import Motions

SPEED = torch.tensor([10.0, 20.0, 30.0])


@pytest.mark.parametrize(
    "first, second, low",
    [
        (-1.0, 0.25, 18.0),  # 20 - 10 * 0.25/1.25
        (9.9e-8, 2.5e-7, 10.0),  # both next to rounding: the line has its zero at 3.4
    ],
)
def test_a_line_ends_at_a_speed_that_is_stable(first, second, low):
    """Growth 0.5 1/s at the last speed, and at those before."""
    value = torch.tensor([[first + 10j], [second + 10j], [0.5 + 10j]])
    motions = Motions(value, torch.ones(3, 1, 2, dtype=value.dtype))
    growing = torch.tensor([False, second > 1e-4, True])
    (ends,) = unstable_between(SPEED, motions, growing, None, math.inf)
    assert ends == pytest.approx((low, 30.0), rel=1e-12)
