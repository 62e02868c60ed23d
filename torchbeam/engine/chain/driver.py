"""Native driver of Newton's method, for each group of samples, a lane each, at one point after
another: a step, a share of the load, a point of a path. These differ in what their slots do.

| | `points` | `begin` | `iterate` | `finish` |
|---|---|---|---|---|
| step | instants | predict the move | Newton's method | state, reactions, work |
| load step | shares of the load | go to the last shape | the same | keep the shape |
| path | the shape, its slope by the load | go to the shape | one balance | moves that are asked |

An iteration is one pass: the balance of what joints, tendons and pairs connect, and of the nodes
and elements at them; then the elimination, which finds that of the others as it comes to them, so
that no block of their matrix is kept. Back substitution, and the updates of unknowns that are not
over yet. Everything that is computed is in local functions (of nodes and elements, of rows, of
midside nodes, of samples); here is only in which order, and where their fields lie.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from ..compiler.shared_ends import END
from ..compiler.split import HOISTED
from .elimination_driver import Elimination
from .interaction_sorts import BALANCES
from .interactions import SUMS as OF_INTERACTIONS
from .layout import ELEMENTS, LAW, NODES, TOLD
from .record_code import ALL, ROWS, Place, Places
from .search_driver import SQUARES, Search
from .sorts import ELEMENT, NODE, SIDES, Row
from .tendon_driver import Tensions

SIZES = "force", "moment", "strain", "curvature"
SUMS = (*SIZES, *(f"left_{name}" for name in SIZES))


class Slots:
    """What is before, around and behind the iterations at each point, as a driver writes it."""

    def __init__(self, driver: Driver) -> None:
        self.driver, self.code = driver, driver.code

    @contextmanager
    def points(self, first: str) -> Iterator[None]:
        """One after the other, with its own inputs and outputs."""
        with self.code.loop(0, self.driver.args["steps"]) as step:
            self.driver.transfer("gather", "input", first, step)
            yield
            self.driver.transfer("scatter", "output", first, step)

    def begin(self) -> None:
        """Unknowns to start from, and which samples do not move."""
        raise NotImplementedError

    def iterate(self) -> None:
        """What is done to these."""
        self.driver.iterate()

    def balance(self, then: Callable[[], None]) -> None:
        """`then` finds the balance, and eliminates."""
        then()

    def condensed(self, e: str) -> None:
        """What else follows from having eliminated the midside node of element e."""

    def finish(self) -> None:
        """What is kept of the unknowns, by samples that have gone well."""
        raise NotImplementedError


class Driver(Elimination):
    """Newton's method at each of the points."""

    ARGS = (*ALL, "limit")

    def __init__(self, slots: type[Slots], *of: Any) -> None:
        super().__init__(*of)
        self.slots, self.tensions = slots(self), Tensions(self)
        self.search = Search(self) if "search" in self.functions else None

    def group(self, first: str) -> None:
        with self.slots.points(first):
            self.slots.begin()
            self.slots.iterate()
            self.slots.finish()

    def start(self) -> None:
        """Stresses and forces to start from."""
        with self.code.loop(0, self.args["elements"]) as e:
            self.copy(("stress", e), ("start_stress", e))
        self.each_multiplier(
            lambda k: self.copy(("multiplier", k), ("multiplier_state", k, "last_force"))
        )

    def hoisted(self) -> None:
        """What does not depend on the unknowns."""
        for sort in BALANCES:
            if (before := f"before {sort.name}") in self.layout.records:
                self.each_row(sort, lambda row, to=before: self.call_of(to, row, to))

    def border(self) -> None:
        """What is on either side of all nodes: nothing, which does not move."""
        self.fill(("move", 0))
        self.fill(("move", self.move_of(self.args["nodes"], self.order - 1)))
        self.fill(("nothing", 0))

    def iterate(self) -> None:
        """Iterations, until all samples are over."""
        code = self.code
        for name in ("before", "iterations"):
            self.fill(("sample", 0, name))
        self.each_told(lambda told, *_: self.fill(*told))
        count = code.slot()
        code.store(0, count)
        with code.until() as ends:
            self.balance()
            if self.search:
                self.agree()
                self.call_of_sample("search")  # which take their last step back
                worse = self.at("sample", 0, "worse")
                self.search.keep(worse)
                self.each_told(lambda told, _, best: self.blend(best[0], told[0], worse, told[1]))
                self.back("still")
                self.search.take_back()
            else:
                self.back()
            self._tell()
            self.judge()
            iterations = code.add(code.load(count), 1)
            code.store(iterations, count)
            code.call("all", self.at("sample", 0, "over"), result := code.slot())
            ends.append(
                code.new(
                    f"or i1 {code.compare('sge', iterations, self.args['limit'])}, "
                    f"{code.compare('ne', code.load(result), 0)}"
                )
            )

    def balance(self) -> None:
        """Balance and elimination."""
        self.slots.balance(self._balance)

    def _balance(self) -> None:
        self.fill(("sums", 0))
        self.each_told(lambda _, coming, *__: self.fill(*coming))
        if self.has_interface:
            with self.entries("interface") as (_, (node, *_)):
                self.fill(("push", node))
            self.at_interface()
        self.tensions.find()
        for sort in self.interactions:
            for shared in self.parts:
                self.each_of(sort, self._push, look=True, shared=shared)
                if shared is False:
                    self._push_on_shared()
        self.eliminate()

    def _push(self, row: Row) -> None:
        """The balance and blocks of what acts between nodes, and its push on these."""
        record, word, size = f"{row.name} blocks", f"before {row.name}", self.coupled(row)
        hoisted: Places = {HOISTED: (word, row.number)} if word in self.layout.records else {}
        self.call_of(row.name, row, record, hoisted)
        if "told" in self.outputs_of(row.name, row):
            told, far = ((record, row.number, name) for name in ("told", "far"))
            self.blend((f"next {row.of.rows}", row.number), told, self.at(*far))
        for side in row.sides:
            self.add(("push", row.nodes[side]), (record, row.number, f"{side}.push"), size)
        for name in OF_INTERACTIONS:
            if name in self.layout.fields(record):
                force = self.at(record, row.number, name)
                self.code.call("largest", self.at("sums", 0, name), force)

    def _push_on_shared(self) -> None:
        """What the joints of all cells push the nodes that these share by."""
        first = self.args["own_nodes"]
        count = self.code.sub(self.args["nodes"], first)
        size = self.code.mul(count, self.size_of(("push", first)))
        self.over_cells("sum", self.at("push", first), size)

    def give(self, e: str, to: Place) -> None:
        places = {HOISTED: ("before element", e), f"> {to[0]}": to, f"> {LAW}": ("strain_law", e)}
        self.call_of("element", ELEMENT.at(e), "change", places)
        self._judge_by("element 0")

        def load(row: Row) -> None:
            name = f"{row.name} {row.kind}"
            self.call_of(row.name, row, "change")
            self.add(to, ("change", 0, to[0]))
            if "told" in self.functions[name].outputs:
                far = self.at("change", 0, "far")
                self.blend((f"next {ELEMENTS}", e), ("change", 0, "told"), far)
            self._judge_by(f"far {name}", name)

        self.each_load(e, load)

    def node(self, j: str, turn: str | int) -> None:
        """Balance of node j, and what is computed there for the elements at it."""
        places = {f"> {END}": ("at_end", turn), HOISTED: ("before node", j)}
        places["> told"] = f"next {NODES}", j
        self.call_of("node", NODE.at(j), ("at_node", turn), places)

    def condensed(self, e: str) -> None:
        self._judge_by("condense")
        self.slots.condensed(e)

    def row_kept(self, node: str) -> None:
        """Where a support holds a node: the node's rows, for the reaction."""
        support = self.integer("support_of", node)
        with self.code.when(self.code.compare("sge", support, 0)):
            for name in ("rows", "asked"):
                self.copy(("support", support, name), ("change", 0, name))

    def around(self, node: str) -> Places:
        return (self.free_near(node) if self.held else {}) | {"push": ("push", node)}

    def row_judged(self, name: str) -> None:
        self._judge_by(name)

    def back(self, still: str = "over") -> None:
        """Moves, those of midside nodes last; what follows from them, but of samples that are
        `still`, by a field of these.
        """
        code = self.code
        self.moves()
        self.restore("move")
        over = self.at("sample", 0, still)
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                self._react(k, self.integer("support_nodes", k), over)
        with code.loop(0, self.args["elements"]) as e:
            places = {
                f"{side}.move": ("move", self.move_of(self.node_of(e, side)))
                for side in SIDES[self.order]
            }
            records = ("stress", "strain_law", "element")
            self.call("stress", lambda f: self.first_of(records, f, e), ("change", 0), places)
            self.blend(("stress", e), ("change", 0, "stress"), over)
        with code.loop(0, self.args["nodes"]) as j:
            self.call_of("update", NODE.at(j), "change", {"move": ("move", self.move_of(j))})
            for name in self.layout.fields("unknown"):
                self.blend(("unknown", j, name), ("change", 0, name), over)

        def update(k: str) -> None:
            move = self.matrix(code.load(self.entry("multipliers", k)))
            places: Places = {"force": ("multiplier", k), "move": move}
            self.call("multiplier update", to=("change", 0), places=places)
            self.blend(("multiplier", k), ("change", 0, "force"), over)

        self.each_multiplier(update)

    def _react(self, k: str, node: str, over: str) -> None:
        """The reaction of support k, at a node, but of samples that are over."""
        code, here, reach = self.code, self.move_of(node), self._reach(node)
        places = {
            "before": ("move", code.sub(here, reach)),
            "here": ("move", here),
            "after": ("move", code.add(here, reach)),
            "free": ("free", node),
        }
        self.call("reaction", lambda f: self.at("support", k, f), ("support", k), places)
        self._reactions(k, node)
        self.blend(("support", k, "found"), ("support", k, "reaction"), over)

    def _reach(self, node: str) -> str | int:
        """How far it is to the nodes that a node's row has blocks of: of a midside node its
        element's ends.
        """
        if not self.has_midsides:
            return 1
        code, (left, right) = self.code, self.elements_at(node).values()
        inside = code.compare("slt", code.new(f"and i64 {left}, {right}"), 0)
        return code.choose(inside, 1, self.order)

    def _reactions(self, support: str, node: str) -> None:
        """What interactions add to the reaction of a support, at a node. Where cells share nodes,
        what all of their joints add.
        """
        code, w, to = self.code, self.width, self.at("support", support, "reaction")
        total = to if self.cells == 1 else self.at("end_reaction", 0, "total")
        if self.cells > 1:
            self.fill(total, w)

        def reaction(row: Row) -> None:
            moves = self.moves_of(row) | {"end_free": ("free", node)}
            for side in row.sides:
                with code.when(code.compare("eq", row.nodes[side], node)):
                    name = f"{row.name} reaction {row.kind} {side}"
                    self.call(name, partial(self.field_of, row=row), ("change", 0), moves)
                    self.add(total, ("change", 0, "reaction"), w)

        for sort in self.interactions:
            for shared in self.parts:
                self.each_of(sort, reaction, shared=shared)
                if shared is False:
                    with code.when(code.compare("sge", node, self.args["own_nodes"])):
                        self.over_cells("sum", total, w)
        if self.cells > 1:
            self.add(to, total, w)

    # What the last iteration tells

    def each_told(self, then: Callable[..., None]) -> None:
        """then(what is told, what is told next, what was told at the best) of each sort of rows,
        where all of them begin and how many numbers that is.
        """
        for rows in TOLD.values():
            if f"told {rows}" in self.layout.records:
                size = self.size_of((f"told {rows}", 0))
                size = self.code.mul(self.args[ROWS[rows]], size)
                then(*(((f"{word} {rows}", 0), size) for word in ("told", "next", "best told")))

    def _tell(self) -> None:
        """What the next iteration is told, see `newton`."""

        def tell(told: tuple[Place, str], coming: tuple[Place, str], best: Any) -> None:
            if not self.search:
                self.copy(told[0], coming[0], told[1])
                return
            for source, kept in ((coming, "back"), (best, "stays")):
                self.blend(told[0], source[0], self.at("sample", 0, kept), told[1])

        self.each_told(tell)

    # What a sample is judged by

    def judge(self) -> None:
        self.agree()
        self.call_of_sample("judge")

    def agree(self) -> None:
        """Of what the cells of a sample are judged by."""
        self.over_cells("largest", self.at("sums"), self.size_of(("sums", 0)))

    def call_of_sample(self, name: str) -> None:
        """A function of what is of a sample, whose outputs are, too."""
        self.call(name, lambda f: self.first_of(("sums", "sample"), f), ("change", 0))
        for output in self.functions[name].outputs:
            self.copy(("sample", 0, output), ("change", 0, output))

    def _judge_by(self, *names: str) -> None:
        """By what functions have given of sums: the largest, of squares the sum itself."""
        outputs = {field for name in names for field in self.functions[name].outputs}
        for name in (name for name in self.layout.fields("sums") if name in outputs):
            if name in SQUARES:
                self.add(("sums", 0, name), ("change", 0, name))
            else:
                self.code.call("largest", self.at("sums", 0, name), self.at("change", 0, name))

    def least_cosine(self, j: str) -> None:
        """Of the nodes' turns, that of node j among them."""
        cosine, least = self.at("sample", 0, "cosine"), self.at("change", 0, "cosine")
        with self.code.when(self.code.compare("eq", j, 0)):
            self.copy(cosine, least, 1)
        self.code.call("least", cosine, least)

    def keep_forces(self, good: str) -> None:
        """Stress, and the loads of supports, of what has gone well."""
        with self.code.loop(0, self.args["elements"]) as e:
            self.take(("start_stress", e), ("stress", e), good)
        if self.held:
            with self.code.loop(0, self.args["supports"]) as k:
                self.take(("support", k, "last"), ("support", k, "found"), good)
