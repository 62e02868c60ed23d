"""Compiled step: steps of a model by native code, from tensors to tensors."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...core.leaves import functions, wants_gradient
from ...core.validation import concrete
from ...nodal.balance import same_law
from ...nodal.model import Model
from ...scene.effects import Inputs
from ...state.state import State
from .constants import Constants, flattened
from .driver import Driver
from .local_functions import NODE, LocalFunctions, NodeKind
from .program import program_of

OUTPUTS = {**{name: ("state", name) for name in NODE}, "stress": ("start_stress", "stress"), "reaction": ("support", "last"),
           "work": ("sample", "work"), "status": ("sample", "last_status"), "iterations": ("sample", "iterations")}


class Steps(NamedTuple):
    """After each of K steps: fields of the state (K, ...), status (K, ...) and iterations (K, ...)."""

    fields: dict[str, Tensor]
    status: Tensor
    iterations: Tensor

    def after(self, start: State, k: int) -> State:
        """The state after step k, in the space's coordinates, with the start's t and status."""
        return replace(start, **{name: x[k] for name, x in self.fields.items()})


class CompiledStep:
    """Steps of a model. Its program is traced at once, so that what cannot be traced is refused here (`NotTraceable`), and
    compiled at the first step.
    """

    def __init__(self, model: Model) -> None:
        self.model, self.constants = model, Constants(model)
        like, N = model.length, model.count
        nothing = {name: like.new_zeros(size) for name, size in model.scene.inputs.items()}
        trees = self.constants.at(like.new_ones(()), like.new_zeros(()), nothing)
        # axes that functions of t may bring along; one at least, so that none of theirs is taken for that of steps
        self.dims = max(1, *(x.ndim - axes for tree in trees for x, axes in flattened(tree)))
        loads = model.loads[0]
        self.functions = any(one.axes is None for one in functions(loads))
        acting = [tuple(k for k, load in enumerate(loads) if load.node is None or load.node % (N + 1) == j)
                  for j in range(N + 1)]
        hinges = {node: tuple(axis.tolist()) for node, axis in model.constraints.hinges}
        acting = [NodeKind(loads, hinges.get(j)) for j, loads in enumerate(acting)]
        kinds = tuple(dict.fromkeys(acting))
        self.supports = model.constraints.nodes
        self.program = program_of(LocalFunctions(model, *trees), kinds, bool(self.supports))
        self.bases, self.size = self.program.layout.bases(N, len(self.supports))
        self.base = dict(zip(self.program.layout.records, self.bases, strict=True))
        support_of = [self.supports.index(j) if j in self.supports else -1 for j in range(N + 1)]
        near = [int(any(support_of[i] >= 0 for i in range(max(j - 1, 0), min(j + 2, N + 1)))) for j in range(N + 1)]
        self.static = {name: _integers(x) for name, x in {
            "bases": self.bases, "kinds": [kinds.index(x) for x in acting], "held": near, "support_of": support_of,
            "support_nodes": [*self.supports, 0]}.items()}

    def __call__(self, start: State, dt: Tensor, t: Tensor, inputs: Inputs, moving: Tensor, tolerance: float, least: float,
                 limit: int, lanes: int | None = None) -> Steps | None:
        """K steps from `start`, in the space's coordinates.

        dt, t   (K) or (K, ...) s: lengths of the steps, and their middles
        inputs  by name, (..., size) held over all steps; or (K, ..., size), with as many axes between as `moving`
        moving  (...) bool: samples that step; one whose step fails keeps its state and stops
        least   cosine of half the largest angle that a node may have turned by at mid step

        A sample's status is 0 while it goes well, and for one that does not move; its iterations in a step that it does not
        make are 0. None where derivatives are recorded, or samples mapped over: torch alone can do these.
        """
        model, K, like, axes = self.model, dt.shape[0], self.model.length, moving.ndim
        dims = max(axes, self.dims)
        dt, t = (x.reshape(K, *(1,) * (dims + 1 - x.ndim), *x.shape[1:]) for x in (dt, t))
        inputs = {name: x.reshape(K, *(1,) * (dims + 2 - x.ndim), *x.shape[1:]) if x.ndim > axes + 1 else x
                  for name, x in inputs.items()}
        trees = self.constants.at(dt, t, inputs)
        fields = dict(zip(("node", "element", "common"), map(flattened, trees), strict=True))
        written = [] if not self.functions else [(self.constants.moving_loads(t, inputs), 2)]  # what these hold is unknown
        held = (x for part in (*fields.values(), flattened(start), written) for x, _ in part)
        if any(wants_gradient(x) or x is not concrete(x) for x in held):
            return None
        shapes = (x.shape[:x.ndim - axes] for tree in fields.values() for x, axes in tree)
        batch = torch.broadcast_shapes(moving.shape, start.batch_shape, *(shape[len(shape) > dims:] for shape in shapes))
        own_batch = batch[dims - axes:] if batch[:dims - axes].numel() == 1 else batch
        call = _Table(self, batch)
        for record, tree in fields.items():
            for name, k in self.program.given(record):
                call.add(record, name, *tree[k], rows=record != "common")
        exact = same_law(trees[1].C, model.law.C)
        for name, x in dict(total=like.sum((-1, -2)), longest=like.amax((-1, -2)), exact=exact,
                            tolerance=like.new_tensor(tolerance), least=like.new_tensor(least)).items():
            call.add("common", name, x, 0)
        for name, x in dict(moving=moving, work=start.work, last_status=like.new_zeros(())).items():
            call.add("sample", name, x, 0)
        for name in (*NODE, "stress"):
            call.add(*OUTPUTS[name], getattr(start, name), 2, rows=True)
        if self.supports:
            call.add("free", "free", model.constraints.moving, 2, rows=True)
            call.add("support", "last", start.reaction, 2, rows=True)
        inputs_table, count = call.table()
        B = batch.numel()
        own = {name: tuple(getattr(start, name).shape[-2:]) for name in (*NODE, "stress", "reaction")}
        found = {name: torch.empty(K, B, *own.get(name, ()), dtype=like.dtype) for name in OUTPUTS}
        out = _Table(self, torch.Size((B,)))
        for name, place in OUTPUTS.items():
            if found[name].shape[2:].numel():
                out.add(*place, found[name], found[name].ndim - 2, rows=name in own)
        outputs_table, output_count = out.table()
        lanes = lanes or (1 if B == 1 else self.program.lanes())
        memory = torch.zeros(self.size * lanes, dtype=like.dtype)
        numbers = {"input_count": count, "output_count": output_count, "samples": B, "steps": K, "elements": model.count,
                   "memory": memory.data_ptr(), "supports": len(self.supports), "limit": limit, "first_group": 0,
                   "end_group": -(-B // lanes)}
        arrays = {"inputs": inputs_table, "outputs": outputs_table, **self.static}
        self.program.run(lanes)(_integers(ctypes.addressof(arrays[name]) if name in arrays else numbers[name] for name in Driver.ARGS))
        found = {name: x.reshape(K, *own_batch, *x.shape[2:]) for name, x in found.items()}
        status, iterations = (found.pop(name).long() for name in ("status", "iterations"))
        return Steps(found, status, iterations)


def _integers(values: Iterable[int]) -> Any:
    values = tuple(values)
    return (ctypes.c_int64 * len(values))(*values)


class _Table:
    """Which tensors a call reads or writes, see `chain_code.ENTRY`; it keeps them."""

    def __init__(self, step: CompiledStep, batch: torch.Size) -> None:
        self.step, self.batch = step, batch
        self.rows: list[int] = []
        self.kept: list[Tensor] = []

    def add(self, record: str, field: str, x: Tensor, axes: int, rows: bool = False) -> None:
        """A tensor with `axes` own axes, of which the first are rows; before those of the batch it may have one of steps."""
        layout = self.step.program.layout
        one = layout.records[record]
        first, components = one.fields[field]
        lead, own = x.shape[:x.ndim - axes], x.shape[x.ndim - axes:]
        stepwise = len(lead) > len(self.batch)
        steps, lead = (lead[0], lead[1:]) if stepwise else (1, lead)
        count, samples = own[0] if rows else 1, lead.numel()
        if x.dtype != self.step.model.length.dtype:
            x = x.to(self.step.model.length.dtype)
        if 1 < samples < self.batch.numel():
            x = x.reshape(steps, *lead, *own).expand(steps, *self.batch, *own)
            samples = self.batch.numel()
        x = x.reshape(steps, samples, count, components)
        if components > 1 and x.stride(-1) != 1:
            x = x.contiguous()
        self.kept.append(x)
        step, sample, row = (0 if n == 1 else stride for n, stride in zip(x.shape, x.stride()[:3], strict=False))
        every = layout.rows(one, self.step.model.count, len(self.step.supports))
        self.rows += (x.data_ptr(), sample, step, row, every, components, self.step.base[record] + first, one.size)

    def table(self) -> tuple[Any, int]:
        """Its integers, and the number of its rows."""
        return _integers(self.rows), len(self.kept)
