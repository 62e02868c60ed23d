"""Native adjoint of tendons: the loops of `TendonCode._tensions` backwards; see `tendon_driver`."""

from __future__ import annotations

from ..compiler.derivative import bar
from .driver_code import Place, Places
from .interaction import SIDES, TIE
from .interaction_adjoint import InteractionAdjoint
from .interaction_driver import Entry
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
            with self.code.when(self.code.compare("ne", entry[FIRST], 0)):
                self._add((STATE, entry[TENDON]), ("tendon_state_grad", entry[TENDON]))

        self._stretches(add)

    def _take_tendons(self, good: str) -> None:
        """Cotangents of their states at the start, of what has gone well."""

        self._stretches(
            lambda s, entry: self._take(
                (STATE, entry[TENDON]), ("tendon_start_bar", entry[TENDON]), good
            )
        )

    def _fill_tendons(self, record: str) -> None:
        self._stretches(lambda s, entry: self._fill((record, entry[TENDON])))

    def _clear_stretch(self, s: str) -> None:
        for name in BARS:
            self._fill((name, s))

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
            places = {
                bar("work"): ("sample", 0, bar("work")),
                bar("rise"): ("energy", 0, bar("rise")),
                "start": ("tendon_state", entry[TENDON], "tendons"),
            }
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
            self._bar(f"tie bar {entry.function}", entry.number, self._pushed_bars(entry), False)

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
            places = {tension: ("pull_bar", s, "tension")}
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
                bar(name): ("at_stretch_bar", s, name)
                for name in self.layout.fields("at_stretch_bar")
            }
            self._of_kind(s, "stretch", lambda k: self._bar(f"stretch {k} bar", s, places, moves))

        self._stretches(back, backward=True)
        self._stretches(forth)

    def _bar(self, name: str, s: str, places: Places, moves: bool) -> None:
        """A derivative of stretch s, with cotangents at `places`, and what it gives added to
        those of where its fields are: of this step, or of all.
        """
        self._call(name, lambda f: self._of_stretch(f, s), ("of tie", 0), places)
        for out in self.functions[name].outputs:
            field, source = out.removesuffix("_bar"), ("of tie", 0, out)
            if own := self._of_this_step(field, s):
                self._add(own, source)
            elif place := self._cotangent(field, s, moves):
                size = 1 if field == "start" else None  # the first number of what a tendon has
                self._sum(place, source, self.at("sample", 0, "good"), size)

    def _of_this_step(self, field: str, s: str) -> Place | None:
        """Where the cotangent of a tension, or of what it is made from, is added up."""
        side, _, own = field.partition(".")
        if side == "beyond":
            return "beyond_bar", s, own
        if side not in ("own", "last") and field not in ("tension", "change"):
            return None
        at, own = self.code.sub(s, 1) if side == "last" else s, own or field
        return "pull_bar" if own == "tension" else "at_stretch_bar", at, own

    def _cotangent(self, field: str, s: str, moves: bool) -> Place | None:
        """Of another field; None where nobody asks for it."""
        side, _, own = field.partition(".")
        if field == "start":
            return "tendon_start_bar", self._integers("stretch", s)[TENDON]
        if side not in SIDES[1]:
            return self._bar_place(field, s)
        if own in ("u", "m") and not moves:
            return None
        return self._bar_place(own, self._stretch_node(s, side))
