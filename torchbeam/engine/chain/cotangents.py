"""Cotangents: steps that native code has made, as a function that torch differentiates
backwards.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import Tensor
from torch._C import _functorch as functorch

from ...core.entry_point import without_autocast
from ...math.first_derivative import first_only
from .call import Call, Field, Output, ProgramInstance
from .chain_constants import Trees, flattened
from .interaction_sorts import INTERACTIONS
from .interactions import kept, present
from .layout import FORCES
from .native import NativeProgram
from .sorts import ELEMENT, NODE

OF_MULTIPLIERS = {FORCES: ("multiplier_state", "last_force")}
WHOLE = ("stress", "reaction")  # parts of a state whose cotangents have records of their own


def state_fields(program: NativeProgram) -> dict[str, tuple[str, str]]:
    """Record and field of what a program's steps change."""
    kinds = program.kinds
    return {
        **{name: (NODE.state, name) for name in program.state},
        "stress": ("start_stress", "stress"),
        "reaction": ("support", "last"),
        **{name: (ELEMENT.state, name) for name in program.element_state},
        **{name: ("sample", name) for name in program.sample_state},
        **(OF_MULTIPLIERS if program.kinds.multiplied else {}),
        **{sort.kept: (sort.state, sort.kept) for sort in INTERACTIONS if kept(kinds, sort)},
        **{sort.of: (sort.whole, sort.of) for sort in present(kinds) if sort.of},
    }


def constant_fields(trees: Trees) -> Iterator[Field]:
    """The tensors of the trees."""
    for record, tree in trees.by_record.items():
        for k, (x, axes) in enumerate(flattened(tree)):
            yield Field(record, f"{record}.{k}", x, axes)


