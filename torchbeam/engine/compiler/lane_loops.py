"""Small functions of lanes, in native code: numbers are filled, copied, added, chosen by a mask, a
component at a time; the largest and the least; whether a mask is set in all lanes.
"""

from __future__ import annotations

from .llvm import Lanes
from .loop_text import Code


def lane_loops(lanes: Lanes) -> list[str]:
    """Text of these functions."""
    V, T, scalar, W = lanes.vector, lanes.truth, lanes.scalar, lanes.count
    zero, one, align = lanes.constant(0.0), lanes.constant(1.0), f"align {lanes.bytes}"
    load = "{0} = load " + V + ", ptr {1}, " + align
    # else what is chosen becomes a masked store, which is slow
    volatile = load.replace("load", "load volatile")

    def straight(name: str, given: str, *lines: str) -> str:
        return "\n".join(
            (
                f'define internal void @"{name}"({given}) alwaysinline nounwind {{',
                *("  " + x for x in lines),
                "  ret void",
                "}",
            )
        )

    def over(name: str, given: list[str], *lines: str) -> str:
        """A loop over components: %0, %1 ... point to those of the given pointers."""
        code = Code(name, [*(f"ptr %{p}" for p in given), "i64 %size"])
        with code.loop(0, "%size") as k:
            places = {p: code.at(f"%{p}", k, V) for p in ("to", "source") if p in given}
            for text in lines:
                code.line(text.format(**places))
        return (
            code.text()
            .replace("define void", "define internal void")
            .replace(") nounwind", ") alwaysinline nounwind")
        )

    def chosen(name: str, compared: str) -> str:
        return over(
            name,
            ["to", "source", "mask"],
            load.format("%m", "%mask"),
            volatile.format("%a", "{to}"),
            load.format("%b", "{source}"),
            f"%c = fcmp {compared} {V} %m, {zero}",
            f"%r = select {T} %c, {V} %b, {V} %a",
            f"store {V} %r, ptr {{to}}, {align}",
        )

    def extreme(name: str, compared: str) -> str:
        return straight(
            name,
            "ptr %to, ptr %source",
            volatile.format("%a", "%to"),
            load.format("%b", "%source"),
            f"%c = fcmp {compared} {V} %a, %b",
            f"%n = fcmp uno {V} %a, %a",
            f"%d = or {T} %c, %n",
            f"%r = select {T} %d, {V} %a, {V} %b",
            f"store {V} %r, ptr %to, {align}",
        )

    each = Code("all", ["ptr %mask", "ptr %result"])
    left = each.slot()
    each.store(1, left)
    with each.loop(0, W) as lane:
        one_of = each.load(each.at("%mask", lane, scalar), scalar)
        each.store(
            each.choose(each.new(f"fcmp une {scalar} {one_of}, 0.0"), each.load(left), 0), left
        )
    each.store(each.load(left), "%result")
    # fmt: off
    return [
        over("zero", ["to"], f"store {V} {zero}, ptr {{to}}, {align}"),
        over("copy", ["to", "source"], load.format("%a", "{source}"),
             f"store {V} %a, ptr {{to}}, {align}"),
        chosen("keep", "oeq"), chosen("take", "one"), extreme("largest", "ogt"),
        extreme("least", "olt"),
        straight("opposite", "ptr %to, ptr %source", load.format("%a", "%source"),
                 f"%r = fsub {V} {one}, %a",
                 f"store {V} %r, ptr %to, {align}"),
        over("sum", ["to", "source", "mask"], load.format("%m", "%mask"),
             volatile.format("%a", "{to}"),
             load.format("%b", "{source}"), f"%c = fcmp one {V} %m, {zero}",
             f"%s = fadd {V} %a, %b",
             f"%r = select {T} %c, {V} %s, {V} %a", f"store {V} %r, ptr {{to}}, {align}"),
        over("add", ["to", "source"], load.format("%a", "{to}"), load.format("%b", "{source}"),
             f"%s = fadd {V} %a, %b", f"store {V} %s, ptr {{to}}, {align}"),
        each.text().replace("define void", "define internal void"),
    ]
    # fmt: on
