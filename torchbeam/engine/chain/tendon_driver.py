"""Native driver of tendons: what is other in a structure that has some. The tensions follow from
sums over the stretches of each tendon, from its end to its beginning, and then from its beginning
to its end; after that stretches know nothing of each other but in the matrix, see
`tendon_functions`.
"""

from __future__ import annotations

from collections.abc import Callable

from .driver_code import Place
from .interaction import SIDES, TIE
from .interaction_driver import Entry, InteractionCode
from .node_kinds import alike
from .tendon_functions import SUMMED

FIRST, LAST, TENDON = 2, 3, 4  # in an entry of the table


class TendonCode(InteractionCode):
    """Where the fields of stretches lie, and loops over them; tensions, and what a state has of
    tendons.
    """

    def _each_stretch(self, word: str, then: Callable[[str, list[str], int], None]) -> None:
        """then(stretch, its entry of the table, the number of its functions of this word) of
        each.
        """
        self._stretches(lambda s, entry: self._of_kind(s, word, lambda k: then(s, entry, k)))

    def _stretches(self, then: Callable[[str, list[str]], None], backward: bool = False) -> None:
        """then(stretch, its entry of the table) of each."""
        if not self.kinds.stretches:
            return
        code = self.code
        last = code.sub(self.args["stretch_count"], 1)
        begin, end, step = (last, -1, -1) if backward else (0, code.add(last, 1), 1)
        with code.loop(begin, end, step) as s:
            then(s, self._integers("stretch", s))

    def _of_kind(self, s: str, word: str, then: Callable[[int], None]) -> None:
        with self._each("stretch_kinds", len(self.kinds.stretches), s) as kinds:
            for k in kinds:
                then(alike(self.kinds.stretches, k, word))

    def _of_interaction(self, field: str, entry: Entry) -> Place:
        if entry.of is TIE:
            return self._of_stretch(field, entry.number)
        return super()._of_interaction(field, entry)

    def _of_stretch(self, field: str, s: str) -> Place:
        """A field that is held by stretch s, at one of its ends, by what lies beyond, by the
        stretch before, or by all.
        """
        side, _, name = field.partition(".")
        if side in SIDES[1]:
            return self._at_end_node(name, self._stretch_node(s, side))
        if side in ("own", "last"):
            return self._of_pull(name, s if side == "own" else self.code.sub(s, 1))
        if side == "beyond":
            return "beyond", s, name
        if field == "start":
            return "tendon_state", self._integers("stretch", s)[TENDON], "tendons"
        return self._first_of((*TIE.state, TIE.constants, "tie blocks"), field, s)

    def _of_pull(self, name: str, s: str) -> Place:
        named = (x for x in ("pull", "next stretches") if name in self.layout.fields(x))
        return next(named, "at_stretch"), s, name

    def _stretch_node(self, s: str, side: str) -> str:
        return self.code.load(self.code.at(self._entry("stretch", s), SIDES[1].index(side)))

    def _number(self, pointer: str, k: int) -> str:
        """Pointer to number k of a field."""
        return self.code.at(pointer, k, self.lanes.vector)

    def _work(self, name: str, s: str) -> None:
        """Of a stretch, and what that adds to the energies."""
        self._call(name, lambda f: self._of_stretch(f, s), ("change", 0))
        if "energy" in self.layout.records:
            self._add(("energy", 0, "rise"), ("change", 0, "rise"))

    def _tensions(self) -> None:
        """Of all stretches, by the unknowns."""
        if not self.kinds.stretches:
            return
        code, size = self.code, len(SUMMED)

        def sums(s: str, entry: list[str]) -> None:
            self._of_kind(
                s, "stretch", lambda k: self._call(f"stretch {k}", lambda f: self._put(f, s))
            )
            self._fill(("pull", s))
            self._copy_to(self.at("beyond", s), self.at("at_stretch", s), size)
            with code.when(code.compare("eq", entry[LAST], 0)):
                self._add(self.at("beyond", s), self.at("beyond", code.add(s, 1)), size)

        def tension(s: str, entry: list[str], k: int) -> None:
            before = code.sub(s, 1)
            with code.when(code.compare("ne", entry[FIRST], 0)):
                self._call(f"tension first {k}", lambda f: self._put(f, s))
            with code.when(code.compare("eq", entry[FIRST], 0)):
                self._call(
                    f"tension next {k}", lambda f: self._put(f, before if f == "> turned" else s)
                )

        self._stretches(sums, backward=True)
        self._each_stretch("tension", tension)

    def _put(self, field: str, s: str) -> Place:
        return self._of_pull(field[2:], s) if field[0] == ">" else self._of_stretch(field, s)

    def _finish_tendons(self, good: str) -> None:
        """Work and readings."""
        if not self.kinds.stretches:
            return
        code = self.code
        self._tensions()

        def work(s: str, entry: list[str]) -> None:
            self._work("tendon work", s)
            self._sum(("sample", 0, "work"), ("change", 0, "work"), good)

        def read(s: str, entry: list[str]) -> None:
            to = self.at("tendon_state", entry[TENDON], "tendons")
            tension = self.at("pull", s, "tension")
            with code.when(code.compare("ne", entry[FIRST], 0)):
                self._take(to, tension, good, 1)
                self._take(self._number(to, 2), self.at("beyond", s, "length"), good, 1)
            with code.when(code.compare("ne", entry[LAST], 0)):
                self._take(self._number(to, 1), tension, good, 1)

        self._stretches(work)
        self._stretches(read)