class Adjoint:
    """What the cotangents of K steps of a batch are found from: instance of the adjoint program;
    fields of the constants, those that change and those that do not; good (K, B): which samples
    moved; wanted: numbers, among these fields and then the parts of the start, of what cotangents
    are asked of; calls: those made before, with the numbers of what they give.
    """

    def __init__(
        self,
        instance: ProgramInstance,
        batch: torch.Size,
        lanes: int | None,
        calls: dict[Any, tuple[Call, list[int]]],
        changing: list[Field],
        constant: list[Field],
        good: Tensor,
        wanted: list[int],
    ) -> None:
        self.instance, self.batch, self.lanes, self.calls = instance, batch, lanes, calls
        self.good, self.wanted = good, wanted
        self.changing, self.constant, self.state = (
            changing,
            constant,
            state_fields(instance.program),
        )

    def cotangents(
        self, start: Sequence[Tensor], states: Sequence[Tensor], grads: Sequence[Tensor | None]
    ) -> list[Tensor | None]:
        """Of what is wanted, from those of the states after each step, None = zero."""
        bars = self._by_number(start, states, grads)
        sources = (*self.known, *start)
        return [bars[k].sum_to_size(sources[k].shape) if k in bars else None for k in self.wanted]

    def rows(
        self,
        count: int,
        start: Sequence[Tensor],
        states: Sequence[Tensor],
        grads: Sequence[Tensor | None],
        steps: int | None = None,
    ) -> list[Tensor | None]:
        """Those of so many rows at once, (count, ...) each. steps: how many of the first ones the
        cotangents are of, where they are zero behind them; None = all.
        """
        K, B = self.good.shape
        first = slice(steps)
        K = K if steps is None else steps
        batch = torch.Size((count, *self.batch))
        many = Adjoint(
            self.instance,
            batch,
            None,
            self.calls.setdefault(("rows", count, K), {}),
            [
                x._replace(value=x.value[first].unsqueeze(1)) if self._stepwise(k) else x
                for k, x in enumerate(self.changing)
            ],
            self.constant,
            self.good[first, None].expand(K, count, B).reshape(K, -1),
            self.wanted,
        )
        shapes = [
            after.shape[after.ndim - self._axes(name) :]
            for name, after in zip(self.state, states, strict=True)
        ]
        if steps is not None:
            states = [after[first] for after in states]
        if B > 1:  # the state of one sample is that of all rows
            states = [
                after.reshape(K, 1, B, *shape).expand(K, count, B, *shape)
                for after, shape in zip(states, shapes, strict=True)
            ]
        grads = [
            None if grad is None else grad.reshape(count, K, B, *shape).movedim(0, 1)
            for grad, shape in zip(grads, shapes, strict=True)
        ]
        sources, rows = (*self.known, *start), []
        cotangents = many._by_number(start, states, grads)
        for k in self.wanted:
            x = cotangents.get(k)
            if x is not None:
                shape, behind = sources[k].shape, 0
                if self._stepwise(k):
                    x, behind = x.movedim(1, 0), shape[0] - K
                    shape = (K, *shape[1:])
                x = x.sum_to_size((count, *(1,) * (x.ndim - 1 - len(shape)), *shape))
                x = x.reshape(count, *shape)
                if behind:
                    x = torch.cat((x, x.new_zeros(count, behind, *shape[1:])), 1)
            rows.append(x)
        return rows

    @property
    def known(self) -> list[Tensor]:
        """The constants."""
        return [x.value for x in (*self.changing, *self.constant)]

    def _by_number(
        self, start: Sequence[Tensor], states: Sequence[Tensor], grads: Sequence[Tensor | None]
    ) -> dict[int, Tensor]:
        """By number, of the whole batch: (K, *batch, ...) of constants that each step has its own
        of, (*batch, ...) of the others.
        """
        fields = [
            *self.changing,
            Field("sample", "good", self.good, 0, flat=True),
            *self._steps(start, states, grads),
        ]
        form = (*self.wanted, None, *[grad is None for grad in grads])
        if form not in self.calls:
            self.calls[form] = self._backward(fields, start)
        call, numbers = self.calls[form]
        found = call.holding(self.constant).run([field.value for field in fields])
        return {
            k: x.reshape((*(call.K,) * steps, *call.batch, *x.shape[1 + steps :]))
            for k, x in zip(numbers, found, strict=True)
            for steps in (self._stepwise(k),)
        }

    def _stepwise(self, k: int) -> bool:
        """Whether each step has its own of the constant of this number."""
        known = (*self.changing, *self.constant)
        return k < len(known) and known[k].value.ndim - known[k].axes > len(self.batch)

    def _steps(
        self, start: Sequence[Tensor], states: Sequence[Tensor], grads: Sequence[Tensor | None]
    ) -> Iterator[Field]:
        """The states that each step lies between, and the cotangents of what it made."""
        K, B = self.good.shape
        for name, x, after, grad in zip(self.state, start, states, grads, strict=True):
            axes = after.shape[after.ndim - self._axes(name) :]
            grad = after.new_zeros(axes) if grad is None else grad.reshape(K, B, *axes).contiguous()
            yield Field(*self._place(name, "_grad"), grad, len(axes), flat=True)
            samples = after.shape[: after.ndim - len(axes)].numel() // K
            after = after.reshape(K, samples, *axes).contiguous()
            if name == "reaction":
                yield Field("support", "found", after, 2, flat=True)
            elif name == "stress":
                yield Field("stress", "stress", after, 2, flat=True)
            elif name == FORCES:
                yield Field("multiplier_after", "force", after, 2, flat=True)
            elif self.state[name][0] == NODE.state:
                yield Field("after", f"after_{name}", after, 2, flat=True)
            before = self.state[name]
            if self.instance.has(*before):
                first = x.expand((*self.batch, *axes)).reshape(1, B, *axes)[:, :samples]
                yield Field(*before, torch.cat((first, after[:-1])), len(axes), flat=True)

    def _axes(self, name: str) -> int:
        return 0 if self.state[name][0] == "sample" else 2

    def _place(self, name: str, what: str) -> tuple[str, str]:
        """Record and field of the "_bar" or "_grad" of a part of the state."""
        record, field = self.state[name]
        if record == "sample":
            return record, f"{name}{what}"
        return (f"{name}{what}", name) if name in WHOLE else (f"{record}{what}", field)

    def _backward(self, fields: list[Field], start: Sequence[Tensor]) -> tuple[Call, list[int]]:
        """The call with such fields, which are other tensors each time, and the numbers of what it
        gives.
        """
        instance, known = self.instance, [*self.changing, *self.constant]
        outputs: dict[int, Output] = {}
        for k in self.wanted:
            if k < len(known):
                one = known[k]
                record, name = f"{one.record}_bar", one.name
                if not instance.has(record, name):
                    continue
                rows = one.record != "common"
                shape = one.value.shape[one.value.ndim - one.axes + rows :]
                if rows:
                    components = instance.program.layout.records[record].fields[name][1]
                    shape = (instance.rows(record) * components // shape.numel(), *shape)
            else:
                x, part = start[k - len(known)], [*self.state][k - len(known)]
                record, name = self._place(part, "_bar")
                shape = x.shape[x.ndim - self._axes(part) :]
            outputs[k] = Output(record, name, shape, self._stepwise(k))
        made = [*outputs.values()]
        K = len(self.good)
        call = Call(instance, self.batch, K, fields, made, self.constant, lanes=self.lanes)
        return call, [*outputs]


class _Rows(torch.autograd.Function):
    """Cotangents, of which torch.func.vmap takes many rows at once, of steps that were made
    once.
    """

    @staticmethod
    def forward(
        adjoint: Adjoint, start: Sequence[Tensor], states: Sequence[Tensor], *grads: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        return tuple(adjoint.cotangents(start, states, grads))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Any, ...]) -> None:
        pass

    @staticmethod
    def vmap(
        info: Any,
        in_dims: tuple[Any, ...],
        adjoint: Adjoint,
        start: Sequence[Tensor],
        states: Sequence[Tensor],
        *grads: Tensor | None,
    ) -> tuple[tuple[Tensor | None, ...], tuple[int | None, ...]]:
        count = info.batch_size
        rows = [
            grad if grad is None or dim is None else grad.movedim(dim, 0)
            for grad, dim in zip(grads, in_dims[3:], strict=True)
        ]
        rows = [
            grad.expand(count, *grad.shape) if grad is not None and dim is None else grad
            for grad, dim in zip(rows, in_dims[3:], strict=True)
        ]
        with torch.no_grad():
            cotangents = adjoint.rows(count, start, states, rows)
        return tuple(cotangents), tuple(None if x is None else 0 for x in cotangents)


