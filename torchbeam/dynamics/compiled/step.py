"""Compiled step: steps of a scene by native code, from tensors to tensors."""

from __future__ import annotations

import ctypes

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from ...core.leaves import leaves
from ...nodal.model import Model
from ...scene.effects import Inputs
from ...state.state import State
from .constants import constants, flattened
from .driver import ARGS
from .local_functions import NODE, LocalFunctions
from .program import Program, structure

PROGRAMS: dict[tuple, Program] = {}


class Steps(NamedTuple):
    """After each of K steps: fields of the state (K, ..., ...), status (K, ...) and iterations (K, ...)."""

    state: State
    status: Tensor
    iterations: Tensor


def march(model: Model, start: State, dt: Tensor, t: Tensor, inputs: Inputs, moving: Tensor, tolerance: float, least: float,
          limit: int, lanes: int | None = None) -> Steps:
    """K steps from `start`, in the space's coordinates.

    dt, t   (K, ...) s: lengths of the steps, and their middles, with as many axes behind K as the samples have
    inputs  by name, (..., size) held over all steps, or (K, ..., size)
    moving  (...) bool: samples that step; one whose step fails keeps its state and stops
    least   cosine of a quarter of the largest turn of a node

    A sample's status is 0 while it goes well (and for one that does not move); its iterations in a step that it does not make
    are 0.
    """
    K, nb = dt.shape[0], moving.ndim
    nodes, elements, common = constants(model, dt, t, inputs)
    batch = torch.broadcast_shapes(moving.shape, start.batch_shape, *(
        x.shape[:x.ndim - axes][-nb:] if nb else () for tree in (nodes, elements, common) for x, axes in flattened(tree)))
    local = LocalFunctions(model, nodes, elements, common)
    loads, N = model.loads[0], model.count
    acting = [tuple(k for k, load in enumerate(loads) if load.node is None or load.node % (N + 1) == j) for j in range(N + 1)]
    kinds = tuple(dict.fromkeys(acting))
    supports = model.constraints.nodes
    key = structure(local, kinds, bool(supports))
    if key not in PROGRAMS:
        PROGRAMS[key] = Program(local, kinds, bool(supports))
    return _Call(PROGRAMS[key], model, batch, K, [kinds.index(x) for x in acting]).run(
        start, nodes, elements, common, moving, tolerance, least, limit, lanes)


