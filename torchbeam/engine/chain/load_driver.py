"""Native driver of load stepping: for each group of samples, a lane each, Newton's method
under more and more load.

What is computed is in `SteadyFunctions`; here is only in which order, and where the fields lie.
"""

from __future__ import annotations

from .driver import Driver


class LoadDriver(Driver):
    """Equilibria, each sample at its own pace."""

    AT_NODE = "node", "unknown", "pose"

    def _group(self, first: str) -> None:
        # whether the balance and elimination at hand are of the shape and load at hand
        self.known = self.code.slot()
        self.code.store(0, self.known)
        self._transfer("gather", "input", first, 0)
        self._begin()
        self._climb()
        if "indefinite" in self.layout.records["sums"].fields:
            self._return()
            self._pass()
            self._copy_to(self.at("sample", 0, "indefinite"), self.at("sums", 0, "indefinite"), 1)
        self._transfer("scatter", "output", first, 0)

    def _of_sample(self, field: str) -> str:
        return self.at("common" if field == "load_factor" else "sample", 0, field)

    def _rule(self, name: str) -> None:
        """A function of samples, which changes what it reads."""
        self._call(name, self._of_sample, ("ruled", 0))
        for field in self.functions[name].outputs:
            self._copy_to(self._of_sample(field), self.at("ruled", 0, field), 1)

    def _pass(self) -> None:
        with self.code.when(self.code.compare("eq", self.code.load(self.known), 0)):
            super()._pass()
        self.code.store(0, self.known)

    def _begin(self) -> None:
        """The first step, by the moves that all of the load would bring about; where that is all of
        the load for all samples, Newton's method has its first balance.
        """
        code = self.code
        self._hoisted()
        self._border()
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                self._fill(("support", k, "last"))
        for name in ("reached", "last_status", "turn"):
            self._fill(("sample", 0, name))
        for name in ("load_factor", "over"):
            code.call("opposite", self._of_sample(name), self.at("sample", 0, "reached"))
        self._return()
        self._place()
        self._pass()
        self._back()
        with code.loop(0, self.args["nodes"]) as j:
            self._call("turn", lambda f: self.at("move", self._move_of(j), f), ("change", 0))
            code.call("largest", self.at("sample", 0, "turn"), self.at("change", 0, "turn"))
        self._rule("first_step")
        self._rule("shares")
        code.call("all", self.at("sample", 0, "whole"), self.known)

    def _return(self) -> None:
        """To the last shape that was in balance."""
        with self.code.loop(0, self.args["nodes"]) as j:
            self._copy_to(("unknown", j), ("kept", j))
        with self.code.loop(0, self.args["elements"]) as e:
            self._copy_to(("stress", e), ("start_stress", e))
        self._start_joints()
        self._start_tendons()

    def _place(self) -> None:
        """Supports where they have to be."""
        if not self.held:
            return
        code = self.code
        with code.loop(0, self.args["supports"]) as k:
            node = code.load(code.at(self.args["support_nodes"], k))
            self._at_node("place", node, ("change", 0))
            for name in self.layout.fields("unknown"):
                self._copy_to(("unknown", node, name), ("change", 0, name))

    def _climb(self) -> None:
        code = self.code
        with code.until() as ends:
            self._return()
            self._place()
            self._newton()
            self._turned()
            self._rule("advanced")
            self._keep()
            self._rule("shares")
            code.call("all", self.at("sample", 0, "over"), result := code.slot())
            ends.append(code.compare("ne", code.load(result), 0))

    def _turned(self) -> None:
        """The least cosine of the nodes' turns in a load step."""
        with self.code.loop(0, self.args["nodes"]) as j:
            places = {"before": ("kept", j, "rotation")}
            self._call("cosine", lambda f: self.at("unknown", j, f), ("change", 0), places)
            self._least_cosine(j)

    def _keep(self) -> None:
        """What has gone well."""
        good = self.at("sample", 0, "good")
        with self.code.loop(0, self.args["nodes"]) as j:
            self._take(("kept", j), ("unknown", j), good)
        self._keep_forces(good)
        self._keep_joints(good)
