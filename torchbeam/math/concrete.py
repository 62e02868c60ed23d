"""Numbers to decide by, where torch.func has wrapped a tensor."""

from __future__ import annotations

from torch import Tensor
from torch._C import _functorch as functorch


def concrete(x: Tensor) -> Tensor:
    """The numbers in x, to decide by: of every sample where torch.func.vmap shows one."""
    while functorch.is_functorch_wrapped_tensor(x):
        x = functorch.get_unwrapped(x)
    return x


def is_vmapped(x: Tensor) -> bool:
    """Whether x is one at a time of samples that torch.func.vmap has."""
    while functorch.is_functorch_wrapped_tensor(x):
        if functorch.is_batchedtensor(x):
            return True
        x = functorch.get_unwrapped(x)
    return False
