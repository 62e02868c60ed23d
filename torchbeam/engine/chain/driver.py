"""Native driver of a step: for each group of samples, a lane each, Newton's method, step by step.

An iteration is one pass: the balance of what joints, tendons and pairs connect, and of the nodes
and elements at them; then the elimination, which finds that of the others as it comes to them, so
that no block of their matrix is kept. Back substitution, and the updates of unknowns that are not
over yet. Everything that is computed is in the functions of `LocalFunctions`; here is only in which
order, and where their fields lie.
"""

from __future__ import annotations

from ..compiler.shared_ends import END
from ..compiler.split import HOISTED
from .driver_code import ALL, Places
from .elimination_driver import Elimination
from .interaction import FINISHED, JOINT
from .layout import BETWEEN, FLAGS, INNER, LAW, MIDDLE, OWN
from .node_kinds import SIDES

SUMS = ("force", "moment", "strain", "left_force", "left_moment", "left_strain")
SQUARES = ("square_force", "square_moment")


class Driver(Elimination):
    """Steps of Newton's method."""

    ARGS = (*ALL, "limit")

    def _group(self, first: str) -> None:
        with self.code.loop(0, self.args["steps"]) as step:
            self._transfer("gather", "input", first, step)
            self._step()
            self._transfer("scatter", "output", first, step)

    # A step

    def _step(self) -> None:
        code = self.code
        with code.loop(0, self.args["nodes"]) as j:
            self._at_node("predictor", j, ("unknown", j))
        self._hoisted()
        with code.loop(0, self.args["elements"]) as e:
            self._copy_to(("stress", e), ("start_stress", e))
        self._start_joints()
        self._start_tendons()
        for name in ("over", "done"):
            code.call("opposite", self.at("sample", 0, name), self.at("sample", 0, "moving"))
        self._border()
        self._newton()
        self._finish()

    def _hoisted(self) -> None:
        """What does not depend on the unknowns."""
        with self.code.loop(0, self.args["nodes"]) as j:
            self._at_node("before node", j, ("before node", j))
        with self.code.loop(0, self.args["elements"]) as e:
            self._at_element("before element", e, ("before element", e))
        self._each_of(JOINT, self._hoist)

    def _border(self) -> None:
        """What is on either side of all nodes: nothing, which does not move."""
        self._fill(("move", 0))
        self._fill(("move", self._move_of(self.args["nodes"], self.order - 1)))
        self._fill(("nothing", 0))

    def _newton(self) -> None:
        """Iterations, until all samples are over."""
        code = self.code
        for name in ("before", "iterations"):
            self._fill(("sample", 0, name))
        if "secant" in self.layout.fields("common"):
            self._fill(("common", 0, "secant"))
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

    def _element(self, e: str) -> None:
        """Balance of element e, and of its midside node."""
        if self.order == 2:
            self._node(self._node_of(e, "m"), self._turn(e, "m"))
        places = {
            HOISTED: ("before element", e),
            f"> {BETWEEN}": ("between", self._between(e)),
            f"> {INNER}": ("inner", 0),
            f"> {LAW}": ("strain_law", e),
        }
        self._at_element("element", e, ("at_element", 0), places)
        for name in ("force", "moment", "strain", "left_strain"):
            self._largest(name, "at_element")
        self._element_load(e)
        if self.order == 2:
            self._condense(e)

    def _element_load(self, e: str) -> None:
        """What loads between the nodes of element e add to what it gives them."""
        to = ("between", self._between(e)) if self.order == 1 else ("inner", 0)
        for k in self._loaded(e):
            self._add_load(f"element load {k}", e, to)
            for name in ("force", "moment", *FLAGS):
                self._largest(name, "at_load")

    def _node(self, j: str, turn: str | int) -> None:
        """Balance of node j, and what is computed there for the elements at it."""
        places = {f"> {END}": ("at_end", turn), HOISTED: ("before node", j)}
        self._at_node("node", j, ("at_node", turn), places)

    def _condense(self, e: str) -> None:
        """What element e gives its ends, once its midside node is eliminated."""
        node = self._node_of(e, "m")
        places = {
            "element.inner": ("inner", 0),
            f"own.{OWN}": ("at_node", self._turn(e, "m")),
            "free": ("free", node),
            f"> {BETWEEN}": ("between", self._between(e)),
            f"> {MIDDLE}": ("middle", e),
        }
        call = str, ("at_middle", 0), places
        self._call_held("condense", node, *call, after=lambda: self._keep_rows("at_middle", node))
        for name in self.layout.records["sums"].fields:
            self._largest(name, "at_middle")

    def _keep_rows(self, record: str, node: str) -> None:
        """Where a support holds a node: the node's rows, for the reaction."""
        support = self._support_of(node)
        with self.code.when(self.code.compare("sge", support, 0)):
            for name in ("rows", "asked"):
                self._copy_to(("support", support, name), (record, 0, name))

    def _around(self, node: str) -> Places:
        return (self._near(node) if self.held else {}) | {"push": ("push", node)}

    def _row_kept(self, node: str) -> None:
        self._keep_rows("at_row", node)

    def _row_judged(self, name: str) -> None:
        for size in self.layout.fields("sums"):
            if size in self.functions[name].outputs:
                self._largest(size, "at_row")

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
        self._update_joints(over)

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
        """Which samples take their last step back; of the others, what the next begins from."""
        self._agree()
        self._call_of_sample("search")
        back = self.at("sample", 0, "back")
        for name, last, count in self._unknowns():
            with self.code.loop(0, count) as k:
                self._blend((last, k), (name, k), back)

    def _take_back(self) -> None:
        """Part of the way back, of samples that take it."""
        code = self.code
        forth = self.at("sample", 0, "forth")
        code.call("all", forth, result := code.slot())
        with code.when(code.compare("eq", code.load(result), 0)):
            for name, last, count in self._unknowns():
                with code.loop(0, count) as k:
                    self._part_back(name, last, k)
                    self._blend((name, k), (f"{name}_back", 0), forth)

    def _part_back(self, name: str, last: str, k: str) -> None:
        fields = [*self.layout.fields(name)] if name == "unknown" else ["x"]
        places: Places = {"ratio": ("sample", 0, "ratio")}
        for field in fields:
            own = (field,) if name == "unknown" else ()
            to = f"to_{field}" if name == "unknown" else "to"
            places |= {field: (last, k, *own), to: (name, k, *own)}
            places[f"> {field}"] = (f"{name}_back", 0, *own)
        self._call("between" if name == "unknown" else f"part {name}", places=places)

    def _unknowns(self) -> list[tuple[str, str, str]]:
        """Records of unknowns, of what they were before the last step, and how many there are."""
        args = self.args
        return [
            ("unknown", "last_unknown", args["nodes"]),
            ("stress", "last_stress", args["elements"]),
            *[("joint_unknown", "last_joint_unknown", args["joint_count"])]
            * bool(self.kinds.joints),
        ]

    def _judge(self) -> None:
        self._agree()
        self._call_of_sample("judge")

    def _agree(self) -> None:
        """Of what the cells of a sample are judged by."""
        self._over_cells("largest", self.at("sums"), self._size(("sums", 0)))

    def _call_of_sample(self, name: str) -> None:
        """A function of what is of a sample, whose outputs are, too."""
        self._call(name, lambda f: self._first_of(("sums", "sample"), f), ("judged", 0))
        for output in self.functions[name].outputs:
            to = "common" if output == "secant" else "sample"
            self._copy_to((to, 0, output), ("judged", 0, output))

    def _largest(self, name: str, record: str) -> None:
        """Of what a record has of a sum; of squares the sum itself."""
        if name not in self.layout.fields(record):
            return
        if name in SQUARES:
            self._add(("sums", 0, name), (record, 0, name))
        else:
            self.code.call("largest", self.at("sums", 0, name), self.at(record, 0, name))

    def _least_cosine(self, j: str) -> None:
        """Of the nodes' turns, that of node j among them."""
        cosine, own = self.at("sample", 0, "cosine"), self.at("change", 0, "cosine")
        with self.code.when(self.code.compare("eq", j, 0)):
            self._copy_to(cosine, own, 1)
        self.code.call("least", cosine, own)

    def _finish(self) -> None:
        code, records = self.code, self.layout.records
        with code.loop(0, self.args["nodes"]) as j:
            self._call("cosine", lambda f: self.at("unknown", j, f), ("change", 0))
            self._least_cosine(j)
        self._over_cells("least", self.at("sample", 0, "cosine"))
        places = {
            "before": ("sample", 0, "last_status"),
            "> status": ("sample", 0, "found_status"),
            "> moving": ("sample", 0, "good"),
        }
        own = "common", "sums", "sample"
        self._call("outcome", lambda f: self._first_of(own, f), places=places)
        for name, source in (("last_status", "found_status"), ("moving", "good")):
            self._copy_to(("sample", 0, name), ("sample", 0, source))
        good, work = self.at("sample", 0, "good"), self.at("sample", 0, "work")
        self._begin_work()
        if "energy" in records:
            self._fill(("energy", 0))
        with code.loop(0, self.args["elements"]) as e:
            self._finish_element(e, good)
        self._finish_tendons(good)
        for one in FINISHED:
            self._each_of(one, lambda entry: self._finish_interaction(entry, good), look=True)
        with code.loop(0, self.args["nodes"]) as j:
            self._at_node("finish", j, ("change", 0))
            for name in self.layout.fields("state"):
                self._take(("state", j, name), ("change", 0, name), good)
            counted = self._counted(good, j, "own_nodes")
            self._sum(work, self.at("change", 0, "work"), counted, 1)
            self._add_energies()
        self._over_cells("sum", work)
        if "energy" in records:
            self._project(good)
        self._keep_forces(good)

    def _finish_element(self, e: str, good: str) -> None:
        """Its state at the end, and the work of the loads between its nodes."""
        if "finish element 0" in self.functions:
            self._at_element("finish element", e, ("change", 0))
            for name in self.layout.fields("element_state"):
                self._take(("element_state", e, name), ("change", 0, name), good)
            self._add_energies()
        for k in self._loaded(e):
            self._add_rise(f"finish element load {k}", e)
            self._sum(("sample", 0, "work"), ("change", 0, "work"), good)

    def _begin_work(self) -> None:
        """What there is of it, and what cells share, counts in the lane of the first."""
        if self.cells > 1:
            work, good = self.at("sample", 0, "work"), self.at("sample", 0, "good")
            self.code.call("first cell", work, work)
            self.code.call("first cell", self.at("sample", 0, "counted"), good)

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

    def _project(self, good: str) -> None:
        """Scale the velocities of the step's end."""
        places = {"> scale": ("energy", 0, "scale"), "> defect": ("change", 0, "defect")}
        self._call("project", lambda f: self._first_of(("energy", "sample"), f), places=places)
        self._take(("sample", 0, "defect"), ("change", 0, "defect"), good)
        with self.code.loop(0, self.args["nodes"]) as j:
            places = {"scale": ("energy", 0, "scale")}
            self._call("scaled", lambda f: self.at("state", j, f), ("change", 0), places)
            for name in ("velocity", "spin"):
                self._take(("state", j, name), ("change", 0, name), good)
