"""First derivatives without second ones: asking for those is an error, never a number."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd import forward_ad


class Once(torch.autograd.Function):
    """x, to be differentiated once, in either mode: where its first derivative is right and a
    second one would lack a part, as for x + (y - y.detach()). All that x depends on has to stand in
    its graph.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(x: Tensor) -> Tensor:
        return x.clone()

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor], output: Tensor) -> None:
        ctx.save_for_backward(*inputs)
        ctx.save_for_forward(*inputs)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        return first_only(grad, grad, *ctx.saved_tensors)

    @staticmethod
    def jvp(ctx: Any, tangent: Tensor) -> Tensor:
        return first_only(tangent, tangent, *ctx.saved_tensors)


def first_only(derivative: Tensor, *sources: Tensor) -> Tensor:
    """A first derivative, forward or backward, in the graph of all that a second one would have to
    follow: `sources`. Whoever asks for that gets NotImplementedError, by whatever modes, and along
    whatever path.
    """
    recorded = torch.is_grad_enabled() or forward_ad._current_level >= 0
    return _FirstOnly.apply(derivative, *sources) if recorded else derivative


class _FirstOnly(torch.autograd.Function):
    generate_vmap_rule = True

    @staticmethod
    def forward(derivative: Tensor, *sources: Tensor) -> Tensor:
        return derivative.clone()

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, *_: Tensor) -> Any:
        raise NotImplementedError(
            "a second derivative was asked for through what is found by iteration, as an "
            "equilibrium, an implicit step, an event, modes or a critical load; there are first "
            "ones only"
        )

    jvp = backward
