"""Calls of a native program: tables of the tensors that it reads and writes, its memory, its
arguments.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ...core.leaves import with_values
from ...core.one_thread import threads
from ...nodal.model import Model
from ..compiler.team import in_threads
from .cells import Cells
from .interaction_sorts import INTERACTIONS
from .kinds import Kinds
from .layout import counts
from .native import NativeProgram
from .sorts import ELEMENT, NODE
from .tables import LISTS, Tables
from .transfers import ENTRY

CPU = torch.device("cpu")  # whatever the default device is
# samples times elements times steps that are worth a thread of their own (about a millisecond)
WORK = 4096


class Field(NamedTuple):
    """A tensor that stands for a field of a record: `axes` of its own, of which the first are the
    record's rows, if it has any; before them the samples', and before these, where it has more, one
    of steps. flat: the samples' axes are one; every: so many steps have one place, that is the last
    one's.
    """

    record: str
    name: str
    value: Tensor
    axes: int
    flat: bool = False
    every: int = 1


class Output(NamedTuple):
    """A field that is written, see `Field`, of so many numbers of its own; steps: each its own."""

    record: str
    name: str
    shape: Sequence[int]
    steps: bool = False
    every: int = 1


class ProgramInstance:
    """A model with nodes and elements of these kinds in the memory of a program, or, cell by cell,
    a lane each, one of its cells. free (N+1, w) bool: what supports leave of the nodes.
    """

    def __init__(
        self, program: NativeProgram, model: Model, kinds: Kinds, cells: Cells | None = None
    ) -> None:
        self.program, self.dtype, self.cells = program, model.length.dtype, cells
        self.free = model.constraints.moving
        topology, self.supports = model.topology, model.constraints.nodes
        if cells is not None:
            (topology, self.supports, *_), kinds = cells.connectivity, cells.kinds
        self.N = topology.element_count
        records, order, nodes = program.layout.records, program.order, range(topology.node_count)
        tables = Tables.of(model, cells)
        self.counts = counts(order, len(nodes), self.N, len(self.supports), **tables.rows)
        bases, self.size = program.layout.bases(self.counts)
        self.base = dict(zip(records, bases, strict=True))
        support_of = [self.supports.index(j) if j in self.supports else -1 for j in nodes]
        ends = {*topology.ends}
        near = [
            int(any(i in self.supports for i in (j - order, j, j + order) if j in ends or i == j))
            for j in nodes
        ]
        numbered = {
            name: [there.index(kind) for kind in rows]
            for name, there, rows in zip(
                (sort.kinds for sort in (NODE, ELEMENT, *INTERACTIONS)),
                (*program.kinds[:2], *program.kinds.between),
                (*kinds[:2], *kinds.between),
                strict=True,
            )
        }
        lists = {"bases": bases, "held": near, "support_of": support_of, **numbered, **tables.lists}
        lists["support_nodes"] = [*self.supports, 0]
        self.lists = {name: _integers(lists[name], [0]) for name in LISTS}
        self.numbers = {"nodes": len(nodes), **tables.numbers}
        self._blocks: dict[int, list[Tensor]] = {}  # of memory that no call uses, by lanes

    def has(self, record: str, name: str) -> bool:
        return name in self.program.layout.fields(record)

    def rows(self, record: str) -> int:
        """How many there are."""
        return self.counts[self.program.layout.records[record].rows]

    def lanes(self, samples: int) -> int:
        """As this processor has them; one for a sample alone, or as many as it has cells."""
        if self.cells is None:
            return 1 if samples == 1 else self.program.lanes()
        count = self.cells.count * max(1, min(samples, self.program.lanes() // self.cells.count))
        return 1 << (count - 1).bit_length()

    def pays(self, samples: int) -> bool:
        """Whether its cells take fewer registers than one after the other, a sample a lane."""
        lanes, width = self.lanes(samples), self.program.lanes()
        groups = -(-samples // (lanes // self.lanes_each))
        return groups * max(1, lanes // width) < self.lanes_each * -(-samples // width)

    @property
    def lanes_each(self) -> int:
        """Of a sample."""
        return 1 if self.cells is None else self.cells.count

    def segments(self, record: str) -> list[tuple[int, int, int, int]]:
        """Rows of a record that follow each other: the first, how many; which the first one is in
        the tensors' rows, and how far that of the next cell is.
        """
        count = self.rows(record)
        sort = self.program.layout.records[record].rows
        if self.cells is None or sort not in self.cells.rows:
            return [(0, count, 0, 0)]
        segments: list[list[int]] = []
        for k, (there, cell) in enumerate(self.cells.rows[sort]):
            if segments and segments[-1][3] == cell and segments[-1][2] + segments[-1][1] == there:
                segments[-1][1] += 1
            else:
                segments.append([k, 1, there, cell])
        return [tuple(segment) for segment in segments]

    def taken(self, lanes: int) -> Tensor:
        """A block of memory, to be given back after the call."""
        try:
            return self._blocks.setdefault(lanes, []).pop()
        except IndexError:
            return torch.zeros(self.size * lanes, dtype=self.dtype, device=CPU)

    def given_back(self, lanes: int, block: Tensor) -> None:
        self._blocks[lanes].append(block)


class TransferTable:
    """Where a program finds fields, or puts them: rows of integers, see `transfers.ENTRY`. Fields
    that the program does not have are left out. varying: how many of them, the first, are other
    tensors at each call, of the same shapes and strides; constants: how many of the next are told
    by `holding`.
    """

    def __init__(
        self,
        instance: ProgramInstance,
        fields: Sequence[Field],
        batch: torch.Size,
        varying: int,
        constants: int = 0,
    ) -> None:
        self.instance, self.batch = instance, batch
        self.held: list[Tensor] = []
        # of those that vary, and of constants: (which integer, which of these fields, itself where
        # it is copied, bytes from its first number)
        self.places: list[tuple[int, int, Field | None, int]] = []
        self.constants: list[tuple[int, int, Field | None, int]] = []
        rows: list[int] = []
        for k, field in enumerate(fields):
            if instance.has(field.record, field.name):
                x = self._fitted(field, field.value)
                if k < varying + constants:
                    copied = (
                        field._replace(value=None)
                        if x.data_ptr() != field.value.data_ptr()
                        else None
                    )
                    places, first = (self.places, 0) if k < varying else (self.constants, varying)
                    for n, offset in enumerate(self._offsets(field, x)):
                        places.append((len(rows) + n * len(ENTRY), k - first, copied, offset))
                else:
                    self.held.append(x)
                rows += self._rows(field, x)
        self.count, self.rows = len(rows) // len(ENTRY), _integers(rows)

    def holding(self, constants: Sequence[Tensor]) -> TransferTable:
        """This table with these constants."""
        rows, held = _copied(self.rows), [*self.held, *constants]
        self._fill(self.constants, rows, constants, held)
        return with_values(self, rows=rows, held=held)

    def fill(self, rows: Any, values: Sequence[Tensor], held: list[Any]) -> None:
        """Write where the values of varying fields lie into a copy of `rows`; what has to last as
        long as the call is put into `held`.
        """
        self._fill(self.places, rows, values, held)

    def _fill(
        self,
        places: list[tuple[int, int, Field | None, int]],
        rows: Any,
        values: Sequence[Tensor],
        held: list[Any],
    ) -> None:
        for place, k, copied, offset in places:
            x = values[k]
            if copied is not None:
                x = self._fitted(copied, x)
                held.append(x)
            rows[place] = x.data_ptr() + offset

    def _fitted(self, field: Field, x: Tensor) -> Tensor:
        """The tensor as (steps, samples, rows, components), the components one after the other in
        memory.
        """
        x, record = x.detach(), self.instance.program.layout.records[field.record]
        components = record.fields[field.name][1]
        batch = torch.Size((self.batch.numel(),)) if field.flat else self.batch
        lead, tail = x.shape[: x.ndim - field.axes], x.shape[x.ndim - field.axes :]
        steps, lead = (lead[0], lead[1:]) if len(lead) > len(batch) else (1, lead)
        samples = lead.numel()
        if x.dtype != self.instance.dtype:
            x = x.to(self.instance.dtype)
        if 1 < samples < batch.numel():
            x, samples = x.reshape(steps, *lead, *tail).expand(steps, *batch, *tail), batch.numel()
        rows = tail.numel() // components
        if not rows and tail[0] == 1:  # all stations of all elements have it in common
            x = x.expand(*x.shape[: x.ndim - field.axes], self.instance.program.order, *tail[1:])
            rows = 1
        x = x.reshape(steps, samples, rows, components)
        return x.contiguous() if components > 1 and x.stride(-1) != 1 else x

    def _rows(self, field: Field, x: Tensor) -> list[int]:
        """Entries of a field, see `ProgramInstance.segments`."""
        instance, table = self.instance, []
        record = instance.program.layout.records[field.record]
        first, components = record.fields[field.name]
        step, sample, row = (
            0 if n == 1 else stride for n, stride in zip(x.shape[:3], x.stride()[:3], strict=True)
        )
        offsets = self._offsets(field, x)
        for offset, segment in zip(offsets, instance.segments(field.record), strict=True):
            begin, count, _, cell = segment
            table += [x.data_ptr() + offset, sample, step, field.every, row, count]
            place = instance.base[field.record] + first + begin * record.size
            table += [components, place, record.size, row * cell]
        return table

    def _offsets(self, field: Field, x: Tensor) -> list[int]:
        """Where the first number of each entry lies, in bytes from the tensor's first."""
        row = 0 if x.shape[2] == 1 else x.stride(2)
        segments = self.instance.segments(field.record)
        return [first * row * x.element_size() for _, _, first, _ in segments]


