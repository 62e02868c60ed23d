"""Native code of tendons: what is other in a structure that has some. The tensions follow from sums
over the stretches of each tendon, from its end to its beginning, and then from its beginning to its
end; after that stretches know nothing of each other but in the matrix, see `tendon_functions`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from .node_kinds import alike
from .record_code import Place
from .row_code import TENDON, RowCode
from .sorts import TIE
from .tendon_functions import SUMMED

FIRST, LAST = 2, 3  # in an entry of the table


class Tensions:
    """Tensions of all stretches, and what a state has of tendons."""

    def __init__(self, driver: RowCode) -> None:
        self.driver, self.code = driver, driver.code

    def each(self, then: Callable[[str, list[str]], None], backward: bool = False) -> None:
        """then(stretch, its entry of the table) of each."""
        if self.driver.kinds.stretches:
            with self.driver.entries(TIE.constants, backward) as (s, entry):
                then(s, entry)

    def of_kind(self, s: str, word: str, then: Callable[[int], None]) -> None:
        """then(number of its functions of this word) of stretch s."""
        for k in self.driver.each_kind(TIE, s):
            then(alike(self.driver.kinds.stretches, k, word))

    def find(self) -> None:
        """By the unknowns."""
        driver, code, size = self.driver, self.code, len(SUMMED)

        def sums(s: str, entry: list[str]) -> None:
            put = partial(self._put, s=s)
            self.of_kind(s, "stretch", lambda k: driver.call(f"stretch {k}", put))
            driver.fill(("pull", s))
            driver.copy(driver.at("beyond", s), driver.at("at_stretch", s), size)
            with code.when(code.compare("eq", entry[LAST], 0)):
                driver.add(driver.at("beyond", s), driver.at("beyond", code.add(s, 1)), size)

        def tension(s: str, entry: list[str], k: int) -> None:
            before, put = code.sub(s, 1), partial(self._put, s=s)
            with code.when(code.compare("ne", entry[FIRST], 0)):
                driver.call(f"tension first {k}", put)
            with code.when(code.compare("eq", entry[FIRST], 0)):
                driver.call(
                    f"tension next {k}", lambda f: self._put(f, before if f == "> turned" else s)
                )

        self.each(sums, backward=True)
        self.each(lambda s, entry: self.of_kind(s, "tension", lambda k: tension(s, entry, k)))

    def _put(self, field: str, s: str) -> Place:
        of = self.driver
        return of.of_pull(field[2:], s) if field[0] == ">" else of.of_stretch(field, s)

    def read(self, good: str) -> None:
        """What a state has of them, of what has gone well."""
        driver, code = self.driver, self.code

        def read(s: str, entry: list[str]) -> None:
            to = driver.at("tendon_state", entry[TENDON], "tendons")
            tension = driver.at("pull", s, "tension")
            with code.when(code.compare("ne", entry[FIRST], 0)):
                driver.take(to, tension, good, 1)
                driver.take(driver.number(to, 2), driver.at("beyond", s, "length"), good, 1)
            with code.when(code.compare("ne", entry[LAST], 0)):
                driver.take(driver.number(to, 1), tension, good, 1)

        self.each(read)