class Differentiated(torch.autograd.Function):
    """The states after steps that were made, as functions of what is wanted of the constants and
    the start.
    """

    @staticmethod
    def forward(
        ctx: Any, adjoint: Adjoint, start: list[Tensor], states: list[Tensor], *wanted: Tensor
    ) -> tuple[Tensor, ...]:
        ctx.adjoint = adjoint
        ctx.set_materialize_grads(False)
        # constants are read by where they lie: saved, so that torch refuses those that were written
        # to in the meantime
        ctx.save_for_backward(*start, *states, *adjoint.known)
        return tuple(states)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        adjoint, saved, count = ctx.adjoint, ctx.saved_tensors, len(grads)
        start, states, known = saved[:count], saved[count : 2 * count], saved[2 * count :]
        with torch.no_grad(), without_autocast():  # it may be on where backward is called
            if functorch.peek_interpreter_stack() is None:
                cotangents = adjoint.cotangents(start, states, grads)
            else:
                cotangents = _Rows.apply(adjoint, start, states, *grads)
        sources = [grad for grad in grads if grad is not None] + [
            (*known, *start)[k] for k in adjoint.wanted
        ]
        return (
            None,
            None,
            None,
            *(None if x is None else first_only(x, *sources) for x in cotangents),
        )


def rows_of_steps(outputs: Sequence[Tensor], rows: Sequence[Tensor], by: Tensor) -> Tensor | None:
    """Derivatives (count, *by.shape) by a tensor, of so many weighted sums of what one call of
    native steps (K, ...) has made: rows (count, steps, ...), the weights of each output after the
    first steps, those behind them being zero. None where the outputs are not those of one call.
    """
    node = outputs[0].grad_fn
    if not isinstance(getattr(node, "adjoint", None), Adjoint) or any(
        x.grad_fn is not node for x in outputs
    ):
        return None
    adjoint, saved = node.adjoint, node.saved_tensors
    size, (count, steps) = len(adjoint.state), rows[0].shape[:2]
    start, states, known = saved[:size], saved[size : 2 * size], saved[2 * size :]
    grads: list[Tensor | None] = [None] * size
    for x, shape in zip(outputs, rows, strict=True):
        grads[x.output_nr] = shape
    with torch.no_grad(), without_autocast():
        cotangents = adjoint.rows(count, start, states, grads, steps)
    sources = [(*known, *start)[k] for k in adjoint.wanted]
    pairs = [(x, bar) for x, bar in zip(sources, cotangents, strict=True) if bar is not None]
    return rows_of_sums([x for x, _ in pairs], [bar for _, bar in pairs], by)


def rows_of_sums(outputs: Sequence[Tensor], rows: Sequence[Tensor], by: Tensor) -> Tensor:
    """The same, by torch alone, of whatever the outputs were made of."""

    def row(*weights: Tensor) -> Tensor:
        return torch.autograd.grad(
            outputs, by, weights, retain_graph=True, allow_unused=True, materialize_grads=True
        )[0]

    return torch.func.vmap(row)(*rows)
