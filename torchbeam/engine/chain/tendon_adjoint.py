"""Native adjoint of tendons: the loops of `TendonCode._tensions` backwards; see `tendon_driver`."""

from __future__ import annotations

from functools import partial

from .driver_code import Places
from .interaction import TIE
from .interaction_adjoint import InteractionAdjoint
from .interaction_driver import Entry
from .tendon_driver import FIRST, LAST, TENDON, TendonCode
from .tendon_functions import SUMMED

BARS = "pull_bar", "at_stretch_bar", "beyond_bar"


class TendonAdjoint(TendonCode, InteractionAdjoint):
    """Cotangents of tendons' states and constants, and of what they do to nodes."""

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
            state, tension = (
                self.at("tendon_state_bar", entry[TENDON]),
                self.at("pull_bar", s, "tension"),
            )
            with code.when(code.compare("ne", entry[FIRST], 0)):
                self._add(tension, state, 1)
                self._add(self.at("beyond_bar", s, "length"), self._number(state, 2), 1)
            with code.when(code.compare("ne", entry[LAST], 0)):
                self._add(tension, self._number(state, 1), 1)
            self._back_to_stretch("tendon work bar", s, self._made("tendon_state", entry[TENDON]))

        self._stretches(read)
        self._tension_bars()

    def _tendon_energies(self) -> None:
        """To what the energy rises by: less the work of tendons."""
        self._stretches(lambda s, entry: self._work("ended tendon", s))

    def _tie_bars(self) -> None:
        """What the solution asks of the start and of the constants."""

        def bars(entry: Entry) -> None:
            self._clear_stretch(entry.number)
            self._bars_of(f"tie bar {entry.function}", entry, self._pushed_bars(entry))

        self._each_of(TIE, bars)
        self._tension_bars()

    def _tension_bars(self) -> None:
        """From the cotangents of tensions, and of sums."""
        if not self.kinds.stretches:
            return
        code, size = self.code, len(SUMMED)

        def back(s: str, entry: list[str]) -> None:
            ends: Places = {"tension": ("pull_bar", s, "tension")}
            for name, place in (("first", "ne"), ("next", "eq")):
                with code.when(code.compare(place, entry[FIRST], 0)):
                    self._of_kind(
                        s,
                        "tension",
                        lambda k, n=name: self._back_to_stretch(f"tension {n} {k} bar", s, ends),
                    )

        def forth(s: str, entry: list[str]) -> None:
            sums, own = self.at("sums_bar"), self.at("at_stretch_bar", s)
            with code.when(code.compare("ne", entry[FIRST], 0)):
                self._fill(sums, size)
            self._add(sums, self.at("beyond_bar", s), size)
            self._add(own, sums, size)
            bars = "at_stretch_bar"
            ends: Places = {name: (bars, s, name) for name in self.layout.fields(bars)}
            self._of_kind(
                s, "stretch", lambda k: self._back_to_stretch(f"stretch {k} bar", s, ends)
            )

        self._stretches(back, backward=True)
        self._stretches(forth)

    def _back_to_stretch(self, name: str, s: str, ends: Places) -> None:
        self._backward(name, partial(self._of_stretch, s=s), ends)
