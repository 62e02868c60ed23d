"""LLVM's language for functions: straight code for W samples at once, a lane each.

    void NAME(ptr input 0, ..., ptr output 0, ...)
    fields in the order of `Function.inputs` and `.outputs`

A field lies in memory as [component][lane], float64 or float32, aligned to its numbers; what is
written overlaps nothing else. Truth values are 0 and 1 there. W = 1 is plain scalars. Products may
be fused, reciprocals taken and signs of zeros lost (contract, arcp, nsz); NaN and inf are kept, and
no sum is reordered: x - x is the test for both. Elementary functions are those of `elementary`, in
float64 whatever the lanes are. A pick from numbers that lie equally far apart in an input loads the
one of each lane. Numbers are computed in an order by which few of them wait in registers at a time.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch

from .elementary import RULES, elementary
from .function import Function
from .graph import Graph


class Store(NamedTuple):
    """A node that is written to a component of an output."""

    field: str
    component: int
    node: int


def schedule(function: Function) -> Iterator[int | Store]:
    """Nodes, each behind those that it reads, and stores, each right behind what it writes: that
    output first for which the fewest nodes are wanting; depth first, the argument first that needs
    more registers (Sethi and Ullman 1970). Constants are left out.
    """
    graph, registers, needed = function.graph, {}, {}
    for node in function.live():
        if graph.ops[node] != "const":
            needs = sorted(
                (registers[x] for x in set(read(graph, node)) if x in registers), reverse=True
            )
            # a bit for each node that it depends on
            needed[node] = (graph.ops[node] != "input") << len(registers)
            registers[node] = max((n + k for k, n in enumerate(needs)), default=1)
            for x in read(graph, node):
                needed[node] |= needed.get(x, 0)
    stores = [
        Store(field, k, node)
        for field, out in function.outputs.items()
        for k, node in enumerate(out.nodes)
    ]
    wanting = _bits([needed.get(store.node, 0) for store in stores], len(registers))
    waiting, done = np.ones(len(stores), bool), set()
    for _ in stores:
        counts = np.bitwise_count(wanting).sum(-1, dtype=np.int64)
        first = np.where(waiting, counts, len(registers) + 1).argmin()
        store, waiting[first] = stores[first], False
        wanting &= ~wanting[first]
        todo = [(store.node, False)]
        while todo:
            node, ready = todo.pop()
            if ready:
                yield node
            elif node in registers and node not in done:
                done.add(node)
                todo.append((node, True))
                todo.extend(
                    (x, False) for x in sorted(read(graph, node), key=lambda x: registers.get(x, 0))
                )
        yield store


class Table(NamedTuple):
    """Numbers of a pick that lie equally far apart in an input, by components."""

    field: str
    first: int
    distance: int


def table(graph: Graph, node: int) -> Table | None:
    """That of a pick; None where its numbers do not lie so."""
    if graph.ops[node] != "pick":
        return None
    xs = graph.args[node][1:]
    if any(graph.ops[x] != "input" for x in xs):
        return None
    places = [graph.values[x] for x in xs]
    (field, first), (_, second) = places[:2]
    evenly = [(field, first + k * (second - first)) for k in range(len(xs))]
    return Table(field, first, second - first) if places == evenly else None


def read(graph: Graph, node: int) -> tuple[int, ...]:
    """The nodes whose values it needs: of a pick from a table the place alone."""
    args = graph.args[node]
    return args if table(graph, node) is None else args[:1]


def _bits(rows: list[int], count: int) -> np.ndarray:
    """uint64 (rows, words) of numbers of `count` bits."""
    size = 8 * (count // 64 + 1)
    return (
        np.frombuffer(b"".join(row.to_bytes(size, "little") for row in rows), np.uint64)
        .reshape(len(rows), size // 8)
        .copy()
    )


FLAGS = "contract nsz arcp"
BINARY = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
COMPARED = {"lt": "olt", "le": "ole", "eq": "oeq"}
INTRINSICS = {"sqrt": "sqrt", "norm": "sqrt", "abs": "fabs", "floor": "floor", "round": "rint"}


class Lanes:
    """W lanes of a dtype: the names of their types, and constants."""

    def __init__(self, count: int, dtype: torch.dtype) -> None:
        if dtype not in (torch.float64, torch.float32):
            raise ValueError(f"{dtype} was given; float64 or float32 is wanted")
        self.count, self.dtype = count, dtype
        self.scalar, self.bytes = ("double", 8) if dtype == torch.float64 else ("float", 4)
        self.vector, self.truth = self.of(self.scalar), self.of("i1")
        self.suffix = (f"v{count}" if count > 1 else "") + f"f{8 * self.bytes}"

    def of(self, scalar: str) -> str:
        return f"<{self.count} x {scalar}>" if self.count > 1 else scalar

    def all(self, scalar: str, value: str) -> str:
        """A constant with the same value in each lane."""
        return (
            "<" + ", ".join([f"{scalar} {value}"] * self.count) + ">" if self.count > 1 else value
        )

    def constant(self, value: float | bool) -> str:
        if isinstance(value, bool):
            return self.all("i1", "true" if value else "false")
        if self.bytes == 4:
            value = torch.tensor(value, dtype=torch.float64).float().item()
        return self.all(self.scalar, f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}")


class Module:
    """Text of one module: functions by `define`, and what they call. `added` takes any other
    definitions as they are.
    """

    def __init__(self, lanes: int, dtype: torch.dtype = torch.float64) -> None:
        self.lanes = Lanes(lanes, dtype)
        self.added: list[str] = []
        self._definitions: dict[str, str] = {}
        self._declarations: dict[str, str] = {}

    def define(self, name: str, function: Function, inline: bool = False) -> None:
        """A function, as above; `inline`: written into those that call it. Raises ValueError for a
        second one of that name.
        """
        if name in self._definitions:
            raise ValueError(f"a second function {name!r} was given; another name is wanted")
        lanes, graph = self.lanes, function.graph
        inputs = {field: f"%in{k}" for k, field in enumerate(function.inputs)}
        outputs = {field: f"%out{k}" for k, field in enumerate(function.outputs)}
        body = _Body(self, lanes, function, inputs)
        for step in schedule(function):
            if isinstance(step, Store):
                value, at = body.name(step.node), body.place(outputs[step.field], step.component)
                if graph.truths[step.node]:
                    value = body.new(f"uitofp {lanes.truth} {value} to {lanes.vector}")
                body.line(f"store {lanes.vector} {value}, ptr {at}, align {lanes.bytes}")
            elif graph.ops[step] == "input":
                field, k = graph.values[step]
                at = body.place(inputs[field], k)
                body.line(f"%n{step} = load {lanes.vector}, ptr {at}, align {lanes.bytes}")
            else:
                body.operation(step)
        arguments = [f"ptr noalias readonly {name}" for name in inputs.values()]
        arguments += [f"ptr noalias writeonly {name}" for name in outputs.values()]
        linkage, how = ("internal ", "always") if inline else ("", "no")
        head = f'define {linkage}void @"{name}"({", ".join(arguments)}) {how}inline nounwind {{'
        self._definitions[name] = "\n".join((head, *body.lines, "  ret void", "}"))

    def elementary(self, name: str) -> str:
        """The name of an elementary function of float64 lanes."""
        lanes = Lanes(self.lanes.count, torch.float64)
        called = f"torchbeam.{name}"
        if called not in self._definitions:
            function = elementary(name)
            body = _Body(self, lanes, function)
            for node in function.live():
                if function.graph.ops[node] == "input":
                    body.names[node] = f"%{function.graph.values[node][0]}"
                else:
                    body.operation(node)
            (out,) = function.outputs["out"].nodes
            names = ", ".join(f"{lanes.vector} %{field}" for field in function.inputs)
            self._definitions[called] = "\n".join(
                (
                    f'define internal {lanes.vector} @"{called}"({names}) alwaysinline nounwind {{',
                    *body.lines,
                    f"  ret {lanes.vector} {body.name(out)}",
                    "}",
                )
            )
        return f'@"{called}"'

    def intrinsic(self, name: str, lanes: Lanes) -> str:
        called = f"@llvm.{name}.{lanes.suffix}"
        self._declarations[called] = f"declare {lanes.vector} {called}({lanes.vector})"
        return called

    def gather(self) -> str:
        lanes, pointers = self.lanes, self.lanes.of("ptr")
        called = f"@llvm.masked.gather.{lanes.suffix}.v{lanes.count}p0"
        self._declarations[called] = (
            f"declare {lanes.vector} {called}({pointers}, i32, {lanes.truth}, {lanes.vector})"
        )
        return called

    def text(self) -> str:
        return (
            "\n\n".join((*self._declarations.values(), *self._definitions.values(), *self.added))
            + "\n"
        )


class _Body:
    """Lines of a function: one value a node, called %n and its number."""

    def __init__(
        self, module: Module, lanes: Lanes, function: Function, inputs: dict[str, str] | None = None
    ) -> None:
        """inputs: pointers by field."""
        self.module, self.lanes, self.graph = module, lanes, function.graph
        self.inputs, self.offsets = inputs, {}
        self.lines: list[str] = []
        self.names: dict[int, str] = {}
        self.count = 0

    def line(self, text: str) -> None:
        self.lines.append("  " + text)

    def new(self, text: str) -> str:
        """A value beside the nodes."""
        self.count += 1
        self.line(f"%t{self.count} = {text}")
        return f"%t{self.count}"

    def name(self, node: int) -> str:
        if self.graph.ops[node] == "const":
            return self.lanes.constant(self.graph.values[node])
        return self.names.get(node, f"%n{node}")

    def place(self, pointer: str, component: int) -> str:
        """Where a component of a field lies."""
        if not component:
            return pointer
        return self.new(
            f"getelementptr inbounds i8, ptr {pointer}, i64 "
            f"{component * self.lanes.count * self.lanes.bytes}"
        )

    def operation(self, node: int) -> None:
        op, lanes = self.graph.ops[node], self.lanes
        if op == "const":
            return
        if op == "stop":
            self.names[node] = self.name(self.graph.args[node][0])
            return
        vector, args = lanes.vector, [self.name(x) for x in read(self.graph, node)]
        if op in BINARY:
            text = f"{BINARY[op]} {FLAGS} {vector} {args[0]}, {args[1]}"
        elif op == "neg":
            text = f"fneg {FLAGS} {vector} {args[0]}"
        elif op in COMPARED:
            text = f"fcmp {COMPARED[op]} {vector} {args[0]}, {args[1]}"
        elif op in ("and", "or"):
            text = f"{op} {lanes.truth} {args[0]}, {args[1]}"
        elif op == "not":
            text = f"xor {lanes.truth} {args[0]}, {lanes.constant(True)}"
        elif op == "select":
            kind = lanes.truth if self.graph.truths[node] else vector
            text = f"select {lanes.truth} {args[0]}, {kind} {args[1]}, {kind} {args[2]}"
        elif op in INTRINSICS:
            text = (
                f"call {FLAGS} {vector} "
                f"{self.module.intrinsic(INTRINSICS[op], lanes)}({vector} {args[0]})"
            )
        elif op in ("max", "min"):
            text = self._extreme("ogt" if op == "max" else "olt", args)
        elif op in RULES:
            text = self._elementary(op, args)
        elif op == "pick":
            numbers = table(self.graph, node)
            text = self._chosen(*args) if numbers is None else self._loaded(args[0], numbers)
        else:
            text = getattr(self, "_" + op)(args[0])
        self.line(f"%n{node} = {text}")

    def _extreme(self, compared: str, args: list[str]) -> str:
        """NaN wins: a is taken where it is the larger (smaller), or NaN."""
        vector, truth, best = self.lanes.vector, self.lanes.truth, args[0]
        for k, other in enumerate(args[1:]):
            beyond = self.new(f"fcmp {compared} {vector} {best}, {other}")
            no_number = self.new(f"fcmp uno {vector} {best}, {best}")
            text = (
                f"select {truth} {self.new(f'or {truth} {beyond}, {no_number}')}, {vector} "
                f"{best}, {vector} {other}"
            )
            best = self.new(text) if k < len(args) - 2 else best
        return text

    def _chosen(self, place: str, *numbers: str) -> str:
        """One of the numbers, by comparisons."""
        vector, truth, text = self.lanes.vector, self.lanes.truth, ""
        for k, number in reversed([*enumerate(numbers[:-1])]):
            other = self.new(text) if text else numbers[-1]
            here = self.new(f"fcmp oeq {vector} {place}, {self.lanes.constant(float(k))}")
            text = f"select {truth} {here}, {vector} {number}, {vector} {other}"
        return text

    def _loaded(self, place: str, numbers: Table) -> str:
        """One of the numbers, from where it lies."""
        lanes, pointers = self.lanes, self.lanes.of("ptr")
        base = self.place(self.inputs[numbers.field], numbers.first)
        offset = self._offset(place, numbers.distance)
        at = self.new(f"getelementptr i8, ptr {base}, {lanes.of('i64')} {offset}")
        if lanes.count == 1:
            return f"load {lanes.scalar}, ptr {at}, align {lanes.bytes}"
        return (
            f"call {lanes.vector} {self.module.gather()}({pointers} {at}, i32 {lanes.bytes}, "
            f"{lanes.truth} {lanes.constant(True)}, {lanes.vector} poison)"
        )

    def _offset(self, place: str, distance: int) -> str:
        """Bytes to a place of a table from its beginning, in each lane."""
        lanes, short = self.lanes, self.lanes.of("i32")  # AVX2 has no other whole numbers
        if (place, distance) not in self.offsets:
            whole = self.new(f"fptosi {lanes.vector} {place} to {short}")
            size = distance * lanes.count * lanes.bytes
            offset = self.new(f"mul {short} {whole}, {lanes.all('i32', str(size))}")
            if lanes.count > 1:
                own = ", ".join(f"i32 {lane * lanes.bytes}" for lane in range(lanes.count))
                offset = self.new(f"add {short} {offset}, <{own}>")
            self.offsets[place, distance] = self.new(f"sext {short} {offset} to {lanes.of('i64')}")
        return self.offsets[place, distance]

    def _elementary(self, op: str, args: list[str]) -> str:
        lanes, wide = self.lanes, self.lanes.of("double")
        if lanes.bytes == 4:
            args = [self.new(f"fpext {lanes.vector} {x} to {wide}") for x in args]
        call = f"call {wide} {self.module.elementary(op)}({', '.join(f'{wide} {x}' for x in args)})"
        return call if lanes.bytes == 8 else f"fptrunc {wide} {self.new(call)} to {lanes.vector}"

    # Parts of float64, by their bits

    def _bits(self, x: str) -> str:
        return self.new(f"bitcast {self.lanes.vector} {x} to {self.lanes.of('i64')}")

    def _exponent(self, x: str) -> str:
        lanes, long, short = self.lanes, self.lanes.of("i64"), self.lanes.of("i32")
        shifted = self.new(f"lshr {long} {self._bits(x)}, {lanes.all('i64', '52')}")
        held = self.new(
            f"and {short} {self.new(f'trunc {long} {shifted} to {short}')}, "
            f"{lanes.all('i32', '2047')}"
        )
        whole = self.new(f"sub {short} {held}, {lanes.all('i32', '1023')}")
        return f"sitofp {short} {whole} to {lanes.vector}"

    def _mantissa(self, x: str) -> str:
        lanes, long = self.lanes, self.lanes.of("i64")
        mantissa = self.new(f"and {long} {self._bits(x)}, {lanes.all('i64', str(2**52 - 1))}")
        return (
            f"bitcast {long} "
            f"{self.new(f'or {long} {mantissa}, ' + lanes.all('i64', str(1023 << 52)))} to "
            f"{lanes.vector}"
        )

    def _power2(self, k: str) -> str:
        """The last bits of a large number are k + 1023: shifted to the exponent's."""
        lanes, long = self.lanes, self.lanes.of("i64")
        large = self.new(f"fadd {lanes.vector} {k}, {lanes.constant(1.5 * 2.0**52 + 1023)}")
        return (
            f"bitcast {long} "
            f"{self.new(f'shl {long} {self._bits(large)}, ' + lanes.all('i64', '52'))} to "
            f"{lanes.vector}"
        )
