"""Native loops over balls about points that move: by how much those of given pairs are apart, and
how long they stay so.

A ball is about a node, of half of the longer of its two links: `before` and `after` say which nodes
it is linked to, itself where there is none. Pairs come as runs, a node and all nodes from a first
one to before an end; of pairs of one kind balls may come as near as their `reach`.
"""

from __future__ import annotations

from collections.abc import Callable

from .llvm import FLAGS, Lanes, Module
from .loop_text import Code

RUN = 4  # integers of a run: node, first, end, kind
# of both functions; (S) of samples, (n) of nodes
ARGS = (
    "result",
    "samples",
    "nodes",
    "steps",
    "before",  # (n)
    "after",  # (n)
    "runs",  # where those of each sample begin, and how many there are: (S, 2); then all runs
    "reach",  # (S, kinds)
    "kinds",
    "scratch",  # (PLANES, n and one register more)
    "start",  # (S, n, 3)
    "moved",  # (steps, S, n, 3), or velocities (S, n, 3)
    "known",  # (S, n, 3), where `room` was found
    "room",  # (S), squares; negative, or NaN: none is known
)
PLANES = 7  # three of places, the balls' radii, three of velocities


class BallDistances:
    """Text of the functions

        within(ptr args)    result: of the steps from `start` to the places `moved` how many, from
                            the first on, surely leave all pairs apart, in all samples; -1 = they
                            are not apart at the start
        approach(ptr args)  result: the least time in which one of the pairs meets, from `start` on
                            with these velocities; inf = none does

    with ARGS in a row as 64-bit integers; the result of `approach` is a number of the dtype.

    Between two places in a step points move in straight lines. As no two balls come nearer to each
    other than two of the nodes do, pairs that have `room` where nodes are `known` have it until two
    nodes have moved by more towards each other; only then are they looked at again. What is known
    afterwards is left in `known` and `room`; of places that are no finite numbers nothing is.
    """

    def __init__(self, lanes: Lanes) -> None:
        self.lanes, self.one = lanes, Lanes(1, lanes.dtype)

    def text(self) -> str:
        module = Module(self.lanes.count, self.lanes.dtype)
        roots = [module.intrinsic("sqrt", lanes) for lanes in (self.lanes, self.one)]
        self.root, self.root_of_one = roots
        module.added += [self._spread(), self._copy(), self._least(False), self._least(True)]
        module.added += [self._within(), self._approach()]
        return module.text()

    # Pieces

    def _load(self, code: Code, pointer: str, at: str | int, lanes: Lanes | None = None) -> str:
        lanes = lanes or self.one
        place = code.at(pointer, at, self.one.scalar)
        return code.new(f"load {lanes.vector}, ptr {place}, align {lanes.bytes}")

    def _store(self, code: Code, value: str, pointer: str, at: str | int = 0) -> None:
        place = code.at(pointer, at, self.one.scalar)
        code.line(f"store {self.one.vector} {value}, ptr {place}, align {self.one.bytes}")

    def _make(self, code: Code, operation: str, a: str, b: str, lanes: Lanes) -> str:
        return code.new(f"{operation} {FLAGS} {lanes.vector} {a}, {b}")

    def _less(self, code: Code, a: str, b: str, lanes: Lanes) -> str:
        """The lesser; b where a is NaN."""
        truth = code.new(f"fcmp olt {lanes.vector} {a}, {b}")
        return code.new(f"select {lanes.truth} {truth}, {lanes.vector} {a}, {lanes.vector} {b}")

    def _more(self, code: Code, a: str, b: str, lanes: Lanes) -> str:
        """The larger; b where a is NaN."""
        truth = code.new(f"fcmp ogt {lanes.vector} {a}, {b}")
        return code.new(f"select {lanes.truth} {truth}, {lanes.vector} {a}, {lanes.vector} {b}")

    def _product(self, code: Code, a: list[str], b: list[str], lanes: Lanes) -> str:
        """Of two vectors."""
        first, *rest = (self._make(code, "fmul", x, y, lanes) for x, y in zip(a, b, strict=True))
        for part in rest:
            first = self._make(code, "fadd", first, part, lanes)
        return first

    def _in_all(self, code: Code, x: str, kind: str | None = None) -> str:
        if self.lanes.count == 1:
            return x
        kind = kind or self.lanes.scalar
        V, W = self.lanes.of(kind), self.lanes.count
        first = code.new(f"insertelement {V} poison, {kind} {x}, i64 0")
        return code.new(f"shufflevector {V} {first}, {V} poison, <{W} x i32> zeroinitializer")

    def _lane(self, code: Code, x: str, k: int, lanes: Lanes) -> str:
        return code.new(f"extractelement {lanes.vector} {x}, i64 {k}") if lanes.count > 1 else x

    def _arguments(self, code: Code) -> dict[str, str]:
        kinds = {"samples", "nodes", "steps", "kinds"}
        return {
            name: code.load(code.at("%args", k), "i64" if name in kinds else "ptr")
            for k, name in enumerate(ARGS)
        }

    # Functions

    def _spread(self) -> str:
        """spread(x, other, nodes, result): square of the norm of what x less other, of the nodes,
        differ by in each component.
        """
        code = Code("spread", ["ptr %x", "ptr %other", "i64 %nodes", "ptr %result"])
        four, one = Lanes(4, self.lanes.dtype), self.one
        least, most = (code.slot(four.vector) for _ in range(2))
        for slot, value in ((least, float("inf")), (most, float("-inf"))):
            code.store(four.constant(value), slot, four.vector)

        def take(change: str) -> None:
            for slot, better in ((least, self._less), (most, self._more)):
                best = code.load(slot, four.vector)
                code.store(better(code, change, best, four), slot, four.vector)

        last = code.sub("%nodes", 1)
        with code.loop(0, last) as n:  # the fourth of each is the next node's first
            at = code.mul(n, 3)
            x, other = (self._load(code, name, at, four) for name in ("%x", "%other"))
            take(self._make(code, "fsub", x, other, four))
        change, at = "poison", code.mul(last, 3)
        for k in range(3):
            place = code.add(at, k)
            x, other = (self._load(code, name, place) for name in ("%x", "%other"))
            part = self._make(code, "fsub", x, other, one)
            change = code.new(f"insertelement {four.vector} {change}, {one.scalar} {part}, i64 {k}")
        zero = one.constant(0.0)
        take(code.new(f"insertelement {four.vector} {change}, {one.scalar} {zero}, i64 3"))
        ends = (code.load(slot, four.vector) for slot in (most, least))
        wide = self._make(code, "fsub", *ends, four)
        parts = [self._lane(code, wide, k, four) for k in range(3)]
        self._store(code, self._product(code, parts, parts, one), "%result")
        return code.text(internal=True)

    def _copy(self) -> str:
        """copy(to, source, count, result): 0, or NaN, where not all of them are finite."""
        code, one = Code("copy", ["ptr %to", "ptr %source", "i64 %count", "ptr %result"]), self.one
        self._store(code, one.constant(0.0), "%result")
        with code.loop(0, "%count") as k:
            x = self._load(code, "%source", k)
            self._store(code, x, "%to", k)
            none = self._make(code, "fsub", x, x, one)
            total = self._make(code, "fadd", self._load(code, "%result", 0), none, one)
            self._store(code, total, "%result")
        return code.text(internal=True)

    def _least(self, rates: bool) -> str:
        """least_gap, or with rates least_time (x, velocity, before, after, nodes, runs, count,
        reach, scratch, result): of the pairs of so many runs.
        """
        names = "x velocity before after runs reach scratch result".split()
        counts = ["i64 %nodes", "i64 %count"]
        name = "least_time" if rates else "least_gap"
        code, one, W = Code(name, [f"ptr %{x}" for x in names] + counts), self.one, self.lanes.count
        room = code.add("%nodes", W)
        planes = [code.at("%scratch", code.mul(room, k), one.scalar) for k in range(PLANES)]
        places, wide, moving = planes[:3], planes[3], planes[4:]
        with code.loop(0, "%nodes") as n:
            at = code.mul(n, 3)
            for source, planes in (("%x", places), *[("%velocity", moving)] * rates):
                for k, plane in enumerate(planes):
                    self._store(code, self._load(code, source, code.add(at, k)), plane, n)
        with code.loop(0, "%nodes") as n:
            squares = []
            for side in ("%before", "%after"):
                other = code.load(code.at(side, n))
                parts = [
                    self._make(
                        code, "fsub", self._load(code, x, n), self._load(code, x, other), one
                    )
                    for x in places
                ]
                squares.append(self._product(code, parts, parts, one))
            square = self._more(code, *squares, one)
            length = code.new(f"call {one.vector} {self.root_of_one}({one.vector} {square})")
            self._store(code, self._make(code, "fmul", length, one.constant(0.5), one), wide, n)
        V, lanes = self.lanes.vector, self.lanes
        best, infinite = code.slot(V), lanes.constant(float("inf"))
        code.store(infinite, best, V)
        kinds = lanes.of("i64")
        numbers = "<" + ", ".join(f"i64 {k}" for k in range(W)) + ">" if W > 1 else "0"
        with code.loop(0, "%count") as r:
            run = code.at("%runs", code.mul(r, RUN))
            node, first, end, kind = (code.load(code.at(run, k)) for k in range(RUN))
            own = [self._in_all(code, self._load(code, x, node)) for x in places]
            speed = [self._in_all(code, self._load(code, x, node)) for x in moving * rates]
            both = self._make(
                code, "fadd", self._load(code, wide, node), self._load(code, "%reach", kind), one
            )
            both, last = self._in_all(code, both), self._in_all(code, end, "i64")
            with code.loop(first, end, W) as b:
                d = [
                    self._make(code, "fsub", self._load(code, x, b, lanes), y, lanes)
                    for x, y in zip(places, own, strict=True)
                ]
                square = self._product(code, d, d, lanes)
                distance = code.new(f"call {V} {self.root}({V} {square})")
                gap = self._make(code, "fsub", distance, self._load(code, wide, b, lanes), lanes)
                gap = self._make(code, "fsub", gap, both, lanes)
                if rates:
                    v = [
                        self._make(code, "fsub", y, self._load(code, x, b, lanes), lanes)
                        for x, y in zip(moving, speed, strict=True)
                    ]
                    nearing = self._product(code, d, v, lanes)
                    way = self._make(code, "fmul", gap, distance, lanes)
                    time = self._make(code, "fdiv", way, nearing, lanes)
                    zero = lanes.constant(0.0)
                    truth = code.new(f"fcmp ogt {V} {nearing}, {zero}")
                    gap = code.new(f"select {lanes.truth} {truth}, {V} {time}, {V} {infinite}")
                number = code.new(f"add {kinds} {self._in_all(code, b, 'i64')}, {numbers}")
                there = code.new(f"icmp slt {kinds} {number}, {last}")
                gap = code.new(f"select {lanes.truth} {there}, {V} {gap}, {V} {infinite}")
                code.store(self._less(code, gap, code.load(best, V), lanes), best, V)
        whole = code.load(best, V)
        parts = [self._lane(code, whole, k, lanes) for k in range(W)]
        least = parts[0]
        for part in parts[1:]:
            least = self._less(code, part, least, one)
        self._store(code, least, "%result")
        return code.text(internal=True)

    def _of_sample(self, code: Code, args: dict[str, str], b: str) -> Callable[[str, str], str]:
        """f(function, x): its result, of sample b with nodes at x."""
        bounds = code.at(args["runs"], code.mul(b, 2))
        first, count = code.load(bounds), code.load(code.at(bounds, 1))
        runs = code.at(args["runs"], first)
        reach = code.at(args["reach"], code.mul(b, args["kinds"]), self.one.scalar)
        result = code.slot(self.one.scalar)
        tables = [args[name] for name in ("before", "after")]

        def least(function: str, x: str, velocity: str = "null") -> str:
            pointers = [x, velocity, *tables, runs, reach, args["scratch"], result]
            text = ", ".join(f"ptr {p}" for p in pointers)
            code.line(f'call void @"{function}"({text}, i64 {args["nodes"]}, i64 {count})')
            return self._load(code, result, 0)

        return least

    def _within(self) -> str:
        code, one, scalar = Code("within", ["ptr %args"]), self.one, self.one.scalar
        args = self._arguments(code)
        size, limit = code.mul(args["nodes"], 3), code.slot()
        square, result = code.slot(scalar), code.slot(scalar)
        whole = code.mul(args["samples"], size)
        code.store(args["steps"], limit)

        def spread(x: str, other: str) -> str:
            code.line(
                f'call void @"spread"(ptr {x}, ptr {other}, i64 {args["nodes"]}, ptr {result})'
            )
            return self._load(code, result, 0)

        with code.loop(0, args["samples"]) as b:
            least, sample = self._of_sample(code, args, b), code.mul(b, size)
            known, start = (code.at(args[name], sample, scalar) for name in ("known", "start"))
            moved = code.at(args["moved"], sample, scalar)
            step = code.slot()
            code.store(-1, step)
            with code.until() as ends:
                k = code.load(step)
                before = code.sub(k, 1)
                is_start, is_first = (code.compare("slt", k, n) for n in (0, 1))
                x = code.at(moved, code.mul(k, whole), scalar)
                x = code.choose(is_start, start, x, "ptr")
                last = code.at(moved, code.mul(before, whole), scalar)
                last = code.choose(is_first, start, last, "ptr")
                code.store(code.add(k, 1), step)
                room = self._load(code, args["room"], b)
                far = code.new(f"fcmp ugt {scalar} {spread(x, known)}, {room}")
                with code.when(far):
                    gap = least("least_gap", x)
                    none = code.new(f"fcmp ole {scalar} {gap}, {one.constant(0.0)}")
                    self._store(code, self._make(code, "fmul", gap, gap, one), square)
                    way = spread(x, last)
                    short = code.new(f"fcmp ogt {scalar} {way}, {self._load(code, square, 0)}")
                    over = code.new(f"or i1 {none}, {short}")
                    with code.when(over):
                        code.store(k, limit)
                    with code.when(code.new(f"xor i1 {over}, true")):
                        arguments = f"ptr {known}, ptr {x}, i64 {size}, ptr {result}"
                        code.line(f'call void @"copy"({arguments})')
                        space, none = (self._load(code, slot, 0) for slot in (square, result))
                        space = self._make(code, "fadd", space, none, one)
                        self._store(code, space, args["room"], b)
                ends.append(code.compare("sge", code.load(step), code.load(limit)))
        code.store(code.load(limit), args["result"])
        return code.text()

    def _approach(self) -> str:
        code, scalar = Code("approach", ["ptr %args"]), self.one.scalar
        args = self._arguments(code)
        size, best = code.mul(args["nodes"], 3), code.slot(scalar)
        self._store(code, self.one.constant(float("inf")), best)
        with code.loop(0, args["samples"]) as b:
            sample, least = code.mul(b, size), self._of_sample(code, args, b)
            x, velocity = (code.at(args[name], sample, scalar) for name in ("start", "moved"))
            time = least("least_time", x, velocity)
            self._store(code, self._less(code, time, self._load(code, best, 0), self.one), best)
        self._store(code, self._load(code, best, 0), args["result"])
        return code.text()
