"""Native adjoint of tendons: the loops of `Tensions.find` backwards; see `tendon_driver`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from .record_code import Place, Places
from .row_code import TENDON, RowCode
from .tendon_driver import FIRST, LAST, Tensions
from .tendon_functions import SUMMED

Backward = Callable[[str, Callable[[str], Place], Places], None]
BARS = "pull_bar", "at_stretch_bar", "beyond_bar"


class TensionBars:
    """Cotangents of tensions, and what these ask of the start and of the moves."""

    def __init__(self, driver: RowCode, tensions: Tensions, backward: Backward) -> None:
        """backward: see `AdjointDriver`."""
        self.driver, self.code, self.tensions = driver, driver.code, tensions
        self.backward = backward

    def clear(self, s: str) -> None:
        """Those of stretch s."""
        for name in BARS:
            self.driver.fill((name, s))

    def read(self, s: str) -> None:
        """Those of stretch s, by those of what a state has of its tendon."""
        driver, code, entry = self.driver, self.code, self.driver.integers("stretch", s)
        self.clear(s)
        state = driver.at("tendon_state_bar", entry[TENDON])
        tension = driver.at("pull_bar", s, "tension")
        with code.when(code.compare("ne", entry[FIRST], 0)):
            driver.add(tension, state, 1)
            driver.add(driver.at("beyond_bar", s, "length"), driver.number(state, 2), 1)
        with code.when(code.compare("ne", entry[LAST], 0)):
            driver.add(tension, driver.number(state, 1), 1)

    def back(self) -> None:
        """From the cotangents of tensions, and of sums."""
        driver, code, size = self.driver, self.code, len(SUMMED)

        def back(s: str, entry: list[str]) -> None:
            ends: Places = {"tension": ("pull_bar", s, "tension")}
            for name, place in (("first", "ne"), ("next", "eq")):
                with code.when(code.compare(place, entry[FIRST], 0)):
                    self._backward(s, "tension", f"tension {name}", ends)

        def forth(s: str, entry: list[str]) -> None:
            sums, own = driver.at("sums_bar"), driver.at("at_stretch_bar", s)
            with code.when(code.compare("ne", entry[FIRST], 0)):
                driver.fill(sums, size)
            driver.add(sums, driver.at("beyond_bar", s), size)
            driver.add(own, sums, size)
            bars = "at_stretch_bar"
            ends: Places = {name: (bars, s, name) for name in driver.layout.fields(bars)}
            self._backward(s, "stretch", "stretch", ends)

        self.tensions.each(back, backward=True)
        self.tensions.each(forth)

    def _backward(self, s: str, word: str, name: str, ends: Places) -> None:
        """The derivative of a function of stretch s."""
        of = partial(self.driver.of_stretch, s=s)
        self.tensions.of_kind(s, word, lambda k: self.backward(f"{name} {k} bar", of, ends))
