"""Native drivers of what is at rest, see `driver`: equilibria under more and more load, and the
points of a path. What is computed is in `SteadyFunctions` and `PathFunctions`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from .driver import Driver

PIVOT = "pivot"


class RestDriver(Driver):
    """A shape that is kept, and supports that have a place."""

    AT_NODE = "node", "unknown", "pose"

    def _begin(self) -> None:
        """From the last shape that was in balance, supports where they have to be."""
        self._return()
        if not self.held:
            return
        code = self.code
        with code.loop(0, self.args["supports"]) as k:
            node = code.load(code.at(self.args["support_nodes"], k))
            self._at_node("place", node, ("change", 0))
            for name in self.layout.fields("unknown"):
                self._copy_to(("unknown", node, name), ("change", 0, name))

    def _return(self) -> None:
        """To the last shape that was in balance."""
        with self.code.loop(0, self.args["nodes"]) as j:
            self._copy_to(("unknown", j), ("kept", j))
        self._start()


class LoadDriver(RestDriver):
    """Equilibria, each sample at its own pace."""

    @contextmanager
    def _points(self, first: str) -> Iterator[None]:
        """Shares of the load, until all samples have all of it, or failed."""
        code = self.code
        # whether the balance and elimination at hand are of the shape and load at hand
        self.known = code.slot()
        code.store(0, self.known)
        self._transfer("gather", "input", first, 0)
        self._first_share()
        with code.until() as ends:
            yield
            self._rule("shares")
            code.call("all", self.at("sample", 0, "over"), result := code.slot())
            ends.append(code.compare("ne", code.load(result), 0))
        if "indefinite" in self.layout.records["sums"].fields:
            self._return()
            self._pass()
            self._copy_to(self.at("sample", 0, "indefinite"), self.at("sums", 0, "indefinite"), 1)
        self._transfer("scatter", "output", first, 0)

    def _of_sample(self, field: str) -> str:
        return self.at("common" if field == "load_factor" else "sample", 0, field)

    def _rule(self, name: str) -> None:
        """A function of samples, which changes what it reads."""
        self._call(name, self._of_sample, ("change", 0))
        for field in self.functions[name].outputs:
            self._copy_to(self._of_sample(field), self.at("change", 0, field), 1)

    def _pass(self) -> None:
        with self.code.when(self.code.compare("eq", self.code.load(self.known), 0)):
            super()._pass()
        self.code.store(0, self.known)

    def _first_share(self) -> None:
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
        self._begin()
        self._pass()
        self._back()
        with code.loop(0, self.args["nodes"]) as j:
            places = {name: ("pose", j, name) for name in self.functions["turn"].inputs}
            places |= {"move": ("move", self._move_of(j)), "rotation": ("kept", j, "rotation")}
            self._call("turn", to=("change", 0), places=places)
            code.call("largest", self.at("sample", 0, "turn"), self.at("change", 0, "turn"))
        self._rule("first_step")
        self._rule("shares")
        code.call("all", self.at("sample", 0, "whole"), self.known)

    def _finish(self) -> None:
        """The least cosine of the nodes' turns in a load step, and what has gone well."""
        with self.code.loop(0, self.args["nodes"]) as j:
            places = {"before": ("kept", j, "rotation")}
            self._call("cosine", lambda f: self.at("unknown", j, f), ("change", 0), places)
            self._least_cosine(j)
        self._rule("advanced")
        good = self.at("sample", 0, "good")
        with self.code.loop(0, self.args["nodes"]) as j:
            self._take(("kept", j), ("unknown", j), good)
        self._keep_forces(good)
        self._keep_multipliers(good)


class PathDriver(RestDriver):
    """Points of a path: two of them, in the first of which `slope` is 0, in the second 1."""

    def _begin(self) -> None:
        self._fill(("sample", 0, "over"))
        super()._begin()
        self._hoisted()
        self._border()

    def _iterate(self) -> None:
        self._pass()
        self._judge()

    def _finish(self) -> None:
        """The changes that are asked for: those of stresses and forces from zero."""
        with self.code.loop(0, self.args["elements"]) as e:
            self._fill(("stress", e))
        self._zeros_in("multiplier")
        self._back()

    def _condensed(self, e: str) -> None:
        super()._condensed(e)
        if "middle pivot" in self.layout.records:
            self._copy_to(("middle pivot", e), ("change", 0, PIVOT))
