"""Steps that native code has made, and the memory of a sequence of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ...core.status import SUCCESS
from ...scene.effects import Inputs
from .call import empty_like, like


class Steps(NamedTuple):
    """Fields of the state, status and iterations after one step (...), or after each of K (K, ...);
    whether all went well; every: fields are those after every so many of the K steps.
    """

    fields: dict[str, Tensor]
    status: Tensor
    iterations: Tensor
    well: bool
    every: int = 1

    @classmethod
    def of(cls, fields: dict[str, Tensor], status: Tensor, iterations: Tensor, every: int) -> Steps:
        """From numbers as native code gives them."""
        failed = status.item() if status.numel() == 1 else status.numpy().any()
        return cls(fields, status.long(), iterations.long(), not failed, every)

    @property
    def leading(self) -> int:
        """How many of the first of K steps no sample has failed in."""
        return [
            *(self.status == SUCCESS).reshape(len(self.status), -1).all(1).tolist(),
            False,
        ].index(False)


class Whole:
    """Memory of a sequence of K steps, which are made by several calls."""

    def __init__(self, K: int) -> None:
        self.K, self.tensors = K, []

    def behind(self, first: int) -> Callable[[list[Tensor]], list[Tensor]]:
        """See `CompiledStep`, `into`: the steps from `first` on."""

        def into(templates: list[Tensor]) -> list[Tensor]:
            if not self.tensors:
                whole = (like((self.K, *x.shape[1:]), x.dtype) for x in templates)
                self.tensors = empty_like(whole)
            count = len(templates[0])
            return [x[first : first + count] for x in self.tensors]

        return into

    @staticmethod
    def of(parts: list[Tensor]) -> Tensor:
        """Of all steps, one part after the other: where these are all of a whole, that itself."""
        whole, shape = parts[0]._base, (sum(map(len, parts)), *parts[0].shape[1:])
        if whole is not None and whole.shape == shape and all(x._base is whole for x in parts):
            return whole
        return torch.cat(parts)


def in_steps(
    K: int, axes: int, dims: int, dt: Tensor, t: Tensor, inputs: Inputs
) -> tuple[Tensor, Tensor, Inputs]:
    """Of K steps of samples with so many axes, (K, ...) with `dims` of them."""

    def spaced(x: Tensor, axes: int) -> Tensor:
        return x.reshape(K, *(1,) * (dims + 1 + axes - x.ndim), *x.shape[1:])

    dt, t = (x if x.ndim == 0 else spaced(x, 0) for x in (dt, t))
    return dt, t, {k: spaced(x, 1) if x.ndim > axes + 1 else x for k, x in inputs.items()}
