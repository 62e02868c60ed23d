"""Native code for passes over a chain: where the fields of records lie, calls of functions, masks,
transfers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

from ..compiler.denormals import flushing
from ..compiler.function import Function
from ..compiler.llvm import Module
from ..compiler.loop_text import Code
from ..compiler.shared_ends import END
from .conserving_functions import ENERGIES
from .layout import BETWEEN, INNER, Layout
from .node_kinds import SIDES, Kinds
from .transfers import Transfers

POINTERS = ("memory", "bases", "kinds", "element_kinds", "held", "support_of", "support_nodes")


class ChainCode:
    """Text of `run(ptr args)`, with 64-bit integers and pointers in the order of `ARGS`, for
    functions by name; those of kinds of nodes, or of elements, end with the number of the kind.
    """

    ARGS: tuple[str, ...] = ()
    POINTERS = POINTERS  # those of them

    def __init__(
        self,
        module: Module,
        functions: dict[str, Function],
        layout: Layout,
        kinds: Kinds,
        held: bool,
        cells: int = 1,
    ) -> None:
        self.cells = cells  # lanes of a sample
        self.module, self.functions, self.layout, self.kinds, self.held = (
            module,
            functions,
            layout,
            kinds,
            held,
        )
        self.lanes, self.order = module.lanes, len(kinds.elements[0].ends) - 1
        self.bytes = self.lanes.count * self.lanes.bytes  # of a component
        self.code = Code("chain", ["ptr %args"])
        self.args: dict[str, str] = {}
        self.base: dict[str, str] = {}

    def text(self) -> str:
        """Definitions of `run` and of the small loops that it calls."""
        code = self.code
        for k, name in enumerate(self.ARGS):
            self.args[name] = code.load(code.at("%args", k))
        pointer = {
            name: code.new(f"inttoptr i64 {self.args[name]} to ptr") for name in self.POINTERS
        }
        self.args |= pointer
        self._nodes()
        for k, name in enumerate(self.layout.records):
            begin = code.mul(code.load(code.at(pointer["bases"], k)), self.bytes)
            self.base[name] = code.at(pointer["memory"], begin, "i8")
        with code.loop(self.args["first_group"], self.args["end_group"]) as group:
            self._group(code.mul(group, self.lanes.count // self.cells))
        chain = code.text().replace(") nounwind", ") noinline nounwind", 1)
        return "\n\n".join((*self._loops(), chain, flushing("run", "chain")))

    def _nodes(self) -> None:
        """How many nodes there are."""
        self.args["nodes"] = self.code.add(self._end(self.args["elements"]), 1)

    def _group(self, first: str) -> None:
        """All steps of the samples from the first of a group on."""
        raise NotImplementedError

    # Where fields lie

    def at(self, record: str, index: str | int = 0, field: str | None = None) -> str:
        """Pointer to a field of a record's row."""
        layout_record = self.layout.records[record]
        first = 0 if field is None else layout_record.place(field)
        if isinstance(index, int):
            return self.code.at(
                self.base[record], (index * layout_record.size + first) * self.bytes, "i8"
            )
        begin = self.code.mul(index, layout_record.size * self.bytes)
        return self.code.at(self.code.at(self.base[record], begin, "i8"), first * self.bytes, "i8")

    def _call(self, name: str, where: Callable[[str], str]) -> None:
        function = self.functions[name]
        self.code.call(
            name,
            *(
                where(field)
                for field in (*function.inputs, *(f"> {field}" for field in function.outputs))
            ),
        )

    def _of_node(self, field: str, j: str) -> str:
        """A field that is held at a node, or by its support, or by all."""
        for record in ("node", "state", "unknown"):
            if field in self.layout.fields(record):
                return self.at(record, j, field)
        if self.held and field in self.layout.fields("support"):
            return self.at("support", self._support_of(j), field)
        return self.at("common", 0, field)

    def _of_element(self, field: str, e: str) -> str:
        """A field that is held by element e, or at one of its nodes, or by all."""
        side, _, name = field.partition(".")
        if side in SIDES[self.order]:
            return (
                self.at("at_end", self._turn(e, side))
                if name == END
                else self._of_node(name, self._node_of(e, side))
            )
        for record in ("element", "stress", "law", "element_state"):
            if field in self.layout.fields(record):
                return self.at(record, e, field)
        return self.at("common", 0, field)

    def _support_of(self, j: str) -> str:
        """Which support is that of node j; -1 where it has none."""
        return self.code.load(self.code.at(self.args["support_of"], j))

    def _end(self, v: str) -> str:
        """Node v of those that elements end at."""
        return v if self.order == 1 else self.code.mul(v, self.order)

    def _node_of(self, e: str, side: str) -> str:
        """The node of element e that is called so."""
        k, first = SIDES[self.order].index(side), self._end(e)
        return self.code.add(first, k) if k else first

    def _turn(self, e: str, side: str) -> str | int:
        """Which of the records that take turns belongs to that node."""
        return self._odd(e if side == "i" else self.code.add(e, 1)) if side in SIDES[1] else 2

    def _between(self, e: str) -> str:
        """Which of the records of what elements leave is that of element e."""
        return self._odd(e)

    def _move_of(self, node: str, ahead: int = 0) -> str:
        """Which of the nodes' moves is that of a node, or of one so far ahead; on either side of
        the chain some do not move.
        """
        return self.code.add(node, self.order + ahead)

    def _reach(self, node: str) -> str | int:
        """How far it is to the nodes that a node's row has blocks of: of a midside node its
        element's ends.
        """
        return 1 if self.order == 1 else self.code.sub(2, self._odd(node))

    def _near(self, v: str) -> dict[str, str]:
        """What is free of the end before, of end v and of the next, where there are any."""
        code = self.code
        before = code.choose(code.compare("eq", v, 0), 0, code.sub(v, 1))
        after = code.choose(code.compare("eq", v, self.args["elements"]), v, code.add(v, 1))
        return {
            f"free_{name}": self.at("free", self._end(at), "free")
            for name, at in (("before", before), ("here", v), ("after", after))
        }

    def _row_before(self, field: str, v: str) -> str:
        """ahead or y of the row before; zeros in front of the first."""
        code = self.code
        first = code.compare("eq", v, 0)
        at = self.at("row", code.choose(first, v, code.sub(v, 1)), field)
        return code.choose(first, self.at("nothing"), at, "ptr")

    def _sides(self, v: str) -> tuple[str, str, str]:
        """Whether end v is the last; what the elements before and behind it leave, zeros where
        there is none.
        """
        code = self.code
        last, odd = code.compare("eq", v, self.args["elements"]), self._odd(v)
        nothing = self.at("nothing")
        left = code.choose(
            code.compare("eq", v, 0), nothing, self.at("between", code.sub(1, odd)), "ptr"
        )
        return last, left, code.choose(last, nothing, self.at("between", odd), "ptr")

    def _odd(self, v: str) -> str:
        """Which of two records that take turns is that of end v."""
        return self.code.new(f"and i64 {v}, 1")

    def _over_cells(self, how: str, to: str, size: str | int = 1) -> None:
        """The "sum", the "largest" or the "least" of numbers over the cells of a sample, in each of
        its lanes: of a chain there is one.
        """

    # Pieces

    def _call_held(
        self,
        name: str,
        j: str,
        where: Callable[[str], str],
        after: Callable[[], None] = lambda: None,
    ) -> None:
        """A function of node j; where supports hold nodes, "held" in front of its name, and what
        comes `after` it at those.
        """
        if not self.held:
            self._call(name, where)
            return
        code = self.code
        held = code.compare("ne", code.load(code.at(self.args["held"], j)), 0)
        with code.when(code.new(f"xor i1 {held}, true")):
            self._call(name, where)
        with code.when(held):
            self._call(f"held {name}", where)
            after()

    def _restore(self, record: str, then: Callable[[str], None] = lambda node: None) -> None:
        """Moves of midside nodes, if there are any, from what a record has for their elements'
        ends; `then`: what is to be done with each.
        """
        if self.order == 1:
            return
        with self.code.loop(0, self.args["elements"]) as e:
            node = self._node_of(e, "m")
            places = {
                "before": (record, self._move_of(node, -1)),
                "after": (record, self._move_of(node, 1)),
                "> move": ("move", self._move_of(node)),
            }
            self._call("restore", lambda f: self.at(*places.get(f, ("middle", e))))
            then(node)

    def _kind(self, j: str) -> AbstractContextManager[Iterator[int]]:
        """The kinds of nodes one after the other; what is written for each runs where node j is of
        it.
        """
        return self._each("kinds", len(self.kinds.nodes), j)

    def _element_kind(self, e: str) -> AbstractContextManager[Iterator[int]]:
        """The same of elements."""
        return self._each("element_kinds", len(self.kinds.elements), e)

    @contextmanager
    def _each(self, kinds: str, count: int, at: str) -> Iterator[Iterator[int]]:
        code = self.code
        kind = code.load(code.at(self.args[kinds], at))

        def each() -> Iterator[int]:
            for k in range(count):
                if count == 1:
                    yield k
                    continue
                with code.when(code.compare("eq", kind, k)):
                    yield k

        yield each()

    def _touching(self, k: int, e: str) -> Iterator[None]:
        """What is written in a round runs where loads between the nodes of element e, of kind k, do
        anything in one of the samples; no round, where there are none.
        """
        if f"far {k}" not in self.functions:
            return
        code, far = self.code, self.at("at_load", 0, "far")
        self._call(
            f"far {k}",
            lambda f: self.at("at_load", 0, f[2:]) if f[0] == ">" else self._of_element(f, e),
        )
        code.call("all", far, result := code.slot())
        with code.when(code.compare("eq", code.load(result), 0)):
            yield

    def _add_load(self, name: str, e: str, to: str) -> None:
        """Add what a function of the loads between the nodes of element e gives these to what the
        element itself gives them.
        """
        packed = BETWEEN if self.order == 1 else INNER
        self._call(
            name, lambda f: self.at("at_load", 0, f[2:]) if f[0] == ">" else self._of_element(f, e)
        )
        size = self.layout.fields("at_load")[packed][1]
        self._add(to, self.at("at_load", 0, packed), size)

    def _add_rise(self, name: str, e: str) -> None:
        """Add the energy that a function of such loads gives."""
        self._call(
            name, lambda f: self.at("change", 0, f[2:]) if f[0] == ">" else self._of_element(f, e)
        )
        if "energy" in self.layout.records:
            self._add(self.at("energy", 0, "rise"), self.at("change", 0, "rise"), 1)

    def _sized(self, name: str, size: str | int, *pointers: str) -> None:
        given = ", ".join(f"ptr {p}" for p in pointers)
        self.code.line(f'call void @"{name}"({given}, i64 {size})')

    def _fill(self, to: str, size: str | int) -> None:
        self._sized("zero", size, to)

    def _copy_to(self, to: str, source: str, size: int) -> None:
        self._sized("copy", size, to, source)

    def _blend(self, to: str, source: str, mask: str, size: int) -> None:
        """Take the source where the mask is 0."""
        self._sized("keep", size, to, source, mask)

    def _sum(self, to: str, source: str, mask: str, size: int) -> None:
        """Add the source where the mask is not 0."""
        self._sized("sum", size, to, source, mask)

    def _add(self, to: str, source: str, size: int) -> None:
        self._sized("add", size, to, source)

    def _take(self, to: str, source: str, mask: str, size: int) -> None:
        """Take the source where the mask is not 0."""
        self._sized("take", size, to, source, mask)

    def _add_energies(self) -> None:
        """Of a node, or of an element, to those of the sample."""
        for name in ENERGIES if "energy" in self.layout.records else ():
            self._add(self.at("energy", 0, name), self.at("change", 0, name), 1)

    def _transfer(
        self, name: str, table: str, first: str, step: str | int, begin: str | int = 0
    ) -> None:
        """`gather`, `scatter`, or `drain` (scatter, and leave zeros), as a table says, at a step of
        those that begin so.
        """
        pointer = self.code.new(f"inttoptr i64 {self.args[table + 's']} to ptr")
        self.code.line(
            f'call void @"{name}"(ptr {pointer}, i64 {self.args[table + "_count"]}, ptr '
            f"{self.args['memory']}, "
            f"i64 {first}, i64 {self.args['samples']}, i64 {step}, i64 {begin})"
        )

    def _loops(self) -> list[str]:
        """Small functions of lanes."""
        V, T, scalar, W = self.lanes.vector, self.lanes.truth, self.lanes.scalar, self.lanes.count
        size = self.lanes.bytes
        zero, one, align = self.lanes.constant(0.0), self.lanes.constant(1.0), f"align {size}"
        load = "{0} = load " + V + ", ptr {1}, " + align
        # else what is chosen becomes a masked store, which is slow
        volatile = load.replace("load", "load volatile")

        def straight(name: str, given: str, *lines: str) -> str:
            return "\n".join(
                (
                    f'define internal void @"{name}"({given}) alwaysinline nounwind {{',
                    *("  " + x for x in lines),
                    "  ret void",
                    "}",
                )
            )

        def over(name: str, given: list[str], *lines: str) -> str:
            """A loop over components: %0, %1 ... point to those of the given pointers."""
            code = Code(name, [*(f"ptr %{p}" for p in given), "i64 %size"])
            with code.loop(0, "%size") as k:
                places = {p: code.at(f"%{p}", k, V) for p in ("to", "source") if p in given}
                for text in lines:
                    code.line(text.format(**places))
            return (
                code.text()
                .replace("define void", "define internal void")
                .replace(") nounwind", ") alwaysinline nounwind")
            )

        def chosen(name: str, compared: str) -> str:
            return over(
                name,
                ["to", "source", "mask"],
                load.format("%m", "%mask"),
                volatile.format("%a", "{to}"),
                load.format("%b", "{source}"),
                f"%c = fcmp {compared} {V} %m, {zero}",
                f"%r = select {T} %c, {V} %b, {V} %a",
                f"store {V} %r, ptr {{to}}, {align}",
            )

        def extreme(name: str, compared: str) -> str:
            return straight(
                name,
                "ptr %to, ptr %source",
                volatile.format("%a", "%to"),
                load.format("%b", "%source"),
                f"%c = fcmp {compared} {V} %a, %b",
                f"%n = fcmp uno {V} %a, %a",
                f"%d = or {T} %c, %n",
                f"%r = select {T} %d, {V} %a, {V} %b",
                f"store {V} %r, ptr %to, {align}",
            )

        each = Code("all", ["ptr %mask", "ptr %result"])
        left = each.slot()
        each.store(1, left)
        with each.loop(0, W) as lane:
            one_of = each.load(each.at("%mask", lane, scalar), scalar)
            each.store(
                each.choose(each.new(f"fcmp une {scalar} {one_of}, 0.0"), each.load(left), 0), left
            )
        each.store(each.load(left), "%result")
        # fmt: off
        return [
            over("zero", ["to"], f"store {V} {zero}, ptr {{to}}, {align}"),
            over("copy", ["to", "source"], load.format("%a", "{source}"),
                 f"store {V} %a, ptr {{to}}, {align}"),
            chosen("keep", "oeq"), chosen("take", "one"), extreme("largest", "ogt"),
            extreme("least", "olt"),
            straight("opposite", "ptr %to, ptr %source", load.format("%a", "%source"),
                     f"%r = fsub {V} {one}, %a",
                     f"store {V} %r, ptr %to, {align}"),
            over("sum", ["to", "source", "mask"], load.format("%m", "%mask"),
                 volatile.format("%a", "{to}"),
                 load.format("%b", "{source}"), f"%c = fcmp one {V} %m, {zero}",
                 f"%s = fadd {V} %a, %b",
                 f"%r = select {T} %c, {V} %s, {V} %a", f"store {V} %r, ptr {{to}}, {align}"),
            over("add", ["to", "source"], load.format("%a", "{to}"), load.format("%b", "{source}"),
                 f"%s = fadd {V} %a, %b", f"store {V} %s, ptr {{to}}, {align}"),
            each.text().replace("define void", "define internal void"),
            *Transfers(self.lanes, self.cells).functions()]
        # fmt: on
