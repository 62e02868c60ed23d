"""Numbers of tensors are compared as they stand: whatever writes to them is seen."""

import pytest
import torch

from torchbeam.core.numbers import Numbers


def optimized(kind, **options):
    def write(x):
        x.requires_grad_().grad = torch.ones_like(x)
        kind([x], lr=0.1, **options).step()
        x.requires_grad_(False)

    return write


def moved(x):
    x.data = x.detach().clone()


def shortened(x):
    x.data = x.data[:1]


WRITES = {
    "in place": lambda x: x.mul_(2),
    "data": lambda x: x.data.mul_(2),
    "other memory": moved,  # native tables hold addresses
    "numpy": lambda x: x.numpy().__imul__(2),
    "other strides": lambda x: x.t_(),
    "fewer at the same place": shortened,
    "as many, of another shape": lambda x: x.resize_(4, 1),
    "a view": lambda x: x[0].copy_(torch.full_like(x[0], 7.0)),
    "fused Adam": optimized(torch.optim.Adam, fused=True),
    "foreach Adam": optimized(torch.optim.Adam, foreach=True),
    "fused SGD": optimized(torch.optim.SGD, fused=True),
}


@pytest.mark.parametrize("write", WRITES)
def test_whatever_writes_is_seen(write):
    """Beside a tensor without numbers."""
    both = x, _ = torch.tensor([[1.0, 2.0], [3.0, 4.0]]), torch.zeros(0, 3)
    before = Numbers.of(both)
    assert before.stand(both)
    WRITES[write](x)
    assert not before.stand(both) and Numbers.of(both).stand(both)


@torch.inference_mode()
def test_tensors_of_inference_mode_are_looked_at_too():
    """They have no version."""
    x = torch.ones(3)
    before = Numbers.of([x])
    assert before.stand([x])
    x.mul_(2)
    assert not before.stand([x])


@pytest.mark.parametrize(
    "part", [lambda x: x[:, 1], lambda x: x.mT, lambda x: x[1:, ::2], lambda x: x[0].expand(5, 4)]
)
def test_parts_of_memory_are_looked_at_whole(part):
    """The last number of a part with gaps, or of fewer numbers than it shows, counts as the first;
    the number behind it does not.
    """
    x = torch.arange(12.0).reshape(3, 4)
    seen = part(x)
    before, last = Numbers.of([seen]), seen[(-1,) * seen.ndim]
    behind = last.as_strided((1,), (1,), last.storage_offset() + 1) if last != 11 else None
    if behind is not None:
        behind.add_(1)
        assert before.stand([seen])
    last.add_(1)
    assert not before.stand([seen])


def test_what_has_no_memory_here_is_not_known():
    torch.func.vmap(lambda x: [x.sum(), Numbers.of([x]) is None or 1 / 0][0])(torch.ones(2, 3))
    assert Numbers.of([torch.ones(2, device="meta")]) is None
    assert Numbers.of([torch.ones(2), torch.ones(2, device="meta")]) is None
