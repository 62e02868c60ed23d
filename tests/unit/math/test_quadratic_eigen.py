"""Which eigenvalues are the slowest."""

import pytest
import torch

from torchbeam.math.quadratic_eigen import slow_first


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_of_two_as_slow_the_growing_one_is_first(sign):
    """A pair of real eigenvalues of one size, in either order, whatever rounding adds. A column
    past buckling was said to be stable where the decaying one alone was among those asked for.
    """
    pair = sign * torch.tensor([2226.0, -2226.0]) * torch.tensor([1.0, 1 + 1e-13])
    value = torch.cat((torch.complex(pair, 0 * pair), torch.tensor([837j, -837j, 1581j, -1581j])))
    kept = value[slow_first(value, 3, False)]
    assert kept.real.max() > 2225 and kept.real.min() == 0
