"""Native adjoint of tendons: the loops of `TendonCode._tensions` backwards; see `tendon_driver`."""

from __future__ import annotations

from ..compiler.derivative import bar
from .interaction import TIE
from .interaction_adjoint import InteractionAdjoint
from .interaction_driver import Entry
from .node_kinds import SIDES
from .tendon_driver import FIRST, LAST, TENDON, TendonCode
from .tendon_functions import SUMMED

STATE = "tendon_state_bar"
BARS = "pull_bar", "at_stretch_bar", "beyond_bar"


class TendonAdjoint(TendonCode, InteractionAdjoint):
    """Cotangents of tendons' states and constants, and of what they do to nodes."""

    def _clear_tendons(self) -> None:
        self._fill_tendons(STATE)

    def _add_tendons(self) -> None:
        """To the cotangents of tendons' states those of what a step has made."""
        self._fill_tendons("tendon_start_bar")

        def add(s: str, entry: list[str]) -> None:
            k, size = entry[TENDON], self.layout.records[STATE].size
            with self.code.when(self.code.compare("ne", entry[FIRST], 0)):
                self._add(self.at(STATE, k), self.at("tendon_state_grad", k), size)

        self._stretches(add)

    def _take_tendons(self, good: str) -> None:
        """Cotangents of their states at the start, of what has gone well."""

        def take(s: str, entry: list[str]) -> None:
            k, size = entry[TENDON], self.layout.records[STATE].size
            self._take(self.at(STATE, k), self.at("tendon_start_bar", k), good, size)

        self._stretches(take)

    def _fill_tendons(self, record: str) -> None:
        def fill(s: str, entry: list[str]) -> None:
            self._fill(self.at(record, entry[TENDON]), self.layout.records[record].size)

        self._stretches(fill)

    def _clear_stretch(self, s: str) -> None:
        for name in BARS:
            self._fill(self.at(name, s), self.layout.records[name].size)

    def _tendon_ends(self) -> None:
        """What the cotangents of readings and of the work ask of the start, and of the moves."""
        if not self.kinds.stretches:
            return
        code = self.code

        def read(s: str, entry: list[str]) -> None:
            self._clear_stretch(s)
            state, tension = self.at(STATE, entry[TENDON]), self.at("pull_bar", s, "tension")
            with code.when(code.compare("ne", entry[FIRST], 0)):
                self._add(tension, state, 1)
                self._add(self.at("beyond_bar", s, "length"), self._number(state, 2), 1)
            with code.when(code.compare("ne", entry[LAST], 0)):
                self._add(tension, self._number(state, 1), 1)
            places = {bar("work"): self.at("sample", 0, "work_bar")}
            if "energy" in self.layout.records:
                places[bar("rise")] = self.at("energy", 0, bar("rise"))
            places["start"] = self.at("tendon_state", entry[TENDON], "tendons")
            self._bar("tendon work bar", s, places, True)

        self._stretches(read)
        self._tension_bars(moves=True)

    def _tendon_energies(self) -> None:
        """To what the energy rises by: less the work of tendons."""
        self._stretches(lambda s, entry: self._work("ended tendon", "change", s, entry))

    def _tie_bars(self) -> None:
        """What the solution asks of the start and of the constants."""

        def bars(entry: Entry) -> None:
            self._clear_stretch(entry.number)
            places = self._pushed_bars(entry)
            self._bar(f"tie bar {entry.function}", entry.number, places, False)

        self._each_of(TIE, bars)
        self._tension_bars(moves=False)

    def _tension_bars(self, moves: bool) -> None:
        """From the cotangents of tensions, and of sums; moves: whether those of the step's moves
        are asked for.
        """
        if not self.kinds.stretches:
            return
        code, size = self.code, len(SUMMED)
        tension = bar("tension")

        def back(s: str, entry: list[str]) -> None:
            places = {tension: self.at("pull_bar", s, "tension")}
            for name, place in (("first", "ne"), ("next", "eq")):
                with code.when(code.compare(place, entry[FIRST], 0)):
                    self._of_kind(
                        s,
                        "tension",
                        lambda k, n=name: self._bar(f"tension {n} {k} bar", s, places, moves),
                    )

        def forth(s: str, entry: list[str]) -> None:
            sums, own = self.at("sums_bar"), self.at("at_stretch_bar", s)
            with code.when(code.compare("ne", entry[FIRST], 0)):
                self._fill(sums, size)
            self._add(sums, self.at("beyond_bar", s), size)
            self._add(own, sums, size)
            places = {
                bar(name): self.at("at_stretch_bar", s, name)
                for name in self.layout.fields("at_stretch_bar")
            }
            self._of_kind(s, "stretch", lambda k: self._bar(f"stretch {k} bar", s, places, moves))

        self._stretches(back, backward=True)
        self._stretches(forth)

    def _bar(self, name: str, s: str, places: dict[str, str], moves: bool) -> None:
        """A derivative of stretch s, with cotangents at `places`, and what it gives added to
        those of where its fields are.
        """

        def where(f: str) -> str:
            if f[0] == ">":
                return self.at("of tie", 0, f[2:])
            return places[f] if f in places else self._of_stretch(f, s)

        self._call(name, where)
        for out in self.functions[name].outputs:
            to, size = self._cotangent(out.removesuffix("_bar"), s, moves)
            source = self.at("of tie", 0, out)
            if size is None:
                self._add(to, source, self.layout.fields("of tie")[out][1])
            elif size:
                self._sum(to, source, self.at("sample", 0, "good"), size)

    def _cotangent(self, field: str, s: str, moves: bool) -> tuple[str, int | None]:
        """Where the cotangent of a field of stretch s is added up, and how many components it has:
        0 where nobody asks for it, None where it is of this step.
        """
        records, (side, _, own), at = self.layout.records, field.partition("."), s
        if side == "beyond":
            return self.at("beyond_bar", s, own), None
        if side in ("own", "last") or field in ("tension", "change"):
            at = self.code.sub(s, 1) if side == "last" else s
            own = own or field
            return self.at("pull_bar" if own == "tension" else "at_stretch_bar", at, own), None
        if field == "start":
            tendon = self._integers("stretch", s)[TENDON]
            return self.at("tendon_start_bar", tendon), 1
        if side not in SIDES[1]:
            record, at = f"{side}_bar", 0 if side == "common" else s
        else:
            place = self._node_bar(own, self._stretch_node(s, side))
            if place is None or (place[0] == "unknown_bar" and not moves):
                return "", 0
            return self.at(*place), self._size(place)
        if field not in records[record].fields:
            return "", 0
        return self.at(record, at, field), records[record].fields[field][1]
