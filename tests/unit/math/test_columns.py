"""Products by columns are what products with the matrix are, of all shapes, and differentiable."""

import pytest
import torch
from torch.testing import assert_close

from torchbeam.math import columns as columns_of
from torchbeam.math.columns import Columns

MATRICES = {
    "in place": torch.eye(2, 3),
    "moved": torch.eye(4)[[2, 0, 1]],
    "signs": torch.tensor([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0]]),
    "a product": torch.tensor([[0.5, 1.0], [1.0, 0.0]]),
    "one row": torch.tensor([[0.0, 0.0, -1.0]]),
}


@pytest.mark.parametrize("name", MATRICES)
@pytest.mark.parametrize("shape", [(), (3,), (2, 0), (2, 3)])
def test_columns(name, shape, monkeypatch):
    monkeypatch.setattr(columns_of, "FEW", 0)
    matrix = MATRICES[name].double()
    columns = Columns.of(matrix)
    x = torch.randn(*shape, len(matrix), dtype=torch.float64, requires_grad=True)
    assert (columns.runs is None) == (name == "a product")
    assert_close(columns(x), x @ matrix, rtol=0, atol=0)
    rest = torch.where((matrix == 0).all(0), torch.arange(1.0, 1 + matrix.shape[1]), 0.0).double()
    assert_close(columns(x, rest), x @ matrix + rest, rtol=0, atol=0)
    y = torch.randn(*shape, matrix.shape[1], dtype=torch.float64)
    grads = [torch.autograd.grad((z * y).sum(), x)[0] for z in (columns(x), x @ matrix)]
    assert_close(*grads, rtol=0, atol=1e-15)
    if shape:
        assert_close(torch.func.vmap(columns)(x), x @ matrix, rtol=0, atol=0)
