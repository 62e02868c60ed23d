"""Readings: what a traced function does with tensors beside torch's operations on them."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import Tensor
from torch._C import _functorch as functorch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from .decompositions import FUNCTIONS

READ = {torch.Tensor.tolist, torch.Tensor.numpy, torch.Tensor.__array__, torch.Tensor.__dlpack__}
# beginnings of the paths of files
PACKAGE, TORCH, HERE = (
    f"{folder}{os.sep}"
    for folder in (Path(__file__).parents[2], Path(torch.__file__).parent, Path(__file__).parent)
)
LIBRARIES = TORCH, HERE


class NotTraceable(Exception):
    """The function depends on the values of its inputs in a way that no graph of scalar operations
    can express.

    Examples:
        >>> def sign(x):
        ...     return x if x > 0 else -x
        >>> try:
        ...     extend.trace(sign, {"x": torch.ones(())})
        ... except extend.NotTraceable:
        ...     print("control flow by a value")
        control flow by a value
    """


def _frame() -> FrameType | None:
    """The innermost outside of torch and of this folder."""
    frame = sys._getframe(1)
    while frame is not None and frame.f_code.co_filename.startswith(LIBRARIES):
        frame = frame.f_back
    return frame


def of_user() -> bool:
    """Whether the traced function is in code outside of this package."""
    frame = _frame()
    return frame is not None and not frame.f_code.co_filename.startswith(PACKAGE)


def line() -> str:
    """Where the traced function is."""
    frame = _frame()
    return (
        ""
        if frame is None
        else f"{frame.f_code.co_filename}:{frame.f_lineno}, in {frame.f_code.co_name}"
    )


class Readings(TorchFunctionMode):
    """Refuses what reads a traced tensor's memory beside torch's operations, and puts inputs in the
    place of tensors that a function reads beside its arguments. traced: whether a tensor is; stand:
    by the id of a tensor what stands for it.
    """

    def __init__(self, traced: Callable[[Any], bool], stand: dict[int, Tensor]) -> None:
        super().__init__()
        self.traced, self.stand = traced, stand

    def __torch_function__(
        self, func: Callable, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        kwargs = kwargs or {}
        if self.stand:
            args, kwargs = self._standing(args), self._standing(kwargs)
        if func in READ and self.traced(args[0]):
            raise NotTraceable(
                f"{func.__name__} of a traced tensor was asked for at {line()}; a graph has no "
                "values"
            )
        if func is torch.Tensor.__getitem__:
            return self._picked(*args)
        if func is torch.Tensor.data.__get__:
            func = torch.Tensor.detach
        func = FUNCTIONS.get(func, func)
        return func(*args, **kwargs)

    def _picked(self, x: Tensor, places: Any) -> Tensor:
        """x[places]; a traced place without axes, whose value torch would ask for, as one of
        one.
        """
        listed = places if isinstance(places, tuple) else (places,)
        if not any(isinstance(p, Tensor) for p in listed):
            return x[places]
        single = [
            isinstance(p, Tensor)
            and p.ndim == 0
            and p.dtype in (torch.int64, torch.int32)
            and self.traced(p)
            for p in listed
        ]
        if not any(single):
            return x[places]
        chosen = x[tuple(p[None] if one else p for p, one in zip(listed, single, strict=True))]
        return chosen[0] if single[0] else chosen[..., 0]

    def _standing(self, value: Any) -> Any:
        if isinstance(value, Tensor):
            return self.stand.get(id(value), value)
        if type(value) in (tuple, list):
            return type(value)(map(self._standing, value))
        return (
            {name: self._standing(part) for name, part in value.items()}
            if type(value) is dict
            else value
        )


def memory(x: Tensor) -> int:
    """Which it is, also of a tensor that torch.func has wrapped; of what has none its own name."""
    while functorch.is_functorch_wrapped_tensor(x):
        x = functorch.get_unwrapped(x)
    return id(x) if x._is_zerotensor() else x.untyped_storage()._cdata


class Mode(TorchDispatchMode):
    """A mode that torch's compiler is not asked about: its import takes longer than tracing."""

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        return False


class Ungraded(Mode):
    """Notices what code outside of this package computes where gradients are off."""

    ungraded = False

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        self.ungraded |= not torch.is_grad_enabled() and of_user()
        return func(*args, **(kwargs or {}))
