"""Cotangents: steps that native code has made, as a function that torch differentiates backwards."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .call import Call, Chain, Field
from .chain_constants import flattened


def state_fields(nodes: tuple[str, ...], elements: tuple[str, ...], samples: tuple[str, ...]) -> dict[str, tuple[str, str]]:
    """Record and field of what a step changes, `nodes` of a node, `elements` of an element beside its stress, and `samples`."""
    return {**{name: ("state", name) for name in nodes}, "stress": ("start_stress", "stress"), "reaction": ("support", "last"),
            **{name: ("element_state", name) for name in elements}, **{name: ("sample", name) for name in samples}}


def constant_fields(trees: tuple[Any, ...]) -> Iterator[Field]:
    """The tensors of the trees of nodes, elements, what they have in common, and supports."""
    for record, tree in zip(("node", "element", "common", "support"), trees, strict=True):
        for k, (x, axes) in enumerate(flattened(tree)):
            yield Field(record, f"{record}.{k}", x, axes)


class Adjoint:
    """What the cotangents of K steps that a call has made are found from: chain of the adjoint program; fields of the
    constants, without gradient; good (K, B): which samples moved.
    """

    def __init__(self, chain: Chain, call: Call, fields: list[Field], good: Tensor) -> None:
        self.chain, self.call, self.fields, self.good = chain, call, fields, good
        self.state = [*state_fields(chain.program.state, chain.program.element_state, chain.program.sample_state)]

    def cotangents(self, start: list[Tensor], made: tuple[Tensor, ...], grads: tuple[Tensor | None, ...], wanted: list[bool]
                   ) -> list[Tensor | None]:
        """Of the constants that are wanted, and of the start, from those of the states after each step."""
        chain, (K, B) = self.chain, self.good.shape
        layout, batch, stepped = chain.program.layout, self.call.batch, set()
        call = Call(chain, batch, K, self.call.lanes)
        inputs = [*self.fields, Field("free", "free", chain.free, 2), Field("sample", "good", self.good, 0, flat=True)]
        outputs, stepwise, found = [], [], {}
        for name, x, after, grad in zip(self.state, start, made, grads, strict=True):
            of_sample = name in chain.program.sample_state
            own = () if of_sample else after.shape[-2:]
            after = after.reshape(K, B, *own)
            grad = after.new_zeros(own) if grad is None else grad.reshape(K, B, *own).contiguous()
            record, field = {"stress": ("stress", "stress"), "reaction": ("reaction", "reaction")}.get(name, ("state", name))
            if of_sample:
                record = "sample"
            if name in chain.program.element_state:
                record = "element_state"
            place = {"reaction": ("support", "last")}.get(name, (record, field))
            if name == "reaction":
                inputs.append(Field("support", "found", after, 2, flat=True))
            if chain.has(*place) and name != "stress":
                first = x.expand(*batch, *own).reshape(1, B, *own)
                inputs.append(Field(*place, torch.cat((first, after[:-1])), 0 if of_sample else 2, flat=True))
            if name in chain.program.state:
                inputs.append(Field("after", f"after_{name}", after, 2, flat=True))
            elif name == "stress":
                inputs.append(Field("stress", "stress", after, 2, flat=True))
            found[name] = after.new_zeros(B, *own)
            if of_sample:
                inputs.append(Field("sample", f"{name}_grad", grad, 0, flat=True))
                outputs.append(Field("sample", f"{name}_bar", found[name], 0, flat=True))
            else:
                inputs.append(Field(f"{record}_grad", field, grad, 2, flat=True))
                outputs.append(Field(f"{record}_bar", field, found[name], 2, flat=True))
        for one in self.fields:
            record = layout.records[f"{one.record}_bar"]
            if one.name not in record.fields:
                continue
            rows = one.record != "common"
            every = (layout.rows(record, chain.N, len(chain.supports)),) * rows
            steps = one.value.ndim - one.axes > len(batch)
            found[one.name] = call.empty(*every, *one.value.shape[one.value.ndim - one.axes + rows:], steps=steps)
            field = Field(record.name, one.name, found[one.name], one.axes, flat=True)
            (stepwise if steps else outputs).append(field)
            stepped |= {one.name} if steps else set()
        call.made(inputs=inputs, outputs=outputs, stepwises=stepwise)

        def of(name: str, x: Tensor, asked: bool) -> Tensor | None:
            if not asked or name not in found:
                return None
            shape = found[name].shape
            shape = (K, *batch, *shape[2:]) if name in stepped else (*batch, *shape[1:])
            return found[name].reshape(shape).sum_to_size(x.shape)

        every = [*((one.name, one.value) for one in self.fields), *zip(self.state, start, strict=True)]
        return [of(*one, asked) for one, asked in zip(every, wanted, strict=True)]


class Differentiated(torch.autograd.Function):
    """The states after steps that were made, as functions of the constants and the start."""

    @staticmethod
    def forward(ctx: Any, adjoint: Adjoint, made: tuple[Tensor, ...], *held: Tensor) -> tuple[Tensor, ...]:
        ctx.adjoint = adjoint
        ctx.save_for_backward(*held[-len(made):], *made)
        return made

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        saved = ctx.saved_tensors
        count = len(grads)
        found = ctx.adjoint.cotangents([*saved[:count]], saved[count:], grads, ctx.needs_input_grad[2:])
        return None, None, *found
