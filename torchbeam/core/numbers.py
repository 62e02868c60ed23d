"""What tells whether numbers of tensors are what they were, by whatever way they are written to."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import Array, c_char
from typing import NamedTuple

from torch import Tensor


class Numbers(NamedTuple):
    """Of some tensors: where they lie, their bytes and strides, a look at these places, and what
    stood there. NumPy, `.data` and fused optimizers leave a tensor's version as it was.
    """

    places: list[tuple[int, int, tuple[int, ...]]]
    looks: list[Array[c_char]]
    values: list[bytearray]

    @classmethod
    def of(cls, tensors: Sequence[Tensor]) -> Numbers | None:
        """Of tensors; None where nothing tells: for one off the CPU, and in torch.func."""
        try:
            places = _places(tensors)
        except RuntimeError:
            return None
        if not all([x.is_cpu for x in tensors]):
            return None
        pairs = zip(tensors, places, strict=True)
        looks = [(c_char * _extent(x)).from_address(place) for x, (place, *_) in pairs if place]
        return cls(places, looks, list(map(bytearray, looks)))

    def stand(self, tensors: Sequence[Tensor]) -> bool:
        """Whether these are tensors at the same places, with the same numbers to the bit."""
        # numbers last: what lay elsewhere, or behind the last of fewer, may be gone
        return _places(tensors) == self.places and self.values == self.looks


def _places(tensors: Sequence[Tensor]) -> list[tuple[int, int, tuple[int, ...]]]:
    return [(x.data_ptr(), x.nbytes, x.stride()) for x in tensors]


def _extent(x: Tensor) -> int:
    """Bytes from its first number to its last."""
    if x.is_contiguous():
        return x.nbytes
    return x.element_size() * (
        1 + sum((size - 1) * stride for size, stride in zip(x.shape, x.stride(), strict=True))
    )