class _Call:
    """One call of a program: its tables and memory."""

    def __init__(self, program: Program, model: Model, batch: torch.Size, K: int, kinds: list[int]) -> None:
        self.program, self.model, self.batch, self.K, self.kinds = program, model, batch, K, kinds
        self.B, self.N, self.dtype = batch.numel(), model.count, model.length.dtype
        self.held: list[Tensor] = []  # as long as the call lasts
        self.supports = len(model.constraints.nodes)
        self.bases, self.size = program.layout.bases(self.N, self.supports)

    def entry(self, record: str, field: str, x: Tensor, axes: int, rows: bool) -> list[int]:
        """A row of a table, see `driver.ENTRY`, of a tensor with `axes` own axes, of which the first are rows."""
        one = self.program.layout.records[record]
        begin, components = one.fields[field]
        lead, own = x.shape[:x.ndim - axes], x.shape[x.ndim - axes:]
        nb = len(self.batch)
        count = own[0] if rows else 1
        steps, lead = (lead[0], lead[1:]) if len(lead) > nb else (1, lead)
        wide = lead.numel() > 1
        x = x.to(self.dtype)
        if wide:
            x = x.reshape(steps, *lead, *own).expand(steps, *self.batch, *own)
        x = x.reshape(steps, self.B if wide else 1, count, components)
        if components > 1 and x.stride(-1) != 1:
            x = x.contiguous()
        self.held.append(x)
        strides = [0 if n == 1 else stride for n, stride in zip(x.shape[:3], x.stride()[:3], strict=True)]
        base = self.bases[list(self.program.layout.records).index(record)]
        every = self.program.layout.rows(one, self.N, self.supports)
        return [x.data_ptr(), strides[1], strides[0], strides[2], every, components, base + begin, one.size]

    def run(self, start: State, nodes, elements, common, moving: Tensor, tolerance: float, least: float, limit: int,
            lanes: int | None) -> Steps:
        model, K, B, N = self.model, self.K, self.B, self.N
        inputs = []
        for record, tree in (("node", nodes), ("element", elements), ("common", common)):
            fields = flattened(tree)
            for name, k, _ in self.program.given(record):
                inputs.append(self.entry(record, name, *fields[k], rows=record != "common"))
        like = model.length
        for name, x in dict(total=like.sum((-1, -2)), longest=like.amax((-1, -2)), tolerance=like.new_tensor(tolerance),
                            least=like.new_tensor(least)).items():
            inputs.append(self.entry("common", name, x, 0, False))
        for name in NODE:
            inputs.append(self.entry("state", name, getattr(start, name), 2, True))
        inputs.append(self.entry("start_stress", "stress", start.stress, 2, True))
        inputs.append(self.entry("sample", "moving", moving, 0, False))
        inputs.append(self.entry("sample", "work", start.work, 0, False))
        inputs.append(self.entry("sample", "last_status", like.new_zeros(()), 0, False))
        constraints = model.constraints
        if self.supports:
            inputs.append(self.entry("free", "free", constraints.moving, 2, True))
            inputs.append(self.entry("support", "last", start.reaction, 2, True))

        def new(*own: int) -> Tensor:
            return torch.empty(K, B, *own, dtype=self.dtype)

        out = {name: new(*getattr(start, name).shape[-2:]) for name in (*NODE, "stress", "reaction")}
        numbers = {name: new() for name in ("work", "status", "iterations")}
        places = {"stress": ("start_stress", "stress"), "reaction": ("support", "last"), "work": ("sample", "work"),
                  "status": ("sample", "last_status"), "iterations": ("sample", "iterations")}
        outputs = [self._out(*places.get(name, ("state", name)), x) for name, x in (out | numbers).items()
                   if name != "reaction" or self.supports]
        lanes = lanes or (1 if B == 1 else 64 // like.element_size())
        function = self.program.run(lanes)
        memory = torch.zeros(self.size * lanes + 64, dtype=self.dtype)
        support_of = [constraints.nodes.index(j) if j in constraints.nodes else -1 for j in range(N + 1)]
        held = [int(any(0 <= i <= N and support_of[i] >= 0 for i in (j - 1, j, j + 1))) for j in range(N + 1)]
        table = {"inputs": sum(inputs, []), "outputs": sum(outputs, []), "bases": self.bases, "kinds": self.kinds, "held": held,
                 "support_of": support_of, "support_nodes": [*constraints.nodes, 0]}
        arrays = {name: (ctypes.c_int64 * len(x))(*x) for name, x in table.items()}
        numbers_given = {"input_count": len(inputs), "output_count": len(outputs), "samples": B, "steps": K, "elements": N,
                         "memory": memory.data_ptr(), "supports": self.supports, "limit": limit, "first_group": 0,
                         "end_group": -(-B // lanes)}
        args = (ctypes.c_int64 * len(ARGS))(*(ctypes.addressof(arrays[name]) if name in arrays else numbers_given[name]
                                              for name in ARGS))
        function(ctypes.addressof(args))
        shape = (K, *self.batch)
        fields = {name: x.reshape(*shape, *x.shape[2:]) for name, x in out.items()}
        status, iterations = (numbers[name].reshape(shape).long() for name in ("status", "iterations"))
        work = numbers["work"].reshape(shape)
        return Steps(replace(start, **fields, work=work), status, iterations)

    def _out(self, record: str, field: str, x: Tensor) -> list[int]:
        axes = x.ndim - 2
        found = self.entry(record, field, x, axes, axes > 0)
        if x.numel():
            assert found[0] == x.data_ptr()
        return found
