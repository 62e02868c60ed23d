"""Call of a native program: tables of the tensors that it reads and writes, its memory, its arguments."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...nodal.model import Model
from .chain_code import POINTERS
from .layout import ONE
from .local_problem import Kinds
from .native import NativeProgram


class Field(NamedTuple):
    """A tensor that stands for a field of a record: `axes` of its own, of which the first are the record's rows, if it has any;
    before them the samples', and before these, where it has more, one of steps. flat: the samples' axes are one.
    """

    record: str
    name: str
    value: Tensor
    axes: int
    flat: bool = False


class Call:
    """K steps of a batch of samples of a model with nodes and elements of these kinds; lanes: None = as this processor has
    them.
    """

    def __init__(self, program: NativeProgram, model: Model, kinds: Kinds, batch: torch.Size, K: int,
                 lanes: int | None = None) -> None:
        self.program, self.batch, self.K, self.dtype = program, batch, K, model.length.dtype
        self.B, self.N, self.supports = batch.numel(), model.count, model.constraints.nodes
        self.lanes = lanes or (1 if self.B == 1 else program.lanes())
        records, N = program.layout.records, self.N
        bases, self.size = program.layout.bases(N, len(self.supports))
        self.base = dict(zip(records, bases, strict=True))
        support_of = [self.supports.index(j) if j in self.supports else -1 for j in range(N + 1)]
        near = [int(any(support_of[i] >= 0 for i in range(max(j - 1, 0), min(j + 2, N + 1)))) for j in range(N + 1)]
        nodes, elements = ([there.index(kind) for kind in own] for there, own in zip(program.kinds, kinds, strict=True))
        lists = bases, nodes, elements, near, support_of, [*self.supports, 0]
        self.chain = dict(zip(POINTERS[1:], map(_integers, lists), strict=True))

    def empty(self, *own: int, steps: bool = True) -> Tensor:
        """For a flat field that is written."""
        return torch.empty(*(self.K,) * steps, self.B, *own, dtype=self.dtype)

    def run(self, limit: int = 0, **tables: Iterable[Field]) -> None:
        """tables: by the names of the driver's arguments; fields of records that the program does not have are left out."""
        held: list[Any] = []
        numbers = {"samples": self.B, "steps": self.K, "elements": self.N, "supports": len(self.supports), "limit": limit,
                   "first_group": 0, "end_group": -(-self.B // self.lanes)}
        for name, fields in tables.items():
            rows = [self._entry(one, held) for one in fields
                    if one.name in getattr(self.program.layout.records.get(one.record), "fields", ())]
            array = _integers(x for row in rows for x in row)
            held.append(array)
            numbers |= {name: ctypes.addressof(array), f"{name[:-1]}_count": len(rows)}
        memory = torch.zeros(self.size * self.lanes, dtype=self.dtype)
        numbers |= {"memory": memory.data_ptr(), **{name: ctypes.addressof(x) for name, x in self.chain.items()}}
        self.program.run(self.lanes)(_integers(numbers[name] for name in self.program.driver.ARGS))

    def _entry(self, one: Field, held: list[Any]) -> tuple[int, ...]:
        """A row of a table, see `chain_code.ENTRY`; what has to last as long as the call is put into `held`."""
        x, layout = one.value, self.program.layout
        record = layout.records[one.record]
        first, components = record.fields[one.name]
        batch = torch.Size((self.B,)) if one.flat else self.batch
        lead, own = x.shape[:x.ndim - one.axes], x.shape[x.ndim - one.axes:]
        steps, lead = (lead[0], lead[1:]) if len(lead) > len(batch) else (1, lead)
        samples = lead.numel()
        if x.dtype != self.dtype:
            x = x.to(self.dtype)
        if 1 < samples < self.B:
            x, samples = x.reshape(steps, *lead, *own).expand(steps, *batch, *own), self.B
        x = x.reshape(steps, samples, 1 if record.rows == ONE else own[0], components)
        if components > 1 and x.stride(-1) != 1:
            x = x.contiguous()
        held.append(x)
        step, sample, row = (0 if n == 1 else stride for n, stride in zip(x.shape[:3], x.stride()[:3], strict=True))
        return (x.data_ptr(), sample, step, row, layout.rows(record, self.N, len(self.supports)), components,
                self.base[one.record] + first, record.size)


def _integers(values: Iterable[int]) -> Any:
    values = tuple(values)
    return (ctypes.c_int64 * len(values))(*values)
