"""Native driver of a step: for each group of samples, a lane each, Newton's method on a chain, step by step.

One iteration is one pass over the chain. Its rows are eliminated as they come: node j, the element behind it, then row j from
these and from what the element before has left (two records that take turns), so that no block of the matrix is kept. Back
substitution, and the updates of unknowns that are not over yet. Everything that is computed is in the functions of
`LocalFunctions`; here is only in which order, and where their fields lie.

    void run(ptr args)      64-bit integers and pointers in the order of `ARGS`

A table says what is taken from tensors, or written to them: rows of 64-bit integers in the order of `ENTRY`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ...solvers.compiled.function import Function
from ...solvers.compiled.llvm import Module
from ...solvers.compiled.split import HOISTED
from .code import Code
from .layout import Layout

ARGS = ("inputs", "input_count", "outputs", "output_count", "samples", "steps", "elements", "memory", "bases", "kinds", "held",
        "support_of", "support_nodes", "supports", "limit", "first_group", "end_group")
ENTRY = ("pointer", "sample", "step", "row", "rows", "components", "place", "row_size")  # strides and places in numbers
SUMS = ("force", "moment", "strain", "left_force", "left_moment", "left_strain")


class Driver:
    """Text of the driver for the functions of a program, by name (`node 0`, `finish 0` and so on for each kind of node)."""

    def __init__(self, module: Module, functions: dict[str, Function], layout: Layout, kinds: int, held: bool) -> None:
        self.module, self.functions, self.layout, self.kinds, self.held = module, functions, layout, kinds, held
        self.lanes = module.lanes
        self.bytes = self.lanes.count * self.lanes.bytes  # of a component
        self.code = Code("run", ["ptr %args"])
        self.args: dict[str, str] = {}
        self.base: dict[str, str] = {}

    def text(self) -> str:
        """Definitions of `run` and of the small loops that it calls."""
        code = self.code
        for k, name in enumerate(ARGS):
            self.args[name] = code.load(code.at("%args", k))
        pointer = {name: code.new(f"inttoptr i64 {self.args[name]} to ptr") for name in (
            "memory", "bases", "kinds", "held", "support_of", "support_nodes")}
        self.args |= pointer
        for k, name in enumerate(self.layout.records):
            begin = code.mul(code.load(code.at(pointer["bases"], k)), self.bytes)
            self.base[name] = code.at(pointer["memory"], begin, "i8")
        with code.loop(self.args["first_group"], self.args["end_group"]) as group:
            first = code.mul(group, self.lanes.count)
            with code.loop(0, self.args["steps"]) as step:
                self._transfer("gather", "input", first, step)
                self._step()
                self._transfer("scatter", "output", first, step)
        return "\n\n".join((*self._loops(), code.text()))

    # Where fields lie

    def at(self, record: str, index: str | int = 0, field: str | None = None) -> str:
        """Pointer to a field of a record's row."""
        one = self.layout.records[record]
        first = 0 if field is None else one.place(field)
        if isinstance(index, int):
            return self.code.at(self.base[record], (index * one.size + first) * self.bytes, "i8")
        begin = self.code.mul(index, one.size * self.bytes)
        return self.code.at(self.code.at(self.base[record], begin, "i8"), first * self.bytes, "i8")

    def _call(self, name: str, where: Callable[[str], str]) -> None:
        function = self.functions[name]
        self.code.call(name, *(where(field) for field in (*function.inputs, *(f"> {field}" for field in function.outputs))))

    def _of_node(self, field: str, j: str) -> str | None:
        """A field that is held at a node, or by all."""
        for record in ("node", "state", "unknown"):
            if field in self.layout.records[record].fields:
                return self.at(record, j, field)
        return self.at("common", 0, field) if field in self.layout.records["common"].fields else None

    # A step

    def _step(self) -> None:
        code, N = self.code, self.args["elements"]
        nodes = code.add(N, 1)
        with code.loop(0, nodes) as j:
            with self._kind(j) as kinds:
                for k in kinds:
                    self._call(f"predictor {k}", lambda f: self.at("unknown", j, f[2:]) if f[0] == ">" else self._of_node(f, j))
                    self._call(f"before node {k}", lambda f: self.at("before node", j) if f[0] == ">" else self._of_node(f, j))
        with code.loop(0, N) as e:
            self._call("before element", lambda f: self._of_element(f, e))
            self._copy_to(self.at("stress", e), self.at("start_stress", e), self.layout.records["stress"].size)
        for name in ("over", "done"):
            code.call("opposite", self.at("sample", 0, name), self.at("sample", 0, "moving"))
        for name in ("before", "iterations"):
            self._fill(self.at("sample", 0, name), 1)
        self._fill(self.at("move", 0), self.layout.records["move"].size)
        self._fill(self.at("move", code.add(N, 2)), self.layout.records["move"].size)
        self._fill(self.at("nothing"), self.layout.records["nothing"].size)
        count = code.slot()
        code.store(0, count)
        with code.until() as ends:
            self._pass()
            self._back()
            self._judge()
            made = code.add(code.load(count), 1)
            code.store(made, count)
            code.call("all", self.at("sample", 0, "over"), result := code.slot())
            ends.append(code.new(f"or i1 {code.compare('sge', made, self.args['limit'])}, "
                                 f"{code.compare('ne', code.load(result), 0)}"))
        self._finish()

    def _pass(self) -> None:
        """Balance and elimination, from the first node to the last."""
        code, N = self.code, self.args["elements"]
        self._fill(self.at("sums"), len(SUMS))
        with code.loop(0, code.add(N, 1)) as j:
            with self._kind(j) as kinds:
                for k in kinds:
                    self._call(f"node {k}", lambda f: self.at("at_node", 0, f[2:]) if f[0] == ">" else
                               self.at("before node", j) if f == HOISTED else self._of_node(f, j))
            last = code.compare("eq", j, N)
            odd = code.new(f"and i64 {j}, 1")
            before, behind = self.at("left", odd), self.at("left", code.sub(1, odd))
            before = code.choose(code.compare("eq", j, 0), self.at("nothing"), before, "ptr")
            right = code.choose(last, self.at("nothing"), self.at("right"), "ptr")
            with code.when(code.new(f"xor i1 {last}, true")):
                self._call("element", lambda f: self._of_element(f, j, behind))
                for name in ("force", "moment", "strain", "left_strain"):
                    self._largest(name, "at_element")
            self._row(j, before, right)
            for name in ("force", "moment", "left_force", "left_moment"):
                self._largest(name, "at_row")

    def _of_element(self, field: str, j: str, behind: str = "") -> str:
        records = self.layout.records
        if field.removeprefix("> ") == HOISTED:
            return self.at("before element", j)
        if field[0] == ">":
            side, _, name = field[2:].partition(".")
            if side == "i" or field[2:] == "U":
                return self.at("right", 0, name or "U")
            if side == "j" or field[2:] == "L":
                return self.code.at(behind, records["left"].place(name or "L") * self.bytes, "i8")
            return self.at("strain_law", j, side) if side in ("gap", "E") else self.at("at_element", 0, side)
        side, _, name = field.partition(".")
        if side in ("i", "j"):
            return self._of_node(name, j if side == "i" else self.code.add(j, 1))
        for record in ("element", "stress"):
            if field in records[record].fields:
                return self.at(record, j, field)
        return self.at("common", 0, field)

    def _row(self, j: str, left: str, right: str) -> None:
        code, records = self.code, self.layout.records
        first = code.compare("eq", j, 0)

        def before(record: str) -> str:
            return code.choose(first, self.at("nothing"), self.at(record, code.sub(j, 1)), "ptr")

        def where(field: str) -> str:
            side, _, name = field.partition(".")
            if field[0] == ">":
                name = field[2:]
                return self.at("row", j, name) if name in ("ahead", "y") else self.at("at_row", 0, name)
            if side in ("left", "right"):
                return code.at(left if side == "left" else right, records[side].place(name) * self.bytes, "i8")
            if side == "own":
                return self.at("at_node", 0, name)
            if field in ("ahead", "y"):
                offset = records["row"].place(field) * self.bytes
                return code.choose(first, self.at("nothing"), code.at(before("row"), offset, "i8"), "ptr")
            index = {"free_before": code.choose(first, 0, code.sub(j, 1)), "free_here": j,
                     "free_after": code.choose(code.compare("eq", j, self.args["elements"]), j, code.add(j, 1))}[field]
            return self.at("free", index, "free")

        if not self.held:
            self._call("row", where)
            return
        held = code.compare("ne", code.load(code.at(self.args["held"], j)), 0)
        with code.when(code.new(f"xor i1 {held}, true")):
            self._call("row", where)
        with code.when(held):
            self._call("held row", where)
            support = code.load(code.at(self.args["support_of"], j))
            with code.when(code.compare("sge", support, 0)):
                for name in ("rows", "asked"):
                    self._copy_to(self.at("support", support, name), self.at("at_row", 0, name),
                                  records["support"].fields[name][1])

    def _back(self) -> None:
        """Moves from the last node to the first; those of node j stand in row j + 1, between two that do not move."""
        code, N = self.code, self.args["elements"]
        with code.loop(N, -1, -1) as j:
            places = {"next": code.add(j, 2), "> move": code.add(j, 1)}
            self._call("back", lambda f: self.at("move", places[f], "move") if f in places else self.at("row", j, f))
        over = self.at("sample", 0, "over")
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                node = code.load(code.at(self.args["support_nodes"], k))
                places = {"before": node, "here": code.add(node, 1), "after": code.add(node, 2)}

                def of_support(f: str, k: str = k, node: str = node, places: dict[str, str] = places) -> str:
                    if f in places:
                        return self.at("move", places[f], "move")
                    return self.at("free", node, "free") if f == "free" else self.at("support", k, f.removeprefix("> "))

                self._call("reaction", of_support)
                self._blend(self.at("support", k, "found"), self.at("support", k, "reaction"), over,
                            self.layout.records["support"].fields["reaction"][1])
        with code.loop(0, N) as e:
            moves = {"move_i": code.add(e, 1), "move_j": code.add(e, 2)}

            def of_law(f: str) -> str:
                if f in moves:
                    return self.at("move", moves[f], "move")
                if f[0] == ">":
                    return self.at("change", 0, "stress")
                for record in ("stress", "strain_law", "element"):
                    if f in self.layout.records[record].fields:
                        return self.at(record, e, f)
                return self.at("common", 0, f)

            self._call("stress", of_law)
            self._blend(self.at("stress", e), self.at("change", 0, "stress"), over, self.layout.records["stress"].size)
        with code.loop(0, code.add(N, 1)) as j:
            with self._kind(j) as kinds:
                for k in kinds:
                    self._call(f"update {k}", lambda f: self.at("change", 0, f[2:]) if f[0] == ">" else
                               self.at("move", code.add(j, 1), "move") if f == "move" else self._of_node(f, j))
            for name in ("u", "m"):
                self._blend(self.at("unknown", j, name), self.at("change", 0, name), over,
                            self.layout.records["unknown"].fields[name][1])

    def _judge(self) -> None:
        def where(f: str) -> str:
            if f[0] == ">":
                return self.at("judged", 0, f[2:])
            record = "sums" if f in SUMS else "sample" if f in self.layout.records["sample"].fields else "common"
            return self.at(record, 0, f)

        self._call("judge", where)
        for name in self.functions["judge"].outputs:
            self._copy_to(self.at("sample", 0, name), self.at("judged", 0, name), 1)

    def _finish(self) -> None:
        code, N, records = self.code, self.args["elements"], self.layout.records
        nodes = code.add(N, 1)
        cosine = self.at("sample", 0, "cosine")
        with code.loop(0, nodes) as j:
            self._call("cosine", lambda f: self.at("change", 0, "cosine") if f[0] == ">" else self.at("unknown", j, f))
            with code.when(code.compare("eq", j, 0)):
                self._copy_to(cosine, self.at("change", 0, "cosine"), 1)
            code.call("least", cosine, self.at("change", 0, "cosine"))
        places = {"before": "last_status", "> status": "found_status", "> moving": "good"}
        self._call("outcome", lambda f: self.at("common", 0, f) if f in records["common"].fields else
                   self.at("sample", 0, places.get(f, f)))
        for name, found in (("last_status", "found_status"), ("moving", "good")):
            self._copy_to(self.at("sample", 0, name), self.at("sample", 0, found), 1)
        good = self.at("sample", 0, "good")
        with code.loop(0, nodes) as j:
            with self._kind(j) as kinds:
                for k in kinds:
                    self._call(f"finish {k}", lambda f: self.at("change", 0, f[2:]) if f[0] == ">" else self._of_node(f, j))
            for name, (_, size) in records["state"].fields.items():
                self._take(self.at("state", j, name), self.at("change", 0, name), good, size)
            code.call("sum", self.at("sample", 0, "work"), self.at("change", 0, "work"), good)
        with code.loop(0, N) as e:
            self._take(self.at("start_stress", e), self.at("stress", e), good, records["stress"].size)
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                self._take(self.at("support", k, "last"), self.at("support", k, "found"), good,
                           records["support"].fields["last"][1])

    # Pieces

    @contextmanager
    def _kind(self, j: str) -> Iterator[Iterator[int]]:
        """The kinds of nodes one after the other; what is written for each runs where node j is of it."""
        code = self.code
        kind = code.load(code.at(self.args["kinds"], j))

        def each() -> Iterator[int]:
            for k in range(self.kinds):
                if self.kinds == 1:
                    yield k
                    continue
                with code.when(code.compare("eq", kind, k)):
                    yield k

        yield each()

    def _sized(self, name: str, size: int, *pointers: str) -> None:
        given = ", ".join(f"ptr {p}" for p in pointers)
        self.code.line(f'call void @"{name}"({given}, i64 {size})')

    def _fill(self, to: str, size: int) -> None:
        self._sized("zero", size, to)

    def _copy_to(self, to: str, source: str, size: int) -> None:
        self._sized("copy", size, to, source)

    def _blend(self, to: str, source: str, mask: str, size: int) -> None:
        """Take the source where the mask is 0."""
        self._sized("keep", size, to, source, mask)

    def _take(self, to: str, source: str, mask: str, size: int) -> None:
        """Take the source where the mask is not 0."""
        self._sized("take", size, to, source, mask)

    def _largest(self, name: str, record: str) -> None:
        if name in self.layout.records[record].fields:
            self.code.call("largest", self.at("sums", 0, name), self.at(record, 0, name))

    def _transfer(self, name: str, table: str, first: str, step: str) -> None:
        pointer = self.code.new(f"inttoptr i64 {self.args[table + 's']} to ptr")
        self.code.line(f'call void @"{name}"(ptr {pointer}, i64 {self.args[table + "_count"]}, ptr {self.args["memory"]}, '
                       f'i64 {first}, i64 {self.args["samples"]}, i64 {step})')

    def _loops(self) -> list[str]:
        """Small functions of lanes."""
        V, T, scalar, W, size = self.lanes.vector, self.lanes.truth, self.lanes.scalar, self.lanes.count, self.lanes.bytes
        zero, one, align = self.lanes.constant(0.0), self.lanes.constant(1.0), f"align {size}"
        load = "{0} = load " + V + ", ptr {1}, " + align

        def straight(name: str, given: str, *lines: str) -> str:
            return "\n".join((f'define internal void @"{name}"({given}) alwaysinline nounwind {{', *("  " + x for x in lines),
                              "  ret void", "}"))

        def over(name: str, given: list[str], *lines: str) -> str:
            """A loop over components: %0, %1 ... point to those of the given pointers."""
            code = Code(name, [*(f"ptr %{p}" for p in given), "i64 %size"])
            with code.loop(0, "%size") as k:
                places = {p: code.at(f"%{p}", k, V) for p in ("to", "source") if p in given}
                for text in lines:
                    code.line(text.format(**places))
            return code.text().replace("define void", "define internal void").replace(") nounwind", ") alwaysinline nounwind")

        def chosen(name: str, compared: str) -> str:
            return over(name, ["to", "source", "mask"], load.format("%m", "%mask"), load.format("%a", "{to}"),
                        load.format("%b", "{source}"), f"%c = fcmp {compared} {V} %m, {zero}",
                        f"%r = select {T} %c, {V} %b, {V} %a", f"store {V} %r, ptr {{to}}, {align}")

        def extreme(name: str, compared: str) -> str:
            return straight(name, "ptr %to, ptr %source", load.format("%a", "%to"), load.format("%b", "%source"),
                            f"%c = fcmp {compared} {V} %a, %b", f"%n = fcmp uno {V} %a, %a", f"%d = or {T} %c, %n",
                            f"%r = select {T} %d, {V} %a, {V} %b", f"store {V} %r, ptr %to, {align}")

        each = Code("all", ["ptr %mask", "ptr %result"])
        left = each.slot()
        each.store(1, left)
        with each.loop(0, W) as lane:
            one_of = each.load(each.at("%mask", lane, scalar), scalar)
            each.store(each.choose(each.new(f"fcmp une {scalar} {one_of}, 0.0"), each.load(left), 0), left)
        each.store(each.load(left), "%result")
        return [
            over("zero", ["to"], f"store {V} {zero}, ptr {{to}}, {align}"),
            over("copy", ["to", "source"], load.format("%a", "{source}"), f"store {V} %a, ptr {{to}}, {align}"),
            chosen("keep", "oeq"), chosen("take", "one"), extreme("largest", "ogt"), extreme("least", "olt"),
            straight("opposite", "ptr %to, ptr %source", load.format("%a", "%source"), f"%r = fsub {V} {one}, %a",
                     f"store {V} %r, ptr %to, {align}"),
            straight("sum", "ptr %to, ptr %source, ptr %mask", load.format("%m", "%mask"), load.format("%a", "%to"),
                     load.format("%b", "%source"), f"%c = fcmp one {V} %m, {zero}", f"%s = fadd {V} %a, %b",
                     f"%r = select {T} %c, {V} %s, {V} %a", f"store {V} %r, ptr %to, {align}"),
            each.text().replace("define void", "define internal void"), self._moved("gather"), self._moved("scatter")]

    def _moved(self, name: str) -> str:
        """Numbers between tensors and memory, as a table says. What does not change from step to step is gathered at the first;
        lanes beyond the samples have the last one's numbers, and are not scattered.
        """
        code, scalar, W = Code(name, ["ptr %table", "i64 %count", "ptr %memory", "i64 %first", "i64 %samples", "i64 %step"]), \
            self.lanes.scalar, self.lanes.count
        with code.loop(0, "%count") as k:
            entry = code.at("%table", code.mul(k, len(ENTRY)))
            numbers = (code.load(code.at(entry, i)) for i in range(len(ENTRY)))
            pointer, sample, step, row, rows, components, place, size = numbers
            pointer = code.at(code.new(f"inttoptr i64 {pointer} to ptr"), code.mul(step, "%step"), scalar)
            fresh = code.new(f"or i1 {code.compare('eq', '%step', 0)}, {code.compare('ne', step, 0)}")
            with code.when(fresh), code.loop(0, rows) as r, code.loop(0, components) as c, code.loop(0, W) as lane:
                at = code.add("%first", lane)
                inside = code.compare("slt", at, "%samples")
                at = code.choose(inside, at, code.sub("%samples", 1))
                there = code.at(pointer, code.add(code.add(code.mul(at, sample), code.mul(r, row)), c), scalar)
                component = code.add(code.add(place, code.mul(r, size)), c)
                here = code.at("%memory", code.add(code.mul(component, W), lane), scalar)
                if name == "gather":
                    code.store(code.load(there, scalar), here, scalar)
                else:
                    with code.when(inside):
                        code.store(code.load(here, scalar), there, scalar)
        return code.text().replace("define void", "define internal void")
