"""Native driver of load stepping: for each group of samples, a lane each, Newton's method on a
chain under more and more load.

What is computed is in `SteadyFunctions`; here is only in which order, and where the fields lie.
"""

from __future__ import annotations

from .chain_code import ChainCode
from .driver import Driver
from .structure_code import COUNTS, TABLES
from .structure_driver import StructurePasses


class LoadSteps(ChainCode):
    """Equilibria, each sample at its own pace, by the passes of another class."""

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

    def _of_node(self, field: str, j: str) -> str:
        for record in ("node", "unknown", "pose"):
            if field in self.layout.records[record].fields:
                return self.at(record, j, field)
        return self.at("common", 0, field)

    def _of_sample(self, field: str) -> str:
        return self.at("common" if field == "load_factor" else "sample", 0, field)

    def _rule(self, name: str) -> None:
        """A function of samples, which changes what it reads."""
        self._call(
            name, lambda f: self.at("ruled", 0, f[2:]) if f[0] == ">" else self._of_sample(f)
        )
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
                self._fill(
                    self.at("support", k, "last"), self.layout.records["support"].fields["last"][1]
                )
        for name in ("reached", "last_status", "turn"):
            self._fill(self.at("sample", 0, name), 1)
        for name in ("load_factor", "over"):
            code.call("opposite", self._of_sample(name), self.at("sample", 0, "reached"))
        self._return()
        self._place()
        self._pass()
        self._back()
        with code.loop(0, self.args["nodes"]) as j:
            self._call(
                "turn",
                lambda f: (
                    self.at("change", 0, "turn")
                    if f[0] == ">"
                    else self.at("move", self._move_of(j), f)
                ),
            )
            code.call("largest", self.at("sample", 0, "turn"), self.at("change", 0, "turn"))
        self._rule("first_step")
        self._rule("shares")
        code.call("all", self.at("sample", 0, "whole"), self.known)

    def _return(self) -> None:
        """To the last shape that was in balance."""
        code, N = self.code, self.args["elements"]
        size = self.layout.records["unknown"].size
        with code.loop(0, self.args["nodes"]) as j:
            self._copy_to(self.at("unknown", j), self.at("kept", j), size)
        with code.loop(0, N) as e:
            self._copy_to(
                self.at("stress", e), self.at("start_stress", e), self.layout.records["stress"].size
            )
        self._start_joints()

    def _place(self) -> None:
        """Supports where they have to be."""
        if not self.held:
            return
        code = self.code
        with code.loop(0, self.args["supports"]) as k:
            node = code.load(code.at(self.args["support_nodes"], k))
            with self._kind(node) as kinds:
                for kind in kinds:
                    if f"place {kind}" in self.functions:
                        self._call(
                            f"place {kind}",
                            lambda f: (
                                self.at("change", 0, f[2:])
                                if f[0] == ">"
                                else self._of_node(f, node)
                            ),
                        )
            for name, (_, size) in self.layout.records["unknown"].fields.items():
                self._copy_to(self.at("unknown", node, name), self.at("change", 0, name), size)

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
        code, cosine = self.code, self.at("sample", 0, "cosine")
        with code.loop(0, self.args["nodes"]) as j:
            self._call(
                "cosine",
                lambda f: (
                    self.at("change", 0, "cosine")
                    if f[0] == ">"
                    else self.at("kept", j, "rotation")
                    if f == "before"
                    else self.at("unknown", j, f)
                ),
            )
            with code.when(code.compare("eq", j, 0)):
                self._copy_to(cosine, self.at("change", 0, "cosine"), 1)
            code.call("least", cosine, self.at("change", 0, "cosine"))

    def _keep(self) -> None:
        """What has gone well."""
        code, records = self.code, self.layout.records
        good = self.at("sample", 0, "good")
        with code.loop(0, self.args["nodes"]) as j:
            self._take(self.at("kept", j), self.at("unknown", j), good, records["unknown"].size)
        self._keep_forces(good)
        self._keep_joints(good)


class LoadDriver(LoadSteps, Driver):
    """Of a chain."""


class StructureLoadDriver(LoadSteps, StructurePasses, Driver):
    """Of a structure."""

    ARGS = (*Driver.ARGS, *TABLES, *COUNTS)