class Arguments(NamedTuple):
    """Of the native function, and the rows of its tables: of one call at a time."""

    numbers: Any
    tables: dict[str, Any]


class Call:
    """K steps of a batch of samples; lanes: None = as this processor has them. It may be run any
    number of times, also at once by several threads, with tensors of the shapes and strides of
    these `inputs`, which are told by `run`, and `constants`, which are told by `holding`; fixed:
    those that stay.
    """

    def __init__(
        self,
        instance: ProgramInstance,
        batch: torch.Size,
        K: int,
        inputs: Sequence[Field],
        outputs: Sequence[Output],
        constants: Sequence[Field] = (),
        fixed: Sequence[Field] = (),
        lanes: int | None = None,
    ) -> None:
        self.instance, self.batch, self.K, self.B = instance, batch, K, batch.numel()
        self.lanes = lanes or instance.lanes(self.B)
        self.groups = -(-self.B // (self.lanes // instance.lanes_each))
        self.place = {name: k for k, name in enumerate(instance.program.driver.ARGS)}
        self._arguments: list[Arguments] = []  # that no call uses
        # what is written of each step, where that has a table of its own
        steps = "stepwises" in self.place
        self._table = ["stepwises" if steps and out.steps else "outputs" for out in outputs]
        shapes = [(*(K,) * out.steps, self.B, *out.shape) for out in outputs]
        self.templates = [like(shape, instance.dtype) for shape in shapes]
        written = {"outputs": [], "stepwises": []} if steps else {"outputs": []}
        for table, shape, out in zip(self._table, shapes, outputs, strict=True):
            x = torch.empty(shape, dtype=instance.dtype, device=CPU)
            field = Field(out.record, out.name, x, len(out.shape), flat=True, every=out.every)
            written[table].append(field)
        fields = [*inputs, *constants, *fixed, *fixed_fields(instance)]
        self.tables = {
            "inputs": TransferTable(instance, fields, batch, len(inputs), len(constants)),
            **{k: TransferTable(instance, x, batch, len(x)) for k, x in written.items()},
        }
        numbers = {
            "samples": self.B,
            "steps": self.K,
            "elements": self.instance.N,
            "supports": len(self.instance.supports),
            "end_group": self.groups,
            **self.instance.numbers,
            **{name: ctypes.addressof(x) for name, x in self.instance.lists.items()},
            **{f"{name[:-1]}_count": table.count for name, table in self.tables.items()},
        }
        self._numbers = _integers(numbers.get(name, 0) for name in self.place)

    def holding(self, constants: Sequence[Field]) -> Call:
        """This call with these constants."""
        table = self.tables["inputs"].holding([field.value for field in constants])
        return with_values(self, tables=self.tables | {"inputs": table}, _arguments=[])

    def run(
        self, inputs: Sequence[Tensor], outputs: Sequence[Tensor] | None = None, limit: int = 0
    ) -> Sequence[Tensor]:
        """The outputs, each (B, ...), or (K, B, ...); None = new ones."""
        outputs = empty_like(self.templates) if outputs is None else outputs
        values: dict[str, list[Tensor]] = {name: [] for name in self.tables}
        values["inputs"] += inputs
        for table, x in zip(self._table, outputs, strict=True):
            values[table].append(x)
        try:
            arguments = self._arguments.pop()
        except IndexError:
            arguments = self._new_arguments()
        numbers, place = arguments.numbers, self.place
        held: list[Any] = [arguments, values]
        for name, tensors in values.items():
            self.tables[name].fill(arguments.tables[name], tensors, held)
        if "limit" in place:
            numbers[place["limit"]] = limit
        run = self.instance.program.run(self.lanes, self.instance.lanes_each)
        parts = min(threads(), self.groups, self.B * max(self.instance.N, 1) * self.K // WORK)
        if parts < 2:
            block = self.instance.taken(self.lanes)
            numbers[place["memory"]] = block.data_ptr()
            run(numbers)
            self.instance.given_back(self.lanes, block)
        else:
            self._parts(run, numbers, parts, held)
        self._arguments.append(arguments)
        return outputs

    def _new_arguments(self) -> Arguments:
        tables = {name: _copied(table.rows) for name, table in self.tables.items()}
        numbers = _copied(self._numbers)
        for name, rows in tables.items():
            numbers[self.place[name]] = ctypes.addressof(rows)
        return Arguments(numbers, tables)

    def _parts(self, run: Callable[[Any], None], numbers: Any, threads: int, held: Any) -> None:
        """Some groups of the samples by each of so many threads."""
        ends = [self.groups * k // threads for k in range(threads + 1)]
        parts, blocks = [], [self.instance.taken(self.lanes) for _ in range(threads)]
        for block, (first, end) in zip(blocks, pairwise(ends), strict=True):
            part = _copied(numbers)
            part[self.place["first_group"]], part[self.place["end_group"]] = first, end
            part[self.place["memory"]] = block.data_ptr()
            parts.append(part)
        in_threads(run, parts, (held, blocks))
        for block in blocks:
            self.instance.given_back(self.lanes, block)


def fixed_fields(instance: ProgramInstance) -> list[Field]:
    """What supports leave free, and what bordered runs start from: minus the identity."""
    eye = torch.eye(instance.free.shape[-1], dtype=instance.dtype, device=CPU)
    return [Field("free", "free", instance.free, 2), Field("edge", "start", -eye, 2)]


def like(shape: Sequence[int], dtype: torch.dtype) -> Tensor:
    """A tensor of this shape that takes no memory, for `empty_like`."""
    return torch.empty((), dtype=dtype, device=CPU).expand(shape)


def empty_like(tensors: Iterable[Tensor]) -> list[Tensor]:
    """Memory for tensors of the same shapes, in a third of the time that it takes by shape and
    dtype.
    """
    return [torch.empty_like(x, memory_format=torch.contiguous_format) for x in tensors]


def _copied(array: Any) -> Any:
    return type(array).from_buffer_copy(array)


def _integers(*values: Iterable[int] | np.ndarray) -> Any:
    """One after the other."""
    parts = (x if isinstance(x, np.ndarray) else np.array([*x], np.int64) for x in values)
    array = np.concatenate([*parts])
    return (ctypes.c_int64 * len(array)).from_buffer(array)
