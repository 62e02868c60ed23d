"""Slots of what is at rest, see `driver`: equilibria under more and more load, and the points of a
path. What is computed is in `SteadyFunctions` and `PathFunctions`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from .driver import Slots
from .sorts import NODE

PIVOT = "pivot"


class RestSlots(Slots):
    """A shape that is kept, and supports that have a place."""

    def begin(self) -> None:
        """From the last shape that was in balance, supports where they have to be."""
        driver = self.driver
        self._return()
        if not driver.held:
            return
        with self.code.loop(0, driver.args["supports"]) as k:
            node = driver.integer("support_nodes", k)
            driver.call_of("place", NODE.at(node), "change")
            for name in driver.layout.fields("unknown"):
                driver.copy(("unknown", node, name), ("change", 0, name))

    def _return(self) -> None:
        """To the last shape that was in balance."""
        driver = self.driver
        with self.code.loop(0, driver.args["nodes"]) as j:
            driver.copy(("unknown", j), ("kept", j))
        driver.start()


class LoadSlots(RestSlots):
    """Equilibria, each sample at its own pace."""

    @contextmanager
    def points(self, first: str) -> Iterator[None]:
        """Shares of the load, until all samples have all of it, or failed."""
        code, driver = self.code, self.driver
        # whether the balance and elimination at hand are of the shape and load at hand
        self.known = code.slot()
        code.store(0, self.known)
        driver.transfer("gather", "input", first, 0)
        self._first_share()
        with code.until() as ends:
            yield
            self._rule("shares")
            code.call("all", driver.at("sample", 0, "over"), result := code.slot())
            ends.append(code.compare("ne", code.load(result), 0))
        if "indefinite" in driver.layout.records["sums"].fields:
            self._return()
            driver.balance()
            indefinite = (driver.at(record, 0, "indefinite") for record in ("sample", "sums"))
            driver.copy(*indefinite, 1)
        driver.transfer("scatter", "output", first, 0)

    def _of_sample(self, field: str) -> str:
        of_all = "load_factor", "smallest"
        return self.driver.at("common" if field in of_all else "sample", 0, field)

    def _rule(self, name: str) -> None:
        """A function of samples, which changes what it reads."""
        driver = self.driver
        driver.call(name, self._of_sample, ("change", 0))
        for field in driver.functions[name].outputs:
            driver.copy(self._of_sample(field), driver.at("change", 0, field), 1)

    def balance(self, then: Callable[[], None]) -> None:
        with self.code.when(self.code.compare("eq", self.code.load(self.known), 0)):
            then()
        self.code.store(0, self.known)

    def _first_share(self) -> None:
        """The first step, by the moves that all of the load would bring about; where that is all of
        the load for all samples, Newton's method has its first balance.
        """
        code, driver = self.code, self.driver
        driver.hoisted()
        driver.border()
        if driver.held:
            with code.loop(0, driver.args["supports"]) as k:
                driver.fill(("support", k, "last"))
        for name in ("reached", "last_status", "turn"):
            driver.fill(("sample", 0, name))
        for name in ("load_factor", "over"):
            code.call("opposite", self._of_sample(name), driver.at("sample", 0, "reached"))
        self.begin()
        driver.balance()
        driver.back()
        with code.loop(0, driver.args["nodes"]) as j:
            places = {name: ("pose", j, name) for name in driver.functions["turn"].inputs}
            places |= {"move": ("move", driver.move_of(j)), "rotation": ("kept", j, "rotation")}
            driver.call("turn", to=("change", 0), places=places)
            code.call("largest", driver.at("sample", 0, "turn"), driver.at("change", 0, "turn"))
        self._rule("first_step")
        self._rule("shares")
        code.call("all", driver.at("sample", 0, "whole"), self.known)

    def finish(self) -> None:
        """The least cosine of the nodes' turns in a load step, and what has gone well."""
        driver = self.driver
        with self.code.loop(0, driver.args["nodes"]) as j:
            places = {"before": ("kept", j, "rotation")}
            driver.call("cosine", lambda f: driver.at("unknown", j, f), ("change", 0), places)
            driver.least_cosine(j)
        self._rule("advanced")
        good = driver.at("sample", 0, "good")
        with self.code.loop(0, driver.args["nodes"]) as j:
            driver.take(("kept", j), ("unknown", j), good)
        driver.keep_forces(good)
        driver.each_multiplier(
            lambda k: driver.take(("multiplier_state", k, "last_force"), ("multiplier", k), good)
        )


class PathSlots(RestSlots):
    """Points of a path: two of them, in the first of which `slope` is 0, in the second 1."""

    def begin(self) -> None:
        self.driver.fill(("sample", 0, "over"))
        super().begin()
        self.driver.hoisted()
        self.driver.border()

    def iterate(self) -> None:
        self.driver.balance()
        self.driver.judge()

    def finish(self) -> None:
        """The changes that are asked for: those of stresses and forces from zero."""
        with self.code.loop(0, self.driver.args["elements"]) as e:
            self.driver.fill(("stress", e))
        self.driver.zeros_in("multiplier")
        self.driver.back()

    def condensed(self, e: str) -> None:
        if "middle pivot" in self.driver.layout.records:
            self.driver.copy(("middle pivot", e), ("change", 0, PIVOT))
