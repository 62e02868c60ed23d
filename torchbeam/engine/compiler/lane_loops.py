"""Small functions of lanes, in native code: numbers are filled, copied, added, chosen by a mask, a
component at a time; the largest and the least; whether a mask is set in all lanes.
"""

from __future__ import annotations

from .llvm import Lanes
from .loop_text import Code


class LaneLoops:
    """Text of these functions."""

    def __init__(self, lanes: Lanes) -> None:
        self.lanes, self.align = lanes, f"align {lanes.bytes}"
        self.load = "{0} = load " + lanes.vector + ", ptr {1}, " + self.align
        # else what is chosen becomes a masked store, which is slow
        self.volatile = self.load.replace("load", "load volatile")

    def functions(self) -> list[str]:
        lanes, V, load = self.lanes, self.lanes.vector, self.load
        zero, one = lanes.constant(0.0), lanes.constant(1.0)
        # fmt: off
        return [
            self._over("zero", ["to"], f"store {V} {zero}, ptr {{to}}, {self.align}"),
            self._over("copy", ["to", "source"], load.format("%a", "{source}"), self._store("%a")),
            self._chosen("keep", "oeq"), self._chosen("take", "one"),
            self._extreme("largest", "ogt"), self._extreme("least", "olt"),
            self._straight("opposite", load.format("%a", "%source"), f"%r = fsub {V} {one}, %a"),
            self._over("sum", ["to", "source", "mask"], load.format("%m", "%mask"),
                       self.volatile.format("%a", "{to}"), load.format("%b", "{source}"),
                       f"%c = fcmp one {V} %m, {zero}", f"%s = fadd {V} %a, %b",
                       f"%r = select {lanes.truth} %c, {V} %s, {V} %a", self._store("%r")),
            self._over("add", ["to", "source"], load.format("%a", "{to}"),
                       load.format("%b", "{source}"), f"%s = fadd {V} %a, %b", self._store("%s")),
            self._all(),
        ]
        # fmt: on

    def _store(self, value: str) -> str:
        return f"store {self.lanes.vector} {value}, ptr {{to}}, {self.align}"

    def _straight(self, name: str, *lines: str) -> str:
        """Of one component: from that at %source, and at %to, %r, which is put there."""
        lines = (*lines, f"store {self.lanes.vector} %r, ptr %to, {self.align}", "ret void")
        head = f'define internal void @"{name}"(ptr %to, ptr %source) alwaysinline nounwind {{'
        return "\n".join((head, *("  " + x for x in lines), "}"))

    def _over(self, name: str, given: list[str], *lines: str) -> str:
        """A loop over components: {to}, {source} point to those of the given pointers."""
        code = Code(name, [*(f"ptr %{p}" for p in given), "i64 %size"])
        with code.loop(0, "%size") as k:
            places = {
                p: code.at(f"%{p}", k, self.lanes.vector) for p in ("to", "source") if p in given
            }
            for text in lines:
                code.line(text.format(**places))
        return code.text(internal=True).replace(") nounwind", ") alwaysinline nounwind")

    def _chosen(self, name: str, compared: str) -> str:
        V = self.lanes.vector
        return self._over(
            name,
            ["to", "source", "mask"],
            self.load.format("%m", "%mask"),
            self.volatile.format("%a", "{to}"),
            self.load.format("%b", "{source}"),
            f"%c = fcmp {compared} {V} %m, {self.lanes.constant(0.0)}",
            f"%r = select {self.lanes.truth} %c, {V} %b, {V} %a",
            self._store("%r"),
        )

    def _extreme(self, name: str, compared: str) -> str:
        V, T = self.lanes.vector, self.lanes.truth
        return self._straight(
            name,
            self.volatile.format("%a", "%to"),
            self.load.format("%b", "%source"),
            f"%c = fcmp {compared} {V} %a, %b",
            f"%n = fcmp uno {V} %a, %a",
            f"%d = or {T} %c, %n",
            f"%r = select {T} %d, {V} %a, {V} %b",
        )

    def _all(self) -> str:
        each, scalar = Code("all", ["ptr %mask", "ptr %result"]), self.lanes.scalar
        left = each.slot()
        each.store(1, left)
        with each.loop(0, self.lanes.count) as lane:
            one_of = each.load(each.at("%mask", lane, scalar), scalar)
            is_set = each.new(f"fcmp une {scalar} {one_of}, 0.0")
            each.store(each.choose(is_set, each.load(left), 0), left)
        each.store(each.load(left), "%result")
        return each.text(internal=True)
