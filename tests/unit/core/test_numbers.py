"""Numbers of tensors are compared as they stand: whatever wrote to them, and nothing else, is seen."""

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


WRITES = {
    "in place": lambda x: x.mul_(2),
    "data": lambda x: x.data.mul_(2),
    "other memory": moved,  # native tables hold addresses
    "numpy": lambda x: x.numpy().__imul__(2),
    "a view": lambda x: x[0].copy_(torch.full_like(x[0], 7.0)),
    "fused Adam": optimized(torch.optim.Adam, fused=True),
    "foreach Adam": optimized(torch.optim.Adam, foreach=True),
    "fused SGD": optimized(torch.optim.SGD, fused=True),
}


@pytest.mark.parametrize("write", WRITES)
@pytest.mark.parametrize("inference", [False, True])
def test_whatever_writes_is_seen(write, inference):
    """Also of tensors of inference mode, which have no version, beside one without numbers."""
    with torch.inference_mode(inference):
        x, beside = torch.tensor([[1.0, 2.0], [3.0, 4.0]]), torch.zeros(0, 3)
        before = Numbers.of([beside, x])
        assert before.stand([beside, x])
        if inference and "Adam" in write + "Adam" * ("SGD" in write):
            return  # records no gradient
        WRITES[write](x)
        assert not before.stand([beside, x]) and Numbers.of([beside, x]).stand([beside, x])


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
