"""Native code of tendons: what is other in a structure that has some. The tensions follow from sums
over the stretches of each tendon, from its end to its beginning, and then from its beginning to its
end; after that stretches know nothing of each other but in the matrix, see `tendon_functions`.
The adjoint runs the same loops backwards.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ..compiler.function import Functions
from .interactions import Derivative, all_kinds
from .kinds import Kinds, distinct, same_code
from .layout import ONE, STRETCHES, Layout, cotangents
from .record_code import Place, Places
from .row_code import WHOLE, RowCode
from .tendon_functions import SUMMED, TIE
from .tracing import Tracing

FIRST, LAST = 2, 3  # in an entry of the table
READINGS = 3  # numbers of a tendon in a state
PULL = {"tension": 1, "slope": 1, "ratio": 1, "by_q": 3, "turned": 3}
AT_STRETCH = {**dict.fromkeys(SUMMED, 1), "direction": 3}
Backward = Callable[[str, Callable[[str], Place], Places], None]
BARS = "pull_bar", "at_stretch_bar", "beyond_bar"


def of_tensions(
    traced: Tracing, kinds: Kinds, varying: dict[str, tuple[int, ...]] | None = None
) -> Functions:
    """Functions by which tensions are known, by kind; varying: shapes of what changes with the
    iterations beside the unknowns.
    """
    shapes, functions, of = traced.of(TIE) | (varying or {}), {}, traced.local.of(TIE)
    named = {
        "stretch": of.stretch,
        "tension first": of.tension_first,
        "tension next": of.tension_next,
    }
    for name, function in named.items():
        for k, kind in distinct(all_kinds(kinds, TIE), name.partition(" ")[0]):
            functions[f"{name} {k}"] = traced(partial(function, kind), shapes)
    return functions


def adjoint_of_stretches(traced: Tracing, kinds: Kinds, derivative: Derivative) -> Functions:
    """Functions of the adjoint, by kind."""
    functions = of_tensions(traced, kinds)
    ends = ("own.direction", "last.direction", "last.tension")
    sums = [f"beyond.{name}" for name in SUMMED]
    bars = {"stretch": ["u", "m"], "tension first": sums, "tension next": [*sums, *ends]}
    for name, place in bars.items():
        word = name.partition(" ")[0]
        for k, _ in distinct(all_kinds(kinds, TIE), word):
            whole = functions[f"{name} {k}"]
            of = () if word == "stretch" else ["tension"]
            functions[f"{name} {k} bar"] = derivative(whole, of, place)
    return functions


def record(layout: Layout, kinds: Kinds) -> None:
    """Records of an iteration, and of the adjoint."""
    if not all_kinds(kinds, TIE):
        return
    layout.record("at_stretch", STRETCHES, AT_STRETCH.items())
    layout.record("beyond", STRETCHES, dict.fromkeys(SUMMED, 1).items())
    layout.record("pull", STRETCHES, PULL.items())
    layout.record(TIE.whole, TIE.of, [(TIE.of, READINGS)])


def record_adjoint(layout: Layout, kinds: Kinds) -> None:
    """Records of the adjoint, but for those of constants."""
    if not all_kinds(kinds, TIE):
        return
    record(layout, kinds)
    cotangents(layout, TIE.whole, TIE.of, [(TIE.of, READINGS)])
    layout.record("at_stretch_bar", STRETCHES, AT_STRETCH.items())
    layout.record("beyond_bar", STRETCHES, dict.fromkeys(SUMMED, 1).items())
    layout.record("pull_bar", STRETCHES, [("tension", 1)])
    layout.record("sums_bar", ONE, dict.fromkeys(SUMMED, 1).items())


class Tensions:
    """Tensions of all stretches, and what a state has of tendons."""

    def __init__(self, driver: RowCode) -> None:
        self.driver, self.code = driver, driver.code

    def each(self, then: Callable[[str, list[str]], None], backward: bool = False) -> None:
        """then(stretch, its entry of the table) of each."""
        if all_kinds(self.driver.kinds, TIE):
            with self.driver.entries(TIE.constants, backward) as (s, entry):
                then(s, entry)

    def of_kind(self, s: str, word: str, then: Callable[[int], None]) -> None:
        """then(number of its functions of this word) of stretch s."""
        for k in self.driver.each_kind(TIE, s):
            then(same_code(all_kinds(self.driver.kinds, TIE), k, word))

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
            to = driver.at(TIE.whole, entry[WHOLE], TIE.of)
            tension = driver.at("pull", s, "tension")
            with code.when(code.compare("ne", entry[FIRST], 0)):
                driver.take(to, tension, good, 1)
                driver.take(driver.number(to, 2), driver.at("beyond", s, "length"), good, 1)
            with code.when(code.compare("ne", entry[LAST], 0)):
                driver.take(driver.number(to, 1), tension, good, 1)

        self.each(read)


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
        state = driver.at(f"{TIE.whole}_bar", entry[WHOLE])
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
