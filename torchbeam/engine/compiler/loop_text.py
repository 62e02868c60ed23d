"""Text of native code for loops: counters, pointers into records, calls. What is computed is in
traced functions alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class Code:
    """Body of one function. Values are names of 64-bit integers, truth values or pointers; numbers
    are plain int.
    """

    def __init__(self, name: str, given: list[str]) -> None:
        self.name, self.given = name, given
        # memory of counters, where the optimiser turns it into registers
        self.first: list[str] = []
        self.lines: list[str] = []
        self.count = 0

    def line(self, text: str) -> None:
        self.lines.append("  " + text)

    def new(self, text: str) -> str:
        self.count += 1
        self.line(f"%v{self.count} = {text}")
        return f"%v{self.count}"

    def slot(self, kind: str = "i64") -> str:
        """Memory of one value."""
        self.count += 1
        self.first.append(f"  %s{self.count} = alloca {kind}")
        return f"%s{self.count}"

    def label(self) -> str:
        self.count += 1
        return f"b{self.count}"

    def begin(self, label: str) -> None:
        self.lines.append(f"{label}:")

    def go(self, label: str) -> None:
        self.line(f"br label %{label}")

    def add(self, a: str | int, b: str | int) -> str:
        return self.new(f"add i64 {a}, {b}")

    def sub(self, a: str | int, b: str | int) -> str:
        return self.new(f"sub i64 {a}, {b}")

    def mul(self, a: str | int, b: str | int) -> str:
        return self.new(f"mul i64 {a}, {b}")

    def compare(self, how: str, a: str | int, b: str | int) -> str:
        return self.new(f"icmp {how} i64 {a}, {b}")

    def choose(self, truth: str, a: str | int, b: str | int, kind: str = "i64") -> str:
        return self.new(f"select i1 {truth}, {kind} {a}, {kind} {b}")

    def load(self, pointer: str, kind: str = "i64") -> str:
        return self.new(f"load {kind}, ptr {pointer}")

    def store(self, value: str | int, pointer: str, kind: str = "i64") -> None:
        self.line(f"store {kind} {value}, ptr {pointer}")

    def at(self, pointer: str, index: str | int, kind: str = "i64") -> str:
        return self.new(f"getelementptr {kind}, ptr {pointer}, i64 {index}")

    def call(self, name: str, *pointers: str) -> None:
        self.line(f'call void @"{name}"({", ".join(f"ptr {p}" for p in pointers)})')

    @contextmanager
    def loop(self, first: str | int, end: str | int, step: int = 1) -> Iterator[str]:
        """Counter from `first` to before `end`, upwards or (step -1) downwards."""
        counter, head, body, done = self.slot(), self.label(), self.label(), self.label()
        self.store(first, counter)
        self.go(head)
        self.begin(head)
        index = self.load(counter)
        going = self.compare("slt" if step > 0 else "sgt", index, end)
        self.line(f"br i1 {going}, label %{body}, label %{done}")
        self.begin(body)
        yield index
        self.store(self.add(index, step), counter)
        self.go(head)
        self.begin(done)

    @contextmanager
    def when(self, truth: str) -> Iterator[None]:
        body, done = self.label(), self.label()
        self.line(f"br i1 {truth}, label %{body}, label %{done}")
        self.begin(body)
        yield
        self.go(done)
        self.begin(done)

    @contextmanager
    def until(self) -> Iterator[list[str]]:
        """A loop that ends after a round in which the truth value, that the body appends to the
        list, holds.
        """
        body, done, ends = self.label(), self.label(), []
        self.go(body)
        self.begin(body)
        yield ends
        self.line(f"br i1 {ends[0]}, label %{done}, label %{body}")
        self.begin(done)

    def text(self, internal: bool = False) -> str:
        """internal: whether others of its module alone call it."""
        given, linkage = ", ".join(self.given), "internal " * internal
        return "\n".join(
            (
                f'define {linkage}void @"{self.name}"({given}) nounwind {{',
                "entry:",
                *self.first,
                *self.lines,
                "  ret void",
                "}",
            )
        )
