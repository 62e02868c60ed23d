"""Calls of a native program: tables of the tensors that it reads and writes, its memory, its arguments."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...nodal.model import Model
from .chain_code import ENTRY, POINTERS
from .layout import ONE
from .local_problem import Kinds
from .native import NativeProgram

CPU = torch.device("cpu")  # whatever the default device is
WORK = 4096  # samples times elements times steps that are worth a thread of their own (about a millisecond)


class Field(NamedTuple):
    """A tensor that stands for a field of a record: `axes` of its own, of which the first are the record's rows, if it has any;
    before them the samples', and before these, where it has more, one of steps. flat: the samples' axes are one.
    """

    record: str
    name: str
    value: Tensor
    axes: int
    flat: bool = False


class Chain:
    """A model with nodes and elements of these kinds in the memory of a program. free (N+1, w) bool: what supports leave of the
    nodes.
    """

    def __init__(self, program: NativeProgram, model: Model, kinds: Kinds) -> None:
        self.program, self.dtype = program, model.length.dtype
        self.N, self.supports, self.free = model.count, model.constraints.nodes, model.constraints.moving
        records, N = program.layout.records, self.N
        bases, self.size = program.layout.bases(N, len(self.supports))
        self.base = dict(zip(records, bases, strict=True))
        support_of = [self.supports.index(j) if j in self.supports else -1 for j in range(N + 1)]
        near = [int(any(support_of[i] >= 0 for i in range(max(j - 1, 0), min(j + 2, N + 1)))) for j in range(N + 1)]
        nodes, elements = ([there.index(kind) for kind in own] for there, own in zip(program.kinds, kinds, strict=True))
        lists = bases, nodes, elements, near, support_of, [*self.supports, 0]
        self.lists = dict(zip(POINTERS[1:], map(_integers, lists), strict=True))
        self._blocks: dict[int, list[Tensor]] = {}  # of memory that no call uses, by lanes

    def has(self, record: str, name: str) -> bool:
        return name in getattr(self.program.layout.records.get(record), "fields", ())

    def lanes(self, samples: int) -> int:
        """As this processor has them; one for a sample alone."""
        return 1 if samples == 1 else self.program.lanes()

    def taken(self, lanes: int) -> Tensor:
        """A block of memory, to be given back after the call."""
        try:
            return self._blocks.setdefault(lanes, []).pop()
        except IndexError:
            return torch.zeros(self.size * lanes, dtype=self.dtype, device=CPU)

    def given_back(self, lanes: int, block: Tensor) -> None:
        self._blocks[lanes].append(block)


class Table:
    """Where a program finds fields, or puts them: rows of integers, see `chain_code.ENTRY`. Fields that the program does not
    have are left out.
    """

    def __init__(self, chain: Chain, fields: Sequence[Field], batch: torch.Size) -> None:
        self.chain, self.batch = chain, batch
        self.held: list[Tensor] = []
        self.places: list[tuple[int, int, Field | None]] = []  # (which integer, which field, itself where it is copied)
        rows: list[int] = []
        for k, one in enumerate(fields):
            if chain.has(one.record, one.name):
                x = self._fitted(one)
                copied = x.data_ptr() != one.value.data_ptr()
                self.places.append((len(rows), k, one._replace(value=None) if copied else None))
                rows += self._row(one, x)
                self.held.append(x)
        self.count, self.array = len(rows) // len(ENTRY), _integers(rows)

    def of(self, values: Sequence[Tensor], held: list[Any]) -> Any:
        """The rows for other tensors of the same shapes and strides, those of the first fields; what has to last as long as
        the call is put into `held`.
        """
        array, count = type(self.array).from_buffer_copy(self.array), len(values)
        for place, k, copied in self.places:
            if k < count:
                x = values[k]
                if copied is not None:
                    x = self._fitted(copied._replace(value=x))
                    held.append(x)
                array[place] = x.data_ptr()
        held.append(array)
        return array

    def _fitted(self, one: Field) -> Tensor:
        """The tensor as (steps, samples, rows, components), the components one after the other in memory."""
        x, record = one.value, self.chain.program.layout.records[one.record]
        components = record.fields[one.name][1]
        batch = torch.Size((self.batch.numel(),)) if one.flat else self.batch
        lead, own = x.shape[:x.ndim - one.axes], x.shape[x.ndim - one.axes:]
        steps, lead = (lead[0], lead[1:]) if len(lead) > len(batch) else (1, lead)
        samples = lead.numel()
        if x.dtype != self.chain.dtype:
            x = x.to(self.chain.dtype)
        if 1 < samples < batch.numel():
            x, samples = x.reshape(steps, *lead, *own).expand(steps, *batch, *own), batch.numel()
        x = x.reshape(steps, samples, 1 if record.rows == ONE else own[0], components)
        return x.contiguous() if components > 1 and x.stride(-1) != 1 else x

    def _row(self, one: Field, x: Tensor) -> tuple[int, ...]:
        chain = self.chain
        layout = chain.program.layout
        record = layout.records[one.record]
        first, components = record.fields[one.name]
        step, sample, row = (0 if n == 1 else stride for n, stride in zip(x.shape[:3], x.stride()[:3], strict=True))
        return (x.data_ptr(), sample, step, row, layout.rows(record, chain.N, len(chain.supports)), components,
                chain.base[one.record] + first, record.size)


class Call:
    """K steps of a batch of samples of a chain; lanes: None = as this processor has them."""

    def __init__(self, chain: Chain, batch: torch.Size, K: int, lanes: int | None = None) -> None:
        self.chain, self.batch, self.K, self.B = chain, batch, K, batch.numel()
        self.lanes = lanes or chain.lanes(self.B)
        self.groups = -(-self.B // self.lanes)
        names = chain.program.driver.ARGS
        numbers = {"samples": self.B, "steps": K, "elements": chain.N, "supports": len(chain.supports),
                   "end_group": self.groups, **{name: ctypes.addressof(x) for name, x in chain.lists.items()}}
        self.numbers = _integers(numbers.get(name, 0) for name in names)
        self.place = {name: k for k, name in enumerate(names)}

    def empty(self, *own: int, steps: bool = True) -> Tensor:
        """For a flat field that is written."""
        return torch.empty(*(self.K,) * steps, self.B, *own, dtype=self.chain.dtype, device=CPU)

    def made(self, limit: int = 0, **tables: Iterable[Field]) -> None:
        """Run with these tables, by the names of the driver's arguments."""
        found = {name: Table(self.chain, [*fields], self.batch) for name, fields in tables.items()}
        self.run({name: (table.array, table.count) for name, table in found.items()}, found, limit)

    def run(self, tables: dict[str, tuple[Any, int]], held: Any, limit: int = 0) -> None:
        """tables: rows and their number, by the names of the driver's arguments; held: what lasts as long as the call."""
        numbers, place = type(self.numbers).from_buffer_copy(self.numbers), self.place
        for name, (array, count) in tables.items():
            numbers[place[name]], numbers[place[f"{name[:-1]}_count"]] = ctypes.addressof(array), count
        if "limit" in place:
            numbers[place["limit"]] = limit
        run = self.chain.program.run(self.lanes)
        threads = min(torch.get_num_threads(), self.groups, self.B * self.chain.N * self.K // WORK)
        if threads < 2:
            self._part(run, numbers, held)
            return
        ends = [self.groups * k // threads for k in range(threads + 1)]
        parts = []
        for first, end in pairwise(ends):
            part = type(numbers).from_buffer_copy(numbers)
            part[place["first_group"]], part[place["end_group"]] = first, end
            parts.append(part)
        others = [threading.Thread(target=self._part, args=(run, part, held)) for part in parts[1:]]
        for thread in others:
            thread.start()
        self._part(run, parts[0], held)
        for thread in others:
            thread.join()

    def _part(self, run: Callable[[Any], None], numbers: Any, held: Any) -> None:
        """Some groups of the samples; a thread of its own keeps what is `held`, should nobody wait for it."""
        block = self.chain.taken(self.lanes)
        numbers[self.place["memory"]] = block.data_ptr()
        run(numbers)
        self.chain.given_back(self.lanes, block)


def _integers(values: Iterable[int]) -> Any:
    values = tuple(values)
    return (ctypes.c_int64 * len(values))(*values)
