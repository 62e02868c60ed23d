"""Derivatives switched off, and cached properties that keep what was computed so apart."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache, cached_property
from itertools import product
from typing import Any

import torch
from torch import Tensor
from torch._C import _functorch as functorch
from torch._functorch import eager_transforms
from torch.autograd import forward_ad
from torch.autograd.graph import _engine_run_backward


@contextmanager
def no_derivatives() -> Iterator[None]:
    """No backward graph and no forward tangents."""
    with torch.no_grad(), torch.autograd.forward_ad._set_fwd_grad_enabled(False):
        yield


def untracked(tensors: Iterable[torch.Tensor]) -> bool:
    """Whether no derivative of these is recorded, in either mode, and no torch.func runs."""
    if forward_ad._current_level >= 0 or functorch.peek_interpreter_stack() is not None:
        return False
    recorded = torch.is_grad_enabled()
    for x in tensors:
        if (recorded and x.requires_grad) or functorch.is_functorch_wrapped_tensor(x):
            return False
    return True


def lasting() -> AbstractContextManager[None]:
    """For values that are kept: in inference mode too they can be used in a graph later."""
    return _past_inference() if torch.is_inference_mode_enabled() else NOTHING


@contextmanager
def _past_inference() -> Iterator[None]:
    with torch.inference_mode(False), torch.no_grad():
        yield


NOTHING = nullcontext()


def vjp(function: Callable[..., Any], *xs: Tensor) -> tuple[Any, Callable[..., tuple[Tensor, ...]]]:
    """function(*xs), a tensor or a tuple of tensors, and the map from its cotangents to those of
    the tensors xs: `torch.func.vjp`, whose map imports torch's compiler and a computer algebra
    system first, for more than two seconds.
    """
    with eager_transforms.grad_increment_nesting() as level, torch.enable_grad():
        own = eager_transforms._create_differentiable(
            eager_transforms._wrap_all_tensors(xs, level), level
        )
        inner = function(*own)
        value = eager_transforms._undo_create_differentiable(inner, level)
    values = inner if isinstance(inner, tuple) else (inner,)

    def pull(cotangents: Any) -> tuple[Tensor, ...]:
        each = cotangents if isinstance(cotangents, tuple) else (cotangents,)
        pairs = [(y, v) for y, v in zip(values, each, strict=True) if y.requires_grad]
        slopes: tuple[Tensor | None, ...] = (None,) * len(own)
        if pairs:
            outputs, bars = zip(*pairs, strict=True)
            graph = torch.is_grad_enabled()
            with lasting():
                # torch.autograd.grad without its look at shapes; as there: the graph is retained,
                # and recorded again, unused inputs are allowed
                slopes = _engine_run_backward(
                    outputs, bars, True, graph, own, True, accumulate_grad=False
                )
        return tuple(
            torch.zeros_like(x) if v is None else v for x, v in zip(own, slopes, strict=True)
        )

    return value, pull


class cached(cached_property):
    """A cached property of one value for each mode of recording derivatives: what Newton's method
    has computed without them is never taken for what the implicit function theorem differentiates,
    so that a problem may be asked for both, in any order, without a copy. What was computed with
    all of them recorded serves without them as well.
    """

    def __set_name__(self, owner: type, name: str) -> None:
        super().__set_name__(owner, name)
        modes = product((False, True), (False, True))
        self.keys = {(grad, dual): f"{name} {grad:d}{dual:d}" for grad, dual in modes}
        self.recorded = self.keys[True, True]

    def __get__(self, owner: Any, kind: type | None = None) -> Any:
        if owner is None:
            return self
        held = owner.__dict__
        value = held.get(self.recorded, ABSENT)  # asked for most, and serves all
        if value is ABSENT:
            key = self.keys[torch.is_grad_enabled(), torch._C._is_fwd_grad_enabled()]
            value = held.get(key, ABSENT)
            if value is ABSENT:
                if torch.is_inference_mode_enabled():
                    with _past_inference():
                        value = self.func(owner)
                else:  # no context, in less time
                    value = self.func(owner)
                held[key] = value
        return value


ABSENT = object()


def cache_of(owner: Any, name: str) -> bool:
    """Whether an attribute of that name is a cached value: no field has a space in its name."""
    return " " in name or name in caches_of(type(owner))


@cache
def caches_of(kind: type) -> frozenset[str]:
    """Names of the cached properties of a class."""
    return frozenset(
        name for name in dir(kind) if isinstance(getattr(kind, name, None), cached_property)
    )
