"""Native drivers of Newton's method, for each group of samples, a lane each, at one point after
another: a step, a share of the load, a point of a path. These differ in what their slots do.

| | `_points` | `_begin` | `_iterate` | `_finish` |
|---|---|---|---|---|
| step | instants | predict the move | Newton's method | state, reactions, work |
| load step | shares of the load | go to the last shape | the same | keep the shape |
| path | the shape, its slope by the load | go to the shape | one balance | moves that are asked |

An iteration is one pass: the balance of what joints, tendons and pairs connect, and of the nodes
and elements at them; then the elimination, which finds that of the others as it comes to them, so
that no block of their matrix is kept. Back substitution, and the updates of unknowns that are not
over yet. Everything that is computed is in the functions of `LocalFunctions`; here is only in which
order, and where their fields lie.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ..compiler.shared_ends import END
from ..compiler.split import HOISTED
from .driver_code import ALL, ROWS, Place, Places
from .elimination_driver import Elimination
from .interaction import SIDES
from .layout import ELEMENTS, LAW, NODES, TOLD

SUMS = ("force", "moment", "strain", "left_force", "left_moment", "left_strain")
SQUARES = ("square_force", "square_moment")


class Driver(Elimination):
    """Newton's method at each of the points."""

    ARGS = (*ALL, "limit")

    def _group(self, first: str) -> None:
        with self._points(first):
            self._begin()
            self._iterate()
            self._finish()

    @contextmanager
    def _points(self, first: str) -> Iterator[None]:
        """One after the other, with its own inputs and outputs."""
        with self.code.loop(0, self.args["steps"]) as step:
            self._transfer("gather", "input", first, step)
            yield
            self._transfer("scatter", "output", first, step)

    def _begin(self) -> None:
        """Unknowns to start from, and which samples do not move."""
        raise NotImplementedError

    def _finish(self) -> None:
        """What is kept of the unknowns, by samples that have gone well."""
        raise NotImplementedError

    def _start(self) -> None:
        """Stresses and forces to start from."""
        with self.code.loop(0, self.args["elements"]) as e:
            self._copy_to(("stress", e), ("start_stress", e))
        self._start_multipliers()

    def _hoisted(self) -> None:
        """What does not depend on the unknowns."""
        with self.code.loop(0, self.args["nodes"]) as j:
            self._at_node("before node", j, ("before node", j))
        with self.code.loop(0, self.args["elements"]) as e:
            self._at_element("before element", e, ("before element", e))
        for one in self.interactions:
            if f"before {one.name}" in self.layout.records:
                self._each_of(one, self._hoist)

    def _border(self) -> None:
        """What is on either side of all nodes: nothing, which does not move."""
        self._fill(("move", 0))
        self._fill(("move", self._move_of(self.args["nodes"], self.order - 1)))
        self._fill(("nothing", 0))

    def _iterate(self) -> None:
        """Iterations, until all samples are over."""
        code = self.code
        for name in ("before", "iterations"):
            self._fill(("sample", 0, name))
        self._each_told(lambda told, *_: self._fill(*told))
        count = code.slot()
        code.store(0, count)
        with code.until() as ends:
            self._pass()
            if "search" in self.functions:
                self._search()
                self._back("still")
                self._take_back()
            else:
                self._back()
            self._tell()
            self._judge()
            iterations = code.add(code.load(count), 1)
            code.store(iterations, count)
            code.call("all", self.at("sample", 0, "over"), result := code.slot())
            ends.append(
                code.new(
                    f"or i1 {code.compare('sge', iterations, self.args['limit'])}, "
                    f"{code.compare('ne', code.load(result), 0)}"
                )
            )

    def _pass(self) -> None:
        """Balance and elimination."""
        self._fill(("sums", 0))
        self._each_told(lambda _, coming, *__: self._fill(*coming))
        if self.has_interface:
            with self._entries("interface") as (_, (node, *_)):
                self._fill(("push", node))
            self._at_interface()
        self._tensions()
        for one in self.interactions:
            for shared in self.parts:
                self._each_of(one, self._push, look=True, shared=shared)
                if shared is False:
                    self._push_on_shared()
        self._eliminate()

    def _push_on_shared(self) -> None:
        """What the joints of all cells push the nodes that these share by."""
        first = self.args["own_nodes"]
        count = self.code.sub(self.args["nodes"], first)
        size = self.code.mul(count, self._size(("push", first)))
        self._over_cells("sum", self.at("push", first), size)

    def _give(self, e: str, to: Place) -> None:
        places = {HOISTED: ("before element", e), f"> {to[0]}": to, f"> {LAW}": ("strain_law", e)}
        self._at_element("element", e, ("change", 0), places)
        self._judge_by("element 0")
        for k in self._loaded(e):
            self._add_load(f"element load {k}", e, to)
            if "told" in self.functions[f"element load {k}"].outputs:
                far = self.at("change", 0, "far")
                self._blend((f"next {ELEMENTS}", e), ("change", 0, "told"), far)
            self._judge_by(f"far {k}", f"element load {k}")

    def _node(self, j: str, turn: str | int) -> None:
        """Balance of node j, and what is computed there for the elements at it."""
        places = {f"> {END}": ("at_end", turn), HOISTED: ("before node", j)}
        places["> told"] = f"next {NODES}", j
        self._at_node("node", j, ("at_node", turn), places)

    def _condensed(self, e: str) -> None:
        self._judge_by("condense")

    def _row_kept(self, node: str) -> None:
        """Where a support holds a node: the node's rows, for the reaction."""
        support = self._support_of(node)
        with self.code.when(self.code.compare("sge", support, 0)):
            for name in ("rows", "asked"):
                self._copy_to(("support", support, name), ("change", 0, name))

    def _around(self, node: str) -> Places:
        return (self._near(node) if self.held else {}) | {"push": ("push", node)}

    def _row_judged(self, name: str) -> None:
        self._judge_by(name)

    def _back(self, still: str = "over") -> None:
        """Moves, those of midside nodes last; what follows from them, but of samples that are
        `still`, by a field of these.
        """
        code = self.code
        self._moves()
        self._restore("move")
        over = self.at("sample", 0, still)
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                self._react(k, code.load(code.at(self.args["support_nodes"], k)), over)
        with code.loop(0, self.args["elements"]) as e:
            places = {
                f"{side}.move": ("move", self._move_of(self._node_of(e, side)))
                for side in SIDES[self.order]
            }
            own = ("stress", "strain_law", "element")
            self._call("stress", lambda f: self._first_of(own, f, e), ("change", 0), places)
            self._blend(("stress", e), ("change", 0, "stress"), over)
        with code.loop(0, self.args["nodes"]) as j:
            self._at_node("update", j, ("change", 0), {"move": ("move", self._move_of(j))})
            for name in self.layout.fields("unknown"):
                self._blend(("unknown", j, name), ("change", 0, name), over)
        self._update_multipliers(over)

    def _react(self, k: str, node: str, over: str) -> None:
        """The reaction of support k, at a node, but of samples that are over."""
        code, here, reach = self.code, self._move_of(node), self._reach(node)
        places = {
            "before": ("move", code.sub(here, reach)),
            "here": ("move", here),
            "after": ("move", code.add(here, reach)),
            "free": ("free", node),
        }
        self._call("reaction", lambda f: self.at("support", k, f), ("support", k), places)
        self._interaction_reactions(k, node)
        self._blend(("support", k, "found"), ("support", k, "reaction"), over)

    def _search(self) -> None:
        """Which samples take their last step back; of those that are below the best, the best."""
        self._agree()
        self._call_of_sample("search")
        worse = self.at("sample", 0, "worse")
        for name, best, count in self._unknowns():
            with self.code.loop(0, count) as k:
                self._blend((best, k), (name, k), worse)
        self._each_told(lambda told, _, best: self._blend(best[0], told[0], worse, told[1]))

    def _take_back(self) -> None:
        """Part of the way back, of samples that take it."""
        code = self.code
        forth = self.at("sample", 0, "forth")
        code.call("all", forth, result := code.slot())
        with code.when(code.compare("eq", code.load(result), 0)):
            for name, best, count in self._unknowns():
                with code.loop(0, count) as k:
                    self._part_back(name, best, k)
                    self._blend((name, k), (f"{name}_back", 0), forth)

    def _part_back(self, name: str, best: str, k: str) -> None:
        fields = [*self.layout.fields(name)] if name == "unknown" else ["x"]
        places: Places = {"ratio": ("sample", 0, "ratio")}
        for field in fields:
            own = (field,) if name == "unknown" else ()
            to = f"to_{field}" if name == "unknown" else "to"
            places |= {field: (best, k, *own), to: (name, k, *own)}
            places[f"> {field}"] = (f"{name}_back", 0, *own)
        self._call("between" if name == "unknown" else f"part {name}", places=places)

    def _each_told(self, then: Callable[..., None]) -> None:
        """then(what is told, what is told next, what was told at the best) of each sort of rows,
        where all of them begin and how many numbers that is.
        """
        for rows in TOLD.values():
            if f"told {rows}" in self.layout.records:
                size = self._size((f"told {rows}", 0))
                size = self.code.mul(self.args[ROWS[rows]], size)
                then(*(((f"{word} {rows}", 0), size) for word in ("told", "next", "best told")))

    def _tell(self) -> None:
        """What the next iteration is told, see `newton`."""

        def tell(told: tuple[Place, str], coming: tuple[Place, str], best: Any) -> None:
            if "search" not in self.functions:
                self._copy_to(told[0], coming[0], told[1])
                return
            for source, kept in ((coming, "back"), (best, "stays")):
                self._blend(told[0], source[0], self.at("sample", 0, kept), told[1])

        self._each_told(tell)

    def _unknowns(self) -> list[tuple[str, str, str]]:
        """Records of unknowns, of the best so far, and how many there are."""
        args = self.args
        return [
            ("unknown", "best_unknown", args["nodes"]),
            ("stress", "best_stress", args["elements"]),
            *[("multiplier", "best_multiplier", args["multipliers_count"])] * self.kinds.multiplied,
        ]

    def _judge(self) -> None:
        self._agree()
        self._call_of_sample("judge")

    def _agree(self) -> None:
        """Of what the cells of a sample are judged by."""
        self._over_cells("largest", self.at("sums"), self._size(("sums", 0)))

    def _call_of_sample(self, name: str) -> None:
        """A function of what is of a sample, whose outputs are, too."""
        self._call(name, lambda f: self._first_of(("sums", "sample"), f), ("change", 0))
        for output in self.functions[name].outputs:
            self._copy_to(("sample", 0, output), ("change", 0, output))

    def _judge_by(self, *names: str) -> None:
        """By what functions have given of sums: the largest, of squares the sum itself."""
        given = {field for name in names for field in self.functions[name].outputs}
        for name in (name for name in self.layout.fields("sums") if name in given):
            if name in SQUARES:
                self._add(("sums", 0, name), ("change", 0, name))
            else:
                self.code.call("largest", self.at("sums", 0, name), self.at("change", 0, name))

    def _least_cosine(self, j: str) -> None:
        """Of the nodes' turns, that of node j among them."""
        cosine, own = self.at("sample", 0, "cosine"), self.at("change", 0, "cosine")
        with self.code.when(self.code.compare("eq", j, 0)):
            self._copy_to(cosine, own, 1)
        self.code.call("least", cosine, own)

    def _counted(self, good: str, row: str, own: str) -> str:
        """What has gone well, in whose lanes a row counts: what cells share counts in the first of
        them alone. own: how many rows are a cell's.
        """
        if self.cells == 1:
            return good
        shared = self.code.compare("sge", row, self.args[own])
        return self.code.choose(shared, self.at("sample", 0, "counted"), good, "ptr")

    def _keep_forces(self, good: str) -> None:
        """Stress, and the loads of supports, of what has gone well."""
        with self.code.loop(0, self.args["elements"]) as e:
            self._take(("start_stress", e), ("stress", e), good)
        if self.held:
            with self.code.loop(0, self.args["supports"]) as k:
                self._take(("support", k, "last"), ("support", k, "found"), good)
